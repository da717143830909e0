"""Batch variance of radiance transfer: how much of a pair's energy each batch of subpaths contributes.

The subpaths of a point are K = `BATCHES` interleaved batches, each of which sums to 1 / K of the point's estimate
in the mean. Radiance transfer is bilinear, E = ⟨V, F⟩, in the outgoing histograms V = sum over k of V_k of one
endpoint and the incident histograms F = sum over k of F_k of the other. To first order (the delta method) a
deviation of the product is

    δE = ⟨δV, F⟩ + ⟨V, δF⟩,

so batch k contributes E_k = E (⟨V_k, F⟩ / E + ⟨V, F_k⟩ / E − 1 / K), which sums to E, and the variance of E is
that of the sum of the E_k. Batch k of both endpoints is carried on by transfer subpaths m = k (mod K): their
noise and the correlation between the endpoints are in it. E is the mean of the transfers a → b and b → a, so that
each endpoint has batches both of outgoing and of incident histograms.

Both terms come from one product, the infinitesimal jackknife: with the weight of batch k raised at both ends,

    V(k) = V + λ (K V_k − V),    F(k) = F + λ (K F_k − F),

E(k) = ⟨V(k), F(k)⟩ changes in proportion to λ, but for λ² ⟨K V_k − V, K F_k − F⟩. With the mean Ē over k

    E_k = E (1 / K + (E(k) / Ē − 1) / (λ K)).                                                              (1)

λ = `RAISED` is so small that the square does not matter, and large enough for single precision.

The products by batch are taken at a coarse resolution: steps as long as the windows of time in which error bars are
kept, and groups of neighbouring patches that see each other. Patches on two sides of a wall receive different sound
and may not be one group.

A group hides that its patches differ: an event of V counts as what F is on the patch where it lies, and the
product of groups takes F as even over the group. An event e on patch c is off by e (F_c / R_c − F_g / R_g). Where
in the group events lie is independent from event to event, so the variance that this adds is

    Σ_g Var(V_g) ∗ Σ_{c in g} R_c / R_g (F_c / R_c − F_g / R_g)²,

with the variance of V_g by batches, in proportion to R within the group; and the same with V and F in each other's
place (`Within`). Deviations of batches from their mean are as much larger in the step.

Counts of reflections are products, too. In a step they are those of paths of some mean length, which is another
such product; bins have what lies on a line between these lengths.

Source: S. Asmussen and P. W. Glynn (2007), Stochastic Simulation, chapters III.3 (delta method), IV.5 (batch
means). L. A. Jaeckel (1972), The infinitesimal jackknife, Bell Laboratories MM 72-1215-11; B. Efron (1982), The
jackknife, the bootstrap and other resampling plans, chapter 6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.scene.rays.geometry import Geometry, unoccluded
from soundspaces_sim.transport.radiance_transfer.patches import CELL_SIZE, Patches, inverse
from soundspaces_sim.transport.radiance_transfer.time_steps import (
    Stretch,
    TimeSteps,
    incident_row,
    make_stretches,
    outgoing_row,
)
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import CHUNK
from soundspaces_sim.transport.tables import BATCHES, count_rows, deposit_batch, deposit_counts

RAISED = 1.0 / 32.0  # λ of (1)
_SIGHT_HEIGHT = 0.1  # m above patches, where they must see each other


class PatchGroups(NamedTuple):
    """Groups of the C patches, and steps of path length, in which batches are resolved in histograms."""

    group: np.ndarray  # (C,) number among the groups of the patch's chunk
    count: np.ndarray  # (chunks,) groups of a chunk
    factor: np.ndarray  # (C, b) 1 / R of the whole group, 1/m²
    steps: TimeSteps
    kept: np.ndarray  # (material groups, b) `Surfaces.kept`


class Within(NamedTuple):
    """How patches lie within groups, and steps of histograms within those of batches."""

    share: np.ndarray  # (C, b) R of the patch / R of its group
    # (2, rows, 2): rows of a histogram, from and to, in one by batch; outgoing, incident
    rows: np.ndarray


class WindowSteps(NamedTuple):
    """The T steps of path length in which products of batches are resolved."""

    edges: np.ndarray  # (T + 1,) m
    steps: TimeSteps  # rows of histograms
    stretches: list[Stretch]  # whose `bins` are among the T

    @property
    def total(self) -> int:
        """T."""
        return len(self.edges) - 1


def moment_rows(groups: int) -> int:
    """Rows of histograms by batch: those of a tile and, if so many groups of materials are counted, lengths."""
    return BATCHES + count_rows(groups) + (1 if groups else 0)


def make_groups(
    group: np.ndarray, weight: np.ndarray, steps: TimeSteps, kept: np.ndarray
) -> PatchGroups:
    """Groups from `group` (C,) as `group_patches` gives it, and `weight` (C, b) of the patches, 1/m²; `kept` as
    `PatchGroups` has it."""
    chunk = np.arange(len(group)) // CHUNK
    first, of_patch = unique_rows(np.column_stack([chunk, group]))
    count = np.bincount(chunk[first])
    strength = inverse(np.stack([np.bincount(of_patch, s) for s in inverse(weight).T], axis=1))
    within_chunk = of_patch - (np.cumsum(count) - count)[chunk]
    return PatchGroups(within_chunk, count, strength[of_patch], steps, kept)


def make_within(groups: PatchGroups, weight: np.ndarray, fine: TimeSteps) -> Within:
    """Of patches of `weight` (C, b), 1/m², and histograms in `fine` steps."""
    share = inverse(weight) * groups.factor
    wide, rows = groups.steps, np.zeros((2, groups.steps.rows, 2), np.int64)
    end = fine.step * fine.steps
    for s in range(len(wide.step)):
        reached = end >= wide.step[s] * wide.steps[s] - 0.5 * wide.step[s]
        f = int(reached.argmax()) if reached.any() else len(end) - 1  # the first is the finest
        middle = np.arange(fine.steps[f]) + 0.25  # of the lengths that rounding puts into a row
        at = middle * fine.step[f] + np.array([[0.0], [fine.offset[f] - wide.offset[s]]])
        of_row = (np.maximum(at, 0.0) / wide.step[s] + 0.25).astype(np.int64)
        for way in range(2):
            first = np.searchsorted(of_row[way], np.arange(wide.steps[s] + 1))
            of_stretch = slice(wide.base[s], wide.base[s + 1])
            rows[way, of_stretch] = fine.base[f] + np.stack([first[:-1], first[1:]], axis=1)
    return Within(share, rows)


def make_window_steps(windows: np.ndarray) -> WindowSteps:
    """Steps of the windows of batches between edges, m."""
    return WindowSteps(windows, *make_stretches(windows))


def group_patches(geometry: Geometry, patches: Patches) -> np.ndarray:
    """(C,) group of every patch: the connected components of mutual visibility within a cell of the lattice."""
    count, places = len(patches.weight), patches.places
    own = np.repeat(np.arange(count), np.diff(places.start))
    center = places.corners.mean(axis=1)
    off = np.linalg.norm(center - patches.middle[own], axis=1)
    nearest = np.lexsort((off, own))[places.start[:-1]]
    viewpoints = center[nearest] + _SIGHT_HEIGHT * places.normal[nearest]
    _, cell = unique_rows(np.floor(patches.middle / CELL_SIZE).astype(np.int64))
    members = np.split(np.argsort(cell, kind="stable"), np.cumsum(np.bincount(cell))[:-1])
    pairs = [m[np.stack(np.triu_indices(len(m), 1), axis=1)] for m in members]
    pair = np.concatenate([np.empty((0, 2), np.int64), *pairs])
    sees = np.zeros(len(pair), bool)
    over_rows(_find_visible_pairs, len(pair), geometry, viewpoints, pair, sees)
    linked = coo_array((np.ones(int(sees.sum())), pair[sees].T), shape=(count, count))
    return np.asarray(connected_components(linked, directed=False)[1])


@kernel
def _find_visible_pairs(
    first: int, last: int, geometry: Geometry, points: np.ndarray, pairs: np.ndarray, sees: np.ndarray
) -> None:
    """Fill rows `first` to `last` of `sees` (n,): whether the two `points` (C, 3) of the `pairs` (n, 2) see each
    other."""
    for n in range(first, last):
        i, j = pairs[n, 0], pairs[n, 1]
        sees[n] = unoccluded(geometry, row(points, i), row(points, j))


@part(forceinline=True)
def add_to_group(
    sums: np.ndarray,
    groups: PatchGroups,
    batch: int,
    patch: int,
    length: float,
    energy: np.ndarray,
    counts: np.ndarray,
    incident: bool,
) -> None:
    """Add energies (b,) on a patch after `length` m to a batch of `sums` (rows, groups, moment rows, 1, b), and
    their `counts` of reflections (`deposit_counts`) and lengths below the batches. `incident`: of F, not V."""
    for s in range(len(groups.steps.step)):
        at = incident_row(groups.steps, s, length) if incident else outgoing_row(groups.steps, s, length)
        if at >= 0:
            cell = sums[at, groups.group[patch]]
            deposit_batch(cell, batch, 0, energy)
            if len(counts) > 0:
                deposit_counts(cell, counts, groups.kept, 0, energy)
                for b in range(len(energy)):
                    cell[len(cell) - 1, 0, b] += length * energy[b]
