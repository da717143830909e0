"""Error bars of the middle: what each batch of a point's walks makes of it.

The variance of a sum of products is, to first order, that of what batch k of one end makes with all of the
other, and the other way round; both ends go along shared walks k (mod BATCHES), so that what these add is in it,
and what both ends have in common. That takes tables by batch, in which neighbouring patches that see each other
are one group: those on two sides of a wall receive different sound and may not be.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.scene.rays.geometry import Geometry, visible
from soundspaces_sim.transport.radiance_transfer.convolution import (
    Convolution,
    make_convolution,
    meet,
    transform,
)
from soundspaces_sim.transport.radiance_transfer.patches import Patches, inverse
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import CHUNK
from soundspaces_sim.transport.tables import BATCHES

_SIZE = 1.6  # m, edge of the lattice in whose cells patches are grouped
_LIFT = 0.1  # m above patches, where they must see each other
STEPS = 16  # of time, in which what batches leave and bring is put together
COLUMNS = 160  # points on one side whose products with all of the other are held at once


class Groups(NamedTuple):
    """Groups of patches, and `STEPS` steps of time whose sound is put together."""

    group: np.ndarray  # (C,) number among those of its chunk
    count: np.ndarray  # (chunks,) groups
    factor: np.ndarray  # (C, b) 1 / R of the whole group
    step: float  # m
    convolution: Convolution

    def step_of(self, edges: np.ndarray) -> np.ndarray:
        """(bins,) step in which the sound of bins between `edges`, m, comes together.

        Two lengths are rounded down: what they make in step n is n + 1 steps long, in the mean.
        """
        middles = 0.5 * (edges[1:] + edges[:-1])
        return np.clip(np.rint(middles / self.step - 1.0), 0, STEPS - 1).astype(np.int64)


def make_groups(group: np.ndarray, weight: np.ndarray, longest: float) -> Groups:
    """Groups for tables of paths of up to `longest` m; `group` (C,) as `group_patches` gives it, `weight` (C, b) of
    the patches."""
    chunk = np.arange(len(group)) // CHUNK
    first, whole = unique_rows(np.column_stack([chunk, group]))
    count = np.bincount(chunk[first])
    strength = inverse(np.stack([np.bincount(whole, s) for s in inverse(weight).T], axis=1))
    own = whole - (np.cumsum(count) - count)[chunk]
    return Groups(own, count, strength[whole], longest / STEPS, make_convolution(STEPS, 0))


def group_patches(geometry: Geometry, patches: Patches) -> np.ndarray:
    """(C,) group of every patch: those of one lattice cell that see each other, if only by way of others of it."""
    count, places = len(patches.weight), patches.places
    own = np.repeat(np.arange(count), np.diff(places.start))
    center = places.corners.mean(axis=1)
    off = np.linalg.norm(center - patches.middle[own], axis=1)
    nearest = np.lexsort((off, own))[places.start[:-1]]
    seen_from = center[nearest] + _LIFT * places.normal[nearest]
    _, cell = unique_rows(np.floor(patches.middle / _SIZE).astype(np.int64))
    members = np.split(np.argsort(cell, kind="stable"), np.cumsum(np.bincount(cell))[:-1])
    pairs = [m[np.stack(np.triu_indices(len(m), 1), axis=1)] for m in members]
    pair = np.concatenate([np.empty((0, 2), np.int64), *pairs])
    sees = np.zeros(len(pair), bool)
    over_rows(_look, len(pair), geometry, seen_from, pair, sees)
    linked = coo_array((np.ones(int(sees.sum())), pair[sees].T), shape=(count, count))
    return np.asarray(connected_components(linked, directed=False)[1])


@kernel
def _look(first, last, geometry, places, pairs, sees):
    """Whether the two places of each of the `pairs` `first` to `last` see each other."""
    for n in range(first, last):
        i, j = pairs[n, 0], pairs[n, 1]
        sees[n] = visible(
            geometry, places[i, 0], places[i, 1], places[i, 2], places[j, 0], places[j, 1], places[j, 2]
        )


@part(forceinline=True)
def put(sums, groups, batch, patch, length, energy):
    """Energies (b,) of a batch on a patch to `sums` (BATCHES, STEPS, groups, b)."""
    step = int(length / groups.step)
    if step < STEPS:
        for b in range(len(energy)):
            sums[batch, step, groups.group[patch], b] += energy[b]


def add_products(groups: Groups, by_batch: np.ndarray, whole: np.ndarray, out: np.ndarray) -> None:
    """Add to `out` (P, BATCHES, Q, STEPS) what each batch of one end makes, on a chunk, with all of the other.

    `by_batch` (P', BATCHES, STEPS, groups) of the one and `whole` (Q', STEPS, groups) of the other are filled up to
    whole blocks, without their decay; so is `out`, of which only shares of batches are used.
    """
    convolution, number = groups.convolution, whole.shape[2]
    products, rows = len(convolution.forward), by_batch.shape[0] * BATCHES
    one = np.empty((products, rows, number), np.float32)
    other = np.empty((products, len(whole), number), np.float32)
    transform(convolution, by_batch.reshape(rows, STEPS, number), one)
    transform(convolution, whole, other)
    scratch = np.empty((products, rows * min(len(whole), COLUMNS)), np.float32)
    sums = out.reshape(-1, *out.shape[2:])
    for start in range(0, out.shape[2], COLUMNS):
        columns = slice(start, start + COLUMNS)
        meet(convolution, one, other[:, columns], scratch, sums[:, columns])


@kernel
def add_batches(first, last, pairs, whole, back, flat, steps, windows, of_a, of_b, band, batches, share):
    """Split the energy of each of the `pairs` `first` to `last` between batches of walks.

    `whole` (A, B, bins) and `back` (B, A, bins): energy without its decay, which `flat` (bins,) gives back; `steps`
    and `windows` (bins,) of a bin: `Groups.step_of`, `World.window_of_bin`; `of_a` two (A, BATCHES, B, STEPS), what
    batches of one end make with all of the other, by way of what that end leaves on patches and of what is brought
    to it; `of_b` two (B, BATCHES, A, STEPS). `share` (STEPS, BATCHES) is scratch.
    """
    for n in range(first, last):
        i, j = pairs[n, 0], pairs[n, 1]
        for step in range(STEPS):
            total = 0.0
            for k in range(BATCHES):
                share[step, k] = _of_batch(of_a, of_b, i, j, step, k)
                total += 0.5 * share[step, k]
            for k in range(BATCHES):
                if total > 0.0:
                    share[step, k] = share[step, k] / total - 1.0 / BATCHES
                else:
                    share[step, k] = 1.0 / BATCHES
        for t in range(len(flat)):
            value = 0.5 * (whole[i, j, t] + back[j, i, t]) * flat[t]
            for k in range(BATCHES):
                batches[i, j, k, windows[t], band] += value * share[steps[t], k]


@part(forceinline=True)
def _of_batch(of_a, of_b, i, j, step, k):
    """What batches `k` of both ends make: a sum that is the same whichever end is which."""
    one = of_a[0][i, k, j, step] + of_a[1][i, k, j, step]
    other = of_b[0][j, k, i, step] + of_b[1][j, k, i, step]
    return max(one, np.float32(0.0)) + max(other, np.float32(0.0))
