"""Mean counts of reflections of the pairs of a tile, from what techniques have added below its batches."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.echogram.reflection_counts import ReflectionCounts, dispersion
from soundspaces_sim.transport.reflection_counts.correlation import count_correlation
from soundspaces_sim.transport.tables import BATCHES, OF_GROUP
from soundspaces_sim.transport.tile import Tile


def counts_of(tile: Tile) -> ReflectionCounts | None:
    """Counts of all pairs of a tile, before late bins are smoothed; None unless the config wants them."""
    model = tile.model
    if not model.config.materials.enabled:
        return None
    window, edges = model.world.window_of_bin, model.time_edges
    starts = np.unique(window, return_index=True)[1]
    middles = 0.5 * (edges[1:] + edges[:-1])
    energy = tile.to_b[:, :, :, 0].astype(float)  # (A, B, bins, b)
    weight = np.add.reduceat(energy, starts, axis=2)
    moment = np.add.reduceat(energy * middles[:, None], starts, axis=2)
    batches = tile.batches.astype(float)
    whole = batches[:, :, :BATCHES].sum(axis=2)  # (A, B, windows, b)
    known = (whole > 0.0) & (weight > 0.0)
    centre = 0.5 * (np.append(edges[starts], edges[-1])[1:] + edges[starts])
    time = np.where(known, moment / np.where(known, weight, 1.0), centre[:, None])
    rows = np.moveaxis(batches[:, :, BATCHES:], 2, 3)  # (A, B, windows, OF_GROUP groups, b)
    rows = rows / np.where(known, whole, 1.0)[:, :, :, None]
    _fill(time, rows, known)
    mean, halved = np.split(rows, OF_GROUP, axis=3)
    groups, correlation = model.prepared.groups, model.once(count_correlation)
    of_pairs = (array.astype(np.float32) for array in (time, mean, dispersion(mean, halved)))
    return ReflectionCounts(groups, correlation, *of_pairs)


def _fill(time: np.ndarray, mean: np.ndarray, known: np.ndarray) -> None:
    """Put what lies on a line between their neighbours into windows in which nothing arrives, in place."""
    for i, j, b in np.argwhere(~known.all(axis=2)):
        there, gaps = np.flatnonzero(known[i, j, :, b]), np.flatnonzero(~known[i, j, :, b])
        for m in range(mean.shape[3]):
            mean[i, j, gaps, m, b] = (
                np.interp(time[i, j, gaps, b], time[i, j, there, b], mean[i, j, there, m, b])
                if len(there)
                else 0.0
            )
