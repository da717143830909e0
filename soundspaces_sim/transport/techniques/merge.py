"""Where the halves of late paths are merged.

A late path from p to q is cut at one diffuse event x and made from a walk of p and a walk of q that meet
on one patch. With I_p the energy per area that arrives at x from p, the fluence at q is

    integral over x of 4 pi (rho s / pi) I_p(x) I_q(x) dA,

where times add up. Walks of p that arrive on a patch and are scattered there carry
T_p = integral of rho s I_p dA; where I varies little over a patch, its part of the fluence is
4 T_p T_q / R, R = integral of rho s dA. So every event of p's walks on the patch is multiplied with
every event of q's: samples grow as the product of both ends' walks.

Which x: the diffuse event nearest to the middle of the path's length. Between event k and its neighbours
that is decided by the two halves alone. With l the length of a half at x and l' at its previous event,
x is the nearest to the middle if and only if the intervals (l'_p, l_p) and (l'_q, l_q) overlap: of
two halves with l_p >= l_q, the middle is nearer to x than to p's previous event if and only if
l'_p <= l_q. So each path is made exactly once, and from p to q as from q to p.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.base.kernel import kernel, over_rows, part
from soundspaces_sim.transport.patches import GROUPS
from soundspaces_sim.transport.state import Halves, SortedHalves
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, WINDOWS, time_bin
from soundspaces_sim.transport.tile import Tile

_CHUNK = 32  # pairs per call


@kernel
def _sort_halves(halves, order, start, filled):
    """Fill the order of each point's halves by (patch, length), and the start (N, C + 1) of each patch."""
    for i in range(len(halves.count)):
        start[i, :] = 0
        filled[:] = 0
        for k in range(halves.count[i]):
            start[i, halves.patch[i, k] + 1] += 1
        for c in range(len(filled)):
            start[i, c + 1] += start[i, c]
        for k in range(halves.count[i]):  # insertion: a patch holds few
            c = halves.patch[i, k]
            at = start[i, c] + filled[c]
            while at > start[i, c] and halves.length[i, order[i, at - 1]] > halves.length[i, k]:
                order[i, at] = order[i, at - 1]
                at -= 1
            order[i, at] = k
            filled[c] += 1


def sort_halves(halves: Halves, patches: int) -> tuple[np.ndarray, np.ndarray]:
    """Order of each point's halves by (patch, length), and the start (N, patches + 1) of each patch."""
    order = np.empty(halves.patch.shape, np.int64)
    start = np.empty((len(halves.count), patches + 1), np.int64)
    _sort_halves(halves, order, start, np.empty(patches, np.int64))
    return order, start


class _Pair(NamedTuple):
    """Where one pair's merges deposit."""

    to_q: np.ndarray  # (bins, 9 b) of p -> q; no bins: not wanted
    to_p: np.ndarray  # (bins, 9 b) of q -> p
    early_length: float


class _Work(NamedTuple):
    """Working arrays of one pair's merges."""

    product: np.ndarray  # (most, 9 b) harmonics times weight of q's halves on a patch
    tiled: np.ndarray  # (most, 9 b) their weight, repeated
    own_product: np.ndarray  # (9 b,) of one half of p
    own_tiled: np.ndarray
    scale: np.ndarray  # (b,)
    one: np.ndarray  # (b,)
    between: np.ndarray  # (BATCHES, BATCHES, WINDOWS, b)


@part(forceinline=True)
def _expand(directions, beta, scale, product, tiled):
    """Weights for every harmonic, with and without the harmonic itself: (9 b,) each."""
    bands = len(beta)
    for c in range(CHANNELS):
        for b in range(bands):
            weight = beta[b] * scale[b]
            product[c * bands + b] = directions[c] * weight
            tiled[c * bands + b] = weight


@part(forceinline=True, fastmath={"contract"})
def _add_product(row, a, b):
    for k in range(len(a)):
        row[k] += a[k] * b[k]


@part
def _merge_pair(settings, bin_of_step, weights, pair, p, i, q, j, work):
    """Merge row `i` of p with row `j` of q; energies by batch of either end go to `work.between`.

    On a patch q's halves are expanded once; then each of p's meets those whose interval overlaps.
    """
    bands = weights.shape[1]
    same = p.keys[i] == q.keys[j]  # of one point, only walks of different batches meet
    factor = settings.own_meeting if same else settings.meeting
    forth, back = pair.to_q.shape[0] > 0, pair.to_p.shape[0] > 0
    work.between[:] = 0.0
    for patch in range(len(weights)):
        p0, p1 = p.start[i, patch], p.start[i, patch + 1]
        q0, q1 = q.start[j, patch], q.start[j, patch + 1]
        if p0 == p1 or q0 == q1:
            continue
        for b in range(bands):
            work.scale[b] = weights[patch, b] * factor
        for k in range(q0, q1):
            row = k - q0
            _expand(q.first[j, q.walk[k]], q.beta[k], work.scale, work.product[row], work.tiled[row])
        for m in range(p0, p1):
            length_p, previous_p, group_p = p.length[m], p.previous[m], p.walk[m] % GROUPS
            _expand(p.first[i, p.walk[m]], p.beta[m], work.one, work.own_product, work.own_tiled)
            for k in range(q1 - 1, q0 - 1, -1):
                length_q = q.length[k]
                if length_q < previous_p:
                    break  # sorted: the rest are shorter
                length = length_p + length_q
                offset = (q.walk[k] - group_p - 1) % GROUPS
                if q.previous[k] > length_p or length <= settings.late_length:
                    continue
                if offset >= settings.meetings or (same and (offset + 1) % BATCHES == 0):
                    continue
                bin_index = time_bin(length, bin_of_step, settings.step)
                if bin_index < 0:
                    continue
                product, tiled = work.product[k - q0], work.tiled[k - q0]
                if forth:
                    _add_product(pair.to_q[bin_index], product, work.own_tiled)
                if back:
                    _add_product(pair.to_p[bin_index], work.own_product, tiled)
                late = 1 if length > pair.early_length else 0
                for b in range(bands):
                    work.between[group_p % BATCHES, q.walk[k] % BATCHES, late, b] += (
                        tiled[b] * work.own_tiled[b]
                    )


@part
def _spread_batches(between, batches):
    """Add (BATCHES, BATCHES, …) energies to (BATCHES, …) so that sum and jackknife variance are right.

    Leaving batch k out of both ends leaves (15/16)² of the mean; to first order that is what the
    variance of the values below measures. Their sum is set to the total.
    """
    for late in range(between.shape[2]):
        for b in range(between.shape[3]):
            total, shift = 0.0, 0.0
            for k in range(BATCHES):
                part = -between[k, k, late, b]
                for m in range(BATCHES):
                    part += between[k, m, late, b] + between[m, k, late, b]
                    total += between[k, m, late, b]
                part *= BATCHES / (BATCHES - 1.0)
                shift += part
                batches[k, late, b] += part
            for k in range(BATCHES):
                batches[k, late, b] += (total - shift) / BATCHES


@kernel
def _merge_pairs(
    first, last, settings, bin_of_step, weights, pairs, a, b, early_length, to_b, to_a, batches, work
):
    """Merge the halves of each (row of a, row of b) in `pairs` from `first` to `last`.

    `weights` (C, b) of the patches, all constants included. `to_b`
    (A, B, bins, 9 b), `to_a` (B, A, bins, 9 b) or no bins, as in `connect`; the point with the smaller key
    plays p, so that a pair's result does not depend on which side it is on.
    """
    for n in range(first, last):
        i, j = pairs[n, 0], pairs[n, 1]
        forth, back = to_b[i, j], to_a[j, i]
        if a.keys[i] == b.keys[j]:
            back = back[:0]
        if a.keys[i] <= b.keys[j]:
            pair = _Pair(forth, back, early_length[i, j])
            _merge_pair(settings, bin_of_step, weights, pair, a, i, b, j, work)
        else:
            pair = _Pair(back, forth, early_length[i, j])
            _merge_pair(settings, bin_of_step, weights, pair, b, j, a, i, work)
        _spread_batches(work.between, batches[i, j])


def _gather(parts: list[SortedHalves]) -> SortedHalves:
    """The halves of all points of a side."""
    before = np.concatenate([[0], np.cumsum([len(part.length) for part in parts])[:-1]])
    moved = [p._replace(start=p.start + n) for p, n in zip(parts, before, strict=True)]
    return SortedHalves(*(np.concatenate(column) for column in zip(*moved, strict=True)))


def _make_work(most: int, bands: int) -> _Work:
    """For up to `most` halves on a patch."""
    width = CHANNELS * bands
    return _Work(
        np.empty((most, width), np.float32), np.empty((most, width), np.float32),
        np.empty(width, np.float32), np.empty(width, np.float32), np.empty(bands, np.float32),
        np.ones(bands, np.float32), np.empty((BATCHES, BATCHES, WINDOWS, bands)),
    )  # fmt: skip


def close(tile: Tile) -> None:
    """Merge the halves of every pair."""
    world, pairs = tile.model.world, tile.pairs
    if not world.settings.merging:
        return
    a = _gather(tile.a.halves)
    b = a if tile.same else _gather(tile.b.halves)
    most = max(int(np.diff(side.start, axis=1).max(initial=1)) for side in (a, b))

    def flat(table: np.ndarray) -> np.ndarray:
        return table.reshape(*table.shape[:3], table.shape[3] * table.shape[4])  # a view

    over_rows(
        _merge_pairs, len(pairs), world.settings, world.bin_of_step, 4.0 * world.patches.weight, pairs, a, b,
        tile.early_length, flat(tile.to_b), flat(tile.to_a), tile.batches, chunk=_CHUNK,
        scratch=lambda: _make_work(most, world.air.shape[1]),
    )  # fmt: skip
