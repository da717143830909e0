"""Mean counts of reflections of the pairs of a tile, from what techniques have added below its batches."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.echogram.reflection_counts import (
    MOST_DISPERSION,
    ReflectionCounts,
    dispersion,
    row_count,
)
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.tables import BATCHES, count_rows
from soundspaces_sim.transport.tile import Sums


class CountMoments(NamedTuple):
    """What the paths of each window of a pair have in the mean, before late bins are smoothed."""

    time: np.ndarray  # (A, B, W, b) s, of arrival
    rows: np.ndarray  # (A, B, W, count rows, b): n_m, what anchors take, n_m n_k (`tables`)


def moments_of(model: Model, sums: Sums) -> CountMoments | None:
    """Those of all pairs of a tile; None unless the config wants counts."""
    if not model.config.materials.enabled:
        return None
    time, weight = mean_times(model, sums.to_b[:, :, :, 0])
    a, b, _, windows, bands = sums.batches.shape
    last = BATCHES + count_rows(len(model.prepared.groups.names))
    rows = np.empty((a, b, windows, last - BATCHES, bands), np.float32)
    for i, batches in enumerate(sums.batches):  # one by one: tables in double precision are large
        whole = batches[:, :BATCHES].sum(axis=1, dtype=float)  # (B, W, b)
        known = (whole > 0.0) & (weight[i] > 0.0)
        of_point = np.moveaxis(batches[:, BATCHES:last], 1, 2).astype(float)
        of_point /= np.where(known, whole, 1.0)[:, :, None]
        _fill(time[i], of_point, known)
        rows[i] = of_point
    return CountMoments(time, rows)


def mean_times(model: Model, energy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A, B, W, b) mean times of arrival in every window, s, its middle where nothing arrives; and energies, of
    `energy` (A, B, bins, b)."""
    window, edges = model.world.window_of_bin, model.time_edges
    starts = np.unique(window, return_index=True)[1]
    middles = 0.5 * (edges[1:] + edges[:-1])
    weight = np.add.reduceat(energy, starts, axis=2, dtype=float)
    moment = np.add.reduceat(energy * middles[:, None], starts, axis=2)
    centre = 0.5 * (np.append(edges[starts], edges[-1])[1:] + edges[starts])
    known = weight > 0.0
    return np.where(known, moment / np.where(known, weight, 1.0), centre[:, None]), weight


def counts_of(model: Model, moments: CountMoments) -> ReflectionCounts:
    """What is kept of the moments of counts."""
    groups = model.prepared.groups
    number, (*shape, _, bands) = len(groups.names), moments.rows.shape
    rows = number, number, number, row_count(number)
    time = moments.time.astype(np.float32)
    arrays = [np.empty((*shape, n, bands), np.float32) for n in rows]
    for i, of_point in enumerate(moments.rows):
        mean, taken, products = np.split(of_point.astype(float), [number, 2 * number], axis=2)
        ratio, correlation = _spread(mean, products)
        of_pairs = mean, ratio, dispersion(mean, taken, groups.anchor), correlation
        for array, values in zip(arrays, of_pairs, strict=True):
            array[i] = values
    return ReflectionCounts(groups, time, *arrays)


def _spread(mean: np.ndarray, products: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(…, M, b) variances over means and (…, `row_count(M)`, b) correlations, from means of n_m n_k, k <= m."""
    row, column = np.tril_indices(mean.shape[-2])
    covariance = products - mean[..., row, :] * mean[..., column, :]
    variance = np.maximum(covariance[..., row == column, :], 0.0)
    ratio = np.divide(variance, mean, out=np.ones_like(mean), where=mean > 0.0)
    roots = np.sqrt(variance[..., row, :] * variance[..., column, :])[..., row != column, :]
    out = np.divide(
        covariance[..., row != column, :], roots, out=np.zeros_like(roots), where=roots > 0.0
    )
    assert out.shape[-2] == row_count(mean.shape[-2])
    return np.minimum(ratio, MOST_DISPERSION), np.clip(out, -1.0, 1.0)


def _fill(time: np.ndarray, mean: np.ndarray, known: np.ndarray) -> None:
    """Put what lies on a line between their neighbours into windows in which nothing arrives, in place."""
    for j, b in np.argwhere(~known.all(axis=1)):
        there, gaps = np.flatnonzero(known[j, :, b]), np.flatnonzero(~known[j, :, b])
        for m in range(mean.shape[2]):
            mean[j, gaps, m, b] = (
                np.interp(time[j, gaps, b], time[j, there, b], mean[j, there, m, b])
                if len(there)
                else 0.0
            )
