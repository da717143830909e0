"""What radiance transfer has in common for all points of a tile: steps, patch groups, factors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.numerics.rng import combine
from soundspaces_sim.echogram.time_windows import window_edges
from soundspaces_sim.transport.model import Model, air_transmission
from soundspaces_sim.transport.radiance_transfer.batch_variance import (
    PatchGroups,
    WindowSteps,
    Within,
    make_groups,
    make_window_steps,
    make_within,
    moment_rows,
)
from soundspaces_sim.transport.radiance_transfer.patch_histograms import DirectedPatches
from soundspaces_sim.transport.radiance_transfer.patches import inverse
from soundspaces_sim.transport.radiance_transfer.prepared import late_decay, patch_groups
from soundspaces_sim.transport.radiance_transfer.time_steps import (
    CoarseSteps,
    Stretch,
    TimeSteps,
    make_coarse,
    make_stretches,
)
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import CHUNK

DIRECTED = 512  # patches that tell from where sound arrives, if there are more
_STREAM = 0xD1CE  # keeps the draw of patches apart from others


class TransferPlan(NamedTuple):
    """What is the same for all points. C patches, b bands."""

    steps: TimeSteps
    stretches: list[Stretch]
    coarse: CoarseSteps
    groups: PatchGroups
    windows: WindowSteps
    within: Within
    factor: np.ndarray  # (C, b) 4 / R, 1/m²
    directed: DirectedPatches
    first_bin: int  # of the late bins, among all of an echogram
    edges: np.ndarray  # (late bins + 1,) m
    restore: np.ndarray  # (late bins, b) undoes the decay compensation and applies air

    @property
    def material_groups(self) -> int:
        """Groups whose reflections are counted."""
        return len(self.groups.kept)

    @property
    def bands(self) -> int:
        """b."""
        return int(self.factor.shape[1])

    @property
    def moment_rows(self) -> int:
        """Rows of histograms by batch."""
        return moment_rows(self.material_groups)

    @property
    def chunk(self) -> int:
        """Columns of a chunk's histograms."""
        return min(CHUNK, len(self.factor))


def make_transfer_plan(model: Model) -> TransferPlan:
    """The plan of a model that has patches."""
    weight = model.world.patches.weight
    edges = model.time_edges * model.config.c
    first_bin = int(np.searchsorted(edges, model.world.settings.late_length - 1e-6))
    edges = edges[first_bin:]
    steps, stretches = make_stretches(edges)
    windows = make_window_steps(batch_edges(model))
    factor = (4.0 * weight).astype(np.float32)
    groups = make_groups(
        model.first.once(patch_groups), weight, windows.steps, model.world.surfaces.kept
    )
    return TransferPlan(
        steps=steps,
        stretches=stretches,
        coarse=make_coarse(steps, edges, model.config.c),
        groups=groups,
        windows=windows,
        within=make_within(groups, weight, steps),
        factor=factor,
        directed=_draw_directed(weight, factor, model.seed),
        first_bin=first_bin,
        edges=edges,
        restore=_restore(edges, model.once(late_decay).rate, model.config),
    )


def batch_edges(model: Model) -> np.ndarray:
    """Edges, m, of the windows of time in which batches are kept, from that on in which late bins begin."""
    edges = window_edges(model.time_edges, model.prepared.groups.windows) * model.config.c
    first = np.searchsorted(edges, model.world.settings.late_length + 1e-6) - 1
    return np.asarray(edges[min(first, len(edges) - 2) :])


def _restore(edges: np.ndarray, decay: np.ndarray, config: SimulationConfig) -> np.ndarray:
    """(bins, b) mean over a bin of exp(-decay length), times what air leaves at its middle."""
    nepers = decay * np.diff(edges)[:, None]
    mean = np.divide(-np.expm1(-nepers), nepers, out=np.ones_like(nepers), where=nepers > 1e-9)
    left = air_transmission(config, 0.5 * (edges[1:] + edges[:-1]))
    return np.asarray(np.exp(-decay * edges[:-1, None]) * mean * left)


def _draw_directed(weight: np.ndarray, factor: np.ndarray, seed: int) -> DirectedPatches:
    """About `DIRECTED` patches, by systematic sampling with probabilities proportional to R in the mean over
    bands, at most 1; `weight`, `factor` (C, b): 1 / R and 4 / R."""
    patch, scale = np.arange(len(weight)), np.ones(len(weight))
    if len(weight) > DIRECTED:
        strength = inverse(weight).mean(axis=1)
        low, high = 0.0, float(strength.max()) * len(strength)
        for _ in range(60):  # patches stronger than `high` are certain
            half = 0.5 * (low + high)
            low, high = (
                (half, high) if np.minimum(strength / half, 1.0).sum() > DIRECTED else (low, half)
            )
        chance = np.minimum(strength / high, 1.0)
        u = combine(seed, _STREAM) / 2.0**64
        patch = np.flatnonzero(np.diff(np.floor(np.cumsum(chance) + u), prepend=0.0) > 0.0)
        scale = 1.0 / chance[patch]
    column, factor = np.full(len(weight), -1), factor.copy()
    column[patch] = np.arange(len(patch))
    factor[patch] *= scale[:, None].astype(np.float32)
    return DirectedPatches(patch, column, factor)
