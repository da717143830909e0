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

from soundspaces_sim.base.kernel import kernel, over_rows, part
from soundspaces_sim.rays.geometry import Geometry, visible
from soundspaces_sim.transport.firsts import Events
from soundspaces_sim.transport.patches import Patches, inverse
from soundspaces_sim.transport.tables import BATCHES, WINDOWS

_SIZE = 1.6  # m, edge of the lattice in whose cells patches are grouped
_LIFT = 0.1  # m above patches, where they must see each other
_STEP = 3.4  # m, as long as windows may start
_LATER = 24  # wider steps from there on


class Groups(NamedTuple):
    """Groups of patches and wide steps of time: `kept` of `_STEP`, and `_LATER` of `step` after them."""

    group: np.ndarray  # (C,)
    factor: np.ndarray  # (C, b) 1 / R of the whole group
    kept: int
    step: float  # m
    flat: np.ndarray  # (kept + _LATER, b) undoes the flattening

    @property
    def number(self) -> int:
        return _number(self.group)


def _number(group: np.ndarray) -> int:
    return int(group.max(initial=-1)) + 1


def make_groups(
    group: np.ndarray, weight: np.ndarray, longest: float, late: float, decay: np.ndarray
) -> Groups:
    """Groups for tables of paths of up to `longest` m, flattened by `decay` (b,), and windows that start before
    `late` m; `group` (C,) as `group_patches` gives it, `weight` (C, b) of the patches."""
    strength = [np.bincount(group, s, _number(group)) for s in inverse(weight).T]
    whole = inverse(np.stack(strength, axis=1))
    kept = int(min(late, longest) / _STEP + 0.5)
    step = max(longest - kept * _STEP, _STEP) / _LATER
    middles = np.concatenate(
        [(np.arange(kept) + 0.5) * _STEP, kept * _STEP + (np.arange(_LATER) + 0.5) * step]
    )
    return Groups(group, whole[group], kept, step, np.exp(-middles[:, None] * decay))


def group_patches(geometry: Geometry, patches: Patches) -> np.ndarray:
    """(C,) group of every patch: those of one lattice cell that see each other, if only by way of others of it."""
    count, places = len(patches.weight), patches.places
    own = np.repeat(np.arange(count), np.diff(places.start))
    center = places.corners.mean(axis=1)
    off = np.linalg.norm(center - patches.middle[own], axis=1)
    nearest = np.lexsort((off, own))[places.start[:-1]]
    seen_from = center[nearest] + _LIFT * places.normal[nearest]
    _, cell = np.unique(np.floor(patches.middle / _SIZE).astype(np.int64), axis=0, return_inverse=True)
    sizes = np.bincount(cell.ravel())
    members = np.split(np.argsort(cell.ravel(), kind="stable"), np.cumsum(sizes)[:-1])
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


def empty_sums(groups: Groups) -> np.ndarray:
    """Room for what batches of a point bring to groups in each step, flattened: (BATCHES, groups, steps, b)."""
    return np.empty((BATCHES, groups.number, *groups.flat.shape), np.float32)


def empty_since(groups: Groups, points: int) -> np.ndarray:
    """Room for what `since` makes of it: (b, points, groups, kept + 1, BATCHES + 1)."""
    shape = groups.flat.shape[1], points, groups.number, groups.kept + 1, BATCHES + 1
    return np.empty(shape, np.float32)


@part
def since(groups, sums, out, n):
    """Row `n` of `empty_since`: what `sums` have from each step on, not flattened; the sum over batches last."""
    steps, bands = groups.flat.shape
    for k in range(BATCHES):
        for g in range(sums.shape[1]):
            for t in range(steps - 1, -1, -1):
                for b in range(bands):
                    sums[k, g, t, b] *= groups.flat[t, b]
                    if t < steps - 1:
                        sums[k, g, t, b] += sums[k, g, t + 1, b]
    for b in range(bands):
        for g in range(sums.shape[1]):
            for t in range(groups.kept + 1):
                row, total = out[b, n, g, t], np.float32(0.0)
                for k in range(BATCHES):
                    row[k] = sums[k, g, t, b]
                    total += row[k]
                row[BATCHES] = total


@part(forceinline=True)
def cell_of(groups, patch, length):
    """(group, step) of sound on a patch, step -1 if it is longer than what is wanted."""
    step = int(length / _STEP)
    if step >= groups.kept:
        step = groups.kept + int((length - groups.kept * _STEP) / groups.step)
    return groups.group[patch], step if step < len(groups.flat) else -1


@kernel
def _sum_firsts(first, last, events, groups, out, sums):
    """First events of the points `first` to `last` by batch, as `empty_since`."""
    for i in range(first, last):
        sums[:] = 0.0
        for k in range(BATCHES):
            for r in range(events.start[i, k], events.start[i, k + 1]):
                patch = events.patch[r]
                group, step = cell_of(groups, patch, events.length[r])
                if step >= 0:
                    for b in range(events.energy.shape[1]):
                        sums[k, group, step, b] += events.energy[r, b] * groups.factor[patch, b]
        since(groups, sums, out, i)


def sum_firsts(events: Events, groups: Groups) -> np.ndarray:
    """First events of all points by batch, as `empty_since`."""
    out = empty_since(groups, len(events.start))
    over_rows(_sum_firsts, out.shape[1], events, groups, out, scratch=lambda: empty_sums(groups))
    return out


@part
def _one_way(left, firsts, step, own, others):
    """Half of what one end leaves and the other end's first events make from `step` on, by batches of either end.

    Both as a row of `empty_since`: (groups, kept + 1, BATCHES + 1). First events of step t meet what was left from
    step - 1 - t on (both are rounded down); those of `step` and later meet all.
    """
    half = np.float32(0.5)
    for g in range(len(left)):
        for t in range(step + 1):
            last, rest = t == step, max(step - 1 - t, 0)
            mine = firsts[g, t, BATCHES] if last else firsts[g, t, BATCHES] - firsts[g, t + 1, BATCHES]
            if mine == 0.0:
                continue
            mine, theirs = half * mine, half * left[g, rest, BATCHES]
            # Read by index: views of rows keep these loops from vector instructions and cost three times as much.
            for k in range(BATCHES):
                own[k] += mine * left[g, rest, k]
            if last:
                for k in range(BATCHES):
                    others[k] += theirs * firsts[g, t, k]
            else:
                for k in range(BATCHES):
                    others[k] += theirs * (firsts[g, t, k] - firsts[g, t + 1, k])


@kernel
def add_batches(
    first, last, pairs, whole, back, flat, starts, ends, early, firsts_a, firsts_b, left_a, left_b, band,
    batches, parts,
):  # fmt: skip
    """Split the energy of each of the `pairs` `first` to `last` between batches of walks.

    `whole` (bins, A, B) and `back` (bins, B, A): flattened energy of bins from `starts` to `ends`; `flat` undoes
    it; `early` (A, B) where windows end; `firsts_a` … (N, groups, kept + 1, BATCHES + 1) of either side; `parts`
    (WINDOWS, 2, 2, BATCHES) is scratch.
    """
    steps = firsts_a.shape[2] - 1
    for n in range(first, last):
        i, j = pairs[n, 0], pairs[n, 1]
        soon, late = 0.0, 0.0
        for t in range(len(flat)):
            value = 0.5 * (whole[t, i, j] + back[t, j, i]) * flat[t]
            share = min(max((early[i, j] - starts[t]) / (ends[t] - starts[t]), 0.0), 1.0)
            soon, late = soon + share * value, late + (1.0 - share) * value
        parts[:] = 0.0
        for window in range(WINDOWS):
            at = min(int((early[i, j] if window == 1 else starts[0]) / _STEP + 0.5), steps)
            _one_way(left_a[i], firsts_b[j], at, parts[window, 0, 0], parts[window, 1, 1])
            _one_way(left_b[j], firsts_a[i], at, parts[window, 1, 0], parts[window, 0, 1])
            for end in range(2):  # one sum of two: the same whichever end is which
                for k in range(BATCHES):
                    parts[window, end, 0, k] += parts[window, end, 1, k]
        for end in range(2):  # what is not late is early
            for k in range(BATCHES):
                parts[0, end, 0, k] = max(parts[0, end, 0, k] - parts[1, end, 0, k], 0.0)
        for window in range(WINDOWS):
            total = 0.0
            for k in range(BATCHES):
                total += 0.5 * (parts[window, 0, 0, k] + parts[window, 1, 0, k])
            energy = late if window == 1 else soon
            for k in range(BATCHES):
                share = 1.0 / BATCHES
                if total > 0.0:
                    share = (parts[window, 0, 0, k] + parts[window, 1, 0, k]) / total - 1.0 / BATCHES
                batches[i, j, k, window, band] += energy * share
