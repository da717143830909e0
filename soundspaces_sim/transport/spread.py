"""Error bars of the middle: what each batch of a point's walks makes of it.

The variance of a sum of products is, to first order, that of what batch k of one end makes with all of the
other, and the other way round; both ends go along shared walks k (mod BATCHES), so that what these add is in it,
and what both ends have in common. That takes tables by batch, in which neighbouring patches that see each other
are one group: those on two sides of a wall receive different sound and may not be.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.base.kernel import kernel, over_rows, part
from soundspaces_sim.base.rows import unique_rows
from soundspaces_sim.rays.geometry import Geometry, visible
from soundspaces_sim.transport.convolve import BLOCK
from soundspaces_sim.transport.patches import Patches, inverse
from soundspaces_sim.transport.shared import CHUNK
from soundspaces_sim.transport.tables import BATCHES, WINDOWS

_SIZE = 1.6  # m, edge of the lattice in whose cells patches are grouped
_LIFT = 0.1  # m above patches, where they must see each other
_STEP = 5.7  # m, about
_LATER = 24  # wider steps after those that windows may start at


class Groups(NamedTuple):
    """Groups of patches, and steps of time: `kept` of `step`, in which windows may start, and wider ones of `later`
    after them, whose sound is put together."""

    group: np.ndarray  # (C,) number among those of its chunk
    count: np.ndarray  # (chunks,) groups
    factor: np.ndarray  # (C, b) 1 / R of the whole group
    step: float  # m
    begins: int  # step at which the middle begins
    kept: int
    later: float  # m
    flat: np.ndarray  # (kept + _LATER, b) undoes the flattening


def make_groups(
    group: np.ndarray, weight: np.ndarray, begins: float, longest: float, late: float, decay: np.ndarray,
    left: Callable[[np.ndarray], np.ndarray],
) -> Groups:  # fmt: skip
    """Groups for tables of paths of `begins` to `longest` m, flattened by `decay` (b,), whose late window starts
    before `late` m; `group` (C,) as `group_patches` gives it, `weight` (C, b) of the patches; `left`: share of the
    energies (…, b) that air leaves after lengths (…), for the weight of steps in a window."""
    chunk = np.arange(len(group)) // CHUNK
    first, whole = unique_rows(np.column_stack([chunk, group]))
    count = np.bincount(chunk[first])
    strength = inverse(np.stack([np.bincount(whole, s) for s in inverse(weight).T], axis=1))
    before = round(begins / _STEP)
    step = begins / before if before else _STEP
    kept = max(int(min(late, longest) / step + 0.5), before, 1)
    later = max(longest - kept * step, step) / _LATER
    middles = np.concatenate(
        [(np.arange(kept) + 0.5) * step, kept * step + (np.arange(_LATER) + 0.5) * later]
    )
    own = whole - (np.cumsum(count) - count)[chunk]
    return Groups(
        own, count, strength[whole], step, before, kept, later, np.exp(-middles[:, None] * decay) * left(middles),
    )  # fmt: skip


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
    """Energies (b,) of a batch on a patch to `sums` (BATCHES, kept + 1, groups, b), not flattened."""
    step = int(length / groups.step)
    if step >= groups.kept:
        step = groups.kept + int((length - groups.kept * groups.step) / groups.later)
    if step < len(groups.flat):
        row = min(step, groups.kept)
        for b in range(len(energy)):
            sums[batch, row, groups.group[patch], b] += energy[b] * groups.flat[step, b]


def add_products(
    groups: Groups, by_batch: np.ndarray, whole: np.ndarray, starts: np.ndarray, out: np.ndarray
) -> None:
    """Add to `out` (P, Q, WINDOWS, BATCHES) what each batch of one end makes, on a chunk, with all of the other.

    `by_batch` (P', BATCHES, kept + 1, groups) of the one and `whole` (Q', kept + 1, groups) of the other are filled
    up to whole blocks; `starts` (P, Q): step, not a whole one, from which on a pair's sound is late.
    """
    kept, number = groups.kept, whole.shape[2]
    last = min(int(starts.max() + 0.5), kept)  # later steps are late for all pairs
    # Steps t and n - t meet: with one of them reversed, the sum over t and groups is one product.
    back = np.ascontiguousarray(whole[:, kept - 1 :: -1]).reshape(-1, BLOCK, kept * number)
    each = whole.sum(axis=1).reshape(-1, BLOCK, number)

    def call(first: int, last_block: int) -> None:
        for p in range(first, last_block):
            rows = slice(p * BLOCK, (p + 1) * BLOCK)
            one = by_batch[rows].reshape(BLOCK * BATCHES, -1)
            met = np.empty((last + 1, len(back), len(one), BLOCK), np.float32)
            for n in range(last):
                terms = (n + 1) * number
                np.matmul(one[:, :terms], back[:, :, -terms:].transpose(0, 2, 1), out=met[n])
            total = by_batch[rows].sum(axis=2).reshape(len(one), number)
            np.matmul(total, each.transpose(0, 2, 1), out=met[last])
            of_block = out[rows]
            _add_windows(0, len(of_block), met, starts[rows], groups.begins, of_block)

    over_rows(call, len(by_batch) // BLOCK, chunk=1)


@kernel
def _add_windows(first, last, met, starts, begins, out):
    """Add to rows `first` to `last` of `out` (P, Q, WINDOWS, BATCHES) the sums over the windows of
    `met` (steps + 1, Q blocks, P BATCHES, BLOCK), whose last step is all: an early one from step `begins` on, the
    late one from `starts` (P, Q) on.
    """
    steps = len(met) - 1
    for i in range(first, last):
        for j in range(out.shape[1]):
            block, column = j // BLOCK, j % BLOCK
            for k in range(BATCHES):
                row = i * BATCHES + k
                early, before = np.float32(0.0), np.float32(0.0)
                for n in range(steps):
                    value = met[n, block, row, column]
                    late = _share(n, starts[i, j])
                    before += (np.float32(1.0) - _share(n, begins)) * value
                    early += (_share(n, begins) - late) * value
                out[i, j, 0, k] += early
                out[i, j, 1, k] += met[steps, block, row, column] - before - early


@part(forceinline=True)
def _share(n, start):
    """Of what meets in step n, the part from `start` on.

    Two times, each rounded down: what meets in step n lies about n + 1.
    """
    return np.float32(min(max(n + 1.5 - start, 0.0), 1.0))


def late_steps(groups: Groups, early: np.ndarray) -> np.ndarray:
    """Step, not a whole one, from which on the sound of pairs is late whose early window ends at `early` m."""
    return np.clip(early / groups.step, groups.begins, groups.kept)


@kernel
def add_batches(first, last, pairs, whole, back, flat, starts, ends, early, of_a, of_b, band, batches):
    """Split the energy of each of the `pairs` `first` to `last` between batches of walks.

    `whole` (A, B, bins) and `back` (B, A, bins): flattened energy of bins from `starts` to `ends`; `flat` undoes
    it; `early` (A, B) where windows end; `of_a` two (A, B, WINDOWS, BATCHES), what batches of one end make with all
    of the other, by way of what that end leaves on patches and of what is brought to it; `of_b` two (B, A, …).
    """
    for n in range(first, last):
        i, j = pairs[n, 0], pairs[n, 1]
        soon, late = 0.0, 0.0
        for t in range(len(flat)):
            value = 0.5 * (whole[i, j, t] + back[j, i, t]) * flat[t]
            share = min(max((early[i, j] - starts[t]) / (ends[t] - starts[t]), 0.0), 1.0)
            soon, late = soon + share * value, late + (1.0 - share) * value
        for window in range(WINDOWS):
            total = 0.0
            for k in range(BATCHES):
                total += 0.5 * _of_batch(of_a, of_b, i, j, window, k)
            energy = late if window == 1 else soon
            for k in range(BATCHES):
                share = 1.0 / BATCHES
                if total > 0.0:
                    share = _of_batch(of_a, of_b, i, j, window, k) / total - 1.0 / BATCHES
                batches[i, j, k, window, band] += energy * share


@part(forceinline=True)
def _of_batch(of_a, of_b, i, j, window, k):
    """What batches `k` of both ends make: a sum that is the same whichever end is which."""
    one = of_a[0][i, j, window, k] + of_a[1][i, j, window, k]
    other = of_b[0][j, i, window, k] + of_b[1][j, i, window, k]
    return max(one, np.float32(0.0)) + max(other, np.float32(0.0))
