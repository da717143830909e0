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

The products by batch are taken at a coarse resolution: `STEPS` steps of time, and groups of neighbouring patches
that see each other. Patches on two sides of a wall receive different sound and may not be one group.

Source: S. Asmussen and P. W. Glynn (2007), Stochastic Simulation, chapters III.3 (delta method), IV.5 (batch
means).
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
from soundspaces_sim.transport.radiance_transfer.convolution import (
    Convolution,
    accumulate,
    make_convolution,
    padded,
    transform,
)
from soundspaces_sim.transport.radiance_transfer.patches import Patches, inverse
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import (
    CHUNK,
)
from soundspaces_sim.transport.tables import BATCHES, deposit_batch, deposit_counts, product_row

_CELL_SIZE = 1.6  # m, edge of the cubic lattice whose cells hold the patches of a group
_SIGHT_HEIGHT = 0.1  # m above patches, where they must see each other
STEPS = 16  # of time, in which batches are resolved
COLUMNS = 160  # points on one side whose products with all of the other are held at once


class PatchGroups(NamedTuple):
    """Groups of the C patches, and the `STEPS` steps of path length in which batches are resolved."""

    group: np.ndarray  # (C,) number among the groups of the patch's chunk
    count: np.ndarray  # (chunks,) groups of a chunk
    factor: np.ndarray  # (C, b) 1 / R of the whole group, 1/m²
    step: float  # m
    convolution: Convolution

    def step_of(self, edges: np.ndarray) -> np.ndarray:
        """(bins,) step of the paths in the bins between `edges`, m.

        Both lengths of a path are rounded down: those of step n are n + 1 steps long in the mean.
        """
        return np.clip(np.rint(self.position_of(edges)), 0, STEPS - 1).astype(np.int64)

    def position_of(self, edges: np.ndarray) -> np.ndarray:
        """(bins,) the same as a real number."""
        return np.asarray(0.5 * (edges[1:] + edges[:-1]) / self.step - 1.0)


class PairEnergies(NamedTuple):
    """Energies of one band between A and B points."""

    forward: np.ndarray  # (A, B, bins) a -> b, decay-compensated
    backward: np.ndarray  # (B, A, bins) b -> a, decay-compensated
    restore: np.ndarray  # (bins,) factor that undoes the decay compensation


class OneWay(NamedTuple):
    """Of one band, of P outgoing and Q incident points: products of each batch of one end with all of the other,
    and of counts of reflections by M groups of materials with all of V."""

    outgoing: np.ndarray  # (P, batch rows, Q, STEPS) ⟨V_k, F⟩, and of the rows of counts
    incident: np.ndarray  # (Q, BATCHES, P, STEPS) ⟨V, F_k⟩
    counts: np.ndarray  # (Q, count rows, P, STEPS) ⟨V, F^m⟩ …
    halved: np.ndarray  # (M, P, Q, STEPS) what halving takes of V, with the same of F
    crossed: np.ndarray  # (M, P, M, Q, STEPS) ⟨V^m, F^k⟩, k on the first axis


class BatchProducts(NamedTuple):
    """Of one band, both ways between the A and B points of a tile."""

    there: OneWay  # a -> b
    back: OneWay


class BinSteps(NamedTuple):
    """Where the bins of an echogram lie at coarser resolutions."""

    step: np.ndarray  # (bins,) `PatchGroups.step_of`
    window: np.ndarray  # (bins,) window of time in which batches are kept
    position: (
        np.ndarray
    )  # (bins,) middle of the bin in steps, 0 in the middle of the first step's paths …
    shift_a: (
        np.ndarray
    )  # (A,) … plus half of what a point of either side adds: 1/2 less the mean share of a step …
    shift_b: np.ndarray  # (B,) … by which the lengths of its first reflections are rounded down


def make_groups(group: np.ndarray, weight: np.ndarray, longest: float) -> PatchGroups:
    """Groups for histograms of paths of up to `longest` m; `group` (C,) as `group_patches` gives it, `weight`
    (C, b) of the patches, 1/m²."""
    chunk = np.arange(len(group)) // CHUNK
    first, of_patch = unique_rows(np.column_stack([chunk, group]))
    count = np.bincount(chunk[first])
    strength = inverse(np.stack([np.bincount(of_patch, s) for s in inverse(weight).T], axis=1))
    within_chunk = of_patch - (np.cumsum(count) - count)[chunk]
    return PatchGroups(
        within_chunk, count, strength[of_patch], longest / STEPS, make_convolution(STEPS, 0)
    )


def group_patches(geometry: Geometry, patches: Patches) -> np.ndarray:
    """(C,) group of every patch: the connected components of mutual visibility within a cell of the lattice."""
    count, places = len(patches.weight), patches.places
    own = np.repeat(np.arange(count), np.diff(places.start))
    center = places.corners.mean(axis=1)
    off = np.linalg.norm(center - patches.middle[own], axis=1)
    nearest = np.lexsort((off, own))[places.start[:-1]]
    viewpoints = center[nearest] + _SIGHT_HEIGHT * places.normal[nearest]
    _, cell = unique_rows(np.floor(patches.middle / _CELL_SIZE).astype(np.int64))
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
) -> None:
    """Add energies (b,) on a patch after `length` m to a batch of `sums` (STEPS, groups, batch rows, 1, b), and
    their `counts` of reflections below the batches."""
    step = int(length / groups.step)
    if step < STEPS:
        cell = sums[step, groups.group[patch]]
        deposit_batch(cell, batch, 0, energy)
        deposit_counts(cell, counts, 0, energy)


def add_products(groups: PatchGroups, by_batch: np.ndarray, total: np.ndarray, out: np.ndarray) -> None:
    """Add to `out` (P, rows, Q, STEPS) the products of each batch of one side with the total of the other, on a
    chunk of patches.

    `by_batch` (P, rows, STEPS, groups) of the one side; `total` (Q', STEPS, groups) of the other is padded to
    whole blocks. Both are without decay compensation; so is `out`, of which only ratios between batches are used.
    """
    convolution, number = groups.convolution, total.shape[2]
    products, rows = len(convolution.forward), by_batch.shape[0] * by_batch.shape[1]
    whole = padded(rows)  # material groups need not fill the last block
    batch_spectra = np.zeros((products, whole, number), np.float32)
    total_spectra = np.empty((products, len(total), number), np.float32)
    transform(convolution, by_batch.reshape(rows, STEPS, number), batch_spectra)
    transform(convolution, total, total_spectra)
    scratch = np.empty((products, whole * min(len(total), COLUMNS)), np.float32)
    sums = out.reshape(-1, *out.shape[2:])
    for start in range(0, out.shape[2], COLUMNS):
        columns = slice(start, start + COLUMNS)
        accumulate(convolution, batch_spectra, total_spectra[:, columns], scratch, sums[:, columns])


@kernel
def add_batches(
    first: int,
    last: int,
    pairs: np.ndarray,
    energies: PairEnergies,
    products: BatchProducts,
    bins: BinSteps,
    batches: np.ndarray,
    share: np.ndarray,
) -> None:
    """Add E_k of the `pairs` `first` to `last` of (n, 2) to `batches` (A, B, batch rows, windows), of one band,
    and to the rows below E times the means of counts of reflections, what halving takes, and products of counts.

    `share` (STEPS, batch rows + 1) is scratch: E_k / E, these means, but covariances for products, and whether
    anything arrives in the step. Where no batch has energy in a step, all have the same share.
    """
    groups = len(products.there.halved)
    for n in range(first, last):
        i, j = pairs[n, 0], pairs[n, 1]
        for step in range(STEPS):
            total = 0.0
            for k in range(BATCHES):
                share[step, k] = _product_of_batch(products, i, j, step, k)
                total += 0.5 * share[step, k]
            for k in range(BATCHES):
                if total > 0.0:
                    share[step, k] = share[step, k] / total - 1.0 / BATCHES
                else:
                    share[step, k] = 1.0 / BATCHES
            _find_moments(products, i, j, step, share[step])
        for t in range(len(energies.restore)):
            mean = 0.5 * (energies.forward[i, j, t] + energies.backward[j, i, t])
            energy = mean * energies.restore[t]
            for k in range(BATCHES):
                batches[i, j, k, bins.window[t]] += energy * share[bins.step[t], k]
            if groups > 0:
                position = bins.position[t] + 0.5 * (bins.shift_a[i] + bins.shift_b[j])
                _add_moments(share, position, energy, groups, batches[i, j, :, bins.window[t]])


@part
def _find_moments(products: BatchProducts, i: int, j: int, step: int, share: np.ndarray) -> None:
    """Means of the rows of counts over both directions of a pair in a step into `share` (batch rows + 1,), with
    covariances for products; its last entry: whether anything arrives."""
    groups = len(products.there.halved)
    share[BATCHES:] = 0.0
    weight = _add_means(products.there, i, j, step, share) + _add_means(products.back, j, i, step, share)
    if weight <= 0.0:
        return
    share[-1] = 1.0
    for r in range(BATCHES, len(share) - 1):
        share[r] /= weight
    for m in range(groups):
        for k in range(m + 1):
            share[product_row(groups, m, k)] -= share[BATCHES + m] * share[BATCHES + k]


@part
def _add_means(way: OneWay, p: int, q: int, step: int, share: np.ndarray) -> float:
    """Add the means of one direction, times its energy, which is returned; 0 if nothing arrives.

    Counts of both ends add. What is left of either multiplies, so that of what halving takes from both the product
    is subtracted.
    """
    total = 0.0
    for k in range(BATCHES):
        total += max(float(way.outgoing[p, k, q, step]), 0.0)
    groups = len(way.halved)
    if total <= 0.0 or groups == 0:
        return 0.0
    for r in range(BATCHES, len(share) - 1):
        share[r] += way.outgoing[p, r, q, step] + way.counts[q, r - BATCHES, p, step]
    for m in range(groups):
        share[BATCHES + groups + m] -= way.halved[m, p, q, step]
        for k in range(m + 1):
            both = way.crossed[k, p, m, q, step] + way.crossed[m, p, k, q, step]
            share[product_row(groups, m, k)] += both
    return total


@part
def _add_moments(
    share: np.ndarray, position: float, energy: float, groups: int, out: np.ndarray
) -> None:
    """Add `energy` times what the rows of counts are on a line between two steps; that of one where nothing arrives
    in the other.

    The lengths of both ends are rounded down to whole steps, so that the paths of a step differ in length by a
    variance of a sixth of a step squared. That part of the covariance goes with the course of the mean.
    """
    low = min(max(int(position), 0), STEPS - 2)
    known = share[low, -1] > 0.0, share[low + 1, -1] > 0.0
    high = 1.0 if not known[0] else position - low if known[1] else 0.0
    both = known[0] and known[1]
    for r in range(BATCHES, BATCHES + 2 * groups):
        out[r] += energy * max(share[low, r] + high * (share[low + 1, r] - share[low, r]), 0.0)
    for m in range(groups):
        a, b = share[low, BATCHES + m], share[low + 1, BATCHES + m]
        mean = max(a + high * (b - a), 0.0)
        for k in range(m + 1):
            c, d = share[low, BATCHES + k], share[low + 1, BATCHES + k]
            other, r = max(c + high * (d - c), 0.0), product_row(groups, m, k)
            value = share[low, r] + high * (share[low + 1, r] - share[low, r])
            course = (b - a) * (d - c) / 6.0 if both else 0.0
            out[r] += energy * max(value - course + mean * other, 0.0)


@part(forceinline=True)
def _product_of_batch(products: BatchProducts, i: int, j: int, step: int, k: int) -> float:
    """Products of batch `k` of both endpoints: a sum that is the same whichever endpoint is a."""
    there, back = products.there, products.back
    of_a = there.outgoing[i, k, j, step] + back.incident[i, k, j, step]
    of_b = back.outgoing[j, k, i, step] + there.incident[j, k, i, step]
    return max(of_a, np.float32(0.0)) + max(of_b, np.float32(0.0))
