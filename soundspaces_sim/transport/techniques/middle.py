"""The middle: late sound between surfaces, which all points share.

A late path from p to q that is scattered on a patch is cut at the last such event before q, which is the first
one from q. With F_q(c, t) the energy that q's walks bring to patch c, scattered there for the first time, and
V_p(c, t) all that p's sound leaves on patch c, whether it came there straight or over other patches, the fluence
at q is

    sum over c of (4 / R_c) F_q(c) * V_p(c),        * over time, R_c = integral of rho s over the patch:

of what arrives at a point x of the patch, I_p and I_q per area, a path through x brings 4 pi (rho s / pi) I_p I_q
dA, where I_p may be taken as even over the patch. So each path is made exactly once, and neither end needs
walks that are long: `specular` leaves F; V is F and what follows along walks that the scene's points share
(`shared`). The same paths are made from q to p, with noise of their own for the shared part: both are averaged.

Sums over patches and times are matrix products (`convolve`), with blocks of fixed shape, because BLAS adds in
another order for other shapes. Tables are flattened: divided by a common decay, so that nothing is lost to
rounding and bins may be wide.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from soundspaces_sim.base.kernel import kernel, over_rows, part
from soundspaces_sim.base.rng import combine
from soundspaces_sim.echo.smooth import equal_bins
from soundspaces_sim.transport.convolve import Convolution, make_convolution
from soundspaces_sim.transport.firsts import Draws, Events, draw_events, gather_events
from soundspaces_sim.transport.model import EARLY_S, Model
from soundspaces_sim.transport.patches import inverse
from soundspaces_sim.transport.shared import SharedWalks
from soundspaces_sim.transport.spread import (
    Groups,
    add_batches,
    cell_of,
    empty_since,
    empty_sums,
    make_groups,
    since,
    sum_firsts,
)
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, WINDOWS, harmonics
from soundspaces_sim.transport.tile import Side, Tile

_STREAM = 0xD1CE  # keeps the draw of patches apart from others
_BLOCK = 16  # points on either side of a matrix product
_CHUNK = 1024  # patches in a matrix product
_DIRECTED = 512  # patches that tell where sound comes from, if there are more
_ROOM = 2**30  # bytes for tables of points that are held at once
_NOISE = 1e-5  # of the greatest value: what rounding leaves of nothing


class _Times(NamedTuple):
    """Stretches of equal bins. A table has a row for every step of every stretch, from time zero on."""

    step: np.ndarray  # (S,) m
    offset: np.ndarray  # (S,) m, by which bins are off multiples of the step
    steps: np.ndarray  # (S,) up to the end of the stretch
    base: np.ndarray  # (S + 1,) where its rows start


class _Stretch(NamedTuple):
    """What there is to know of a stretch outside kernels."""

    rows: slice  # of a table
    bins: slice  # of the echogram's late bins
    convolution: Convolution


@part(forceinline=True)
def _row(times, s, length):
    """Row of a table in stretch `s` for a length in m, -1 past its end.

    Two series are convolved, and each takes off a quarter of a step less than its half.
    """
    i = int(length / times.step[s] + 0.25)
    return times.base[s] + i if i < times.steps[s] else -1


@part(forceinline=True)
def _add(table, times, column, length, energy, scale):
    """Add `scale` of the energies (b,) of a length to a column of (rows, columns, b)."""
    for s in range(len(times.step)):
        row = _row(times, s, length)
        if row >= 0:
            for b in range(len(energy)):
                table[row, column, b] += scale * energy[b]


@kernel
def _fill_left(first, last, points, events, draws, shared, times, groups, out, kept, work):
    """What `points[first:last]` leave on the patches: `out` (b, n, rows, C) and, by batch, `kept` (see `spread`).

    `work`: a table (rows, C, b), and `spread.empty_sums`.
    """
    table, sums = work
    bands = events.energy.shape[1]
    for n in range(first, last):
        i = points[n]
        for row in range(len(table)):
            table[row] = 0.0
        sums[:] = 0.0
        for k in range(BATCHES):
            for r in range(events.start[i, k], events.start[i, k + 1]):
                patch, length, energy = events.patch[r], events.length[r], events.energy[r]
                _add(table, times, patch, length, energy, 1.0)
                group, step = cell_of(groups, patch, length)
                if step >= 0:
                    for b in range(bands):
                        sums[k, group, step, b] += energy[b]
            for d in range(draws.index.shape[2]):
                r = draws.index[i, k, d]
                if r < 0:
                    continue
                origin, walk, length = events.patch[r], draws.walk[i, k, d], events.length[r]
                energy, scale = events.energy[r], draws.scale[i, k, d]
                for e in range(shared.start[walk, origin], shared.start[walk, origin + 1]):
                    upto = length + shared.length[e]
                    patch = shared.patch[e]
                    group, step = cell_of(groups, patch, upto)
                    if step < 0:
                        continue
                    for b in range(bands):
                        sums[k, group, step, b] += scale * energy[b] * shared.energy[e, b]
                    for s in range(len(times.step)):
                        row = _row(times, s, upto)
                        if row >= 0:
                            for b in range(bands):
                                table[row, patch, b] += scale * energy[b] * shared.energy[e, b]
        since(groups, sums, kept, n)
        for b in range(bands):
            for row in range(len(table)):
                for c in range(table.shape[1]):
                    out[b, n, row, c] = table[row, c, b]


@kernel
def _fill_firsts(first, last, points, events, times, low, factor, band, out):
    """First events of `points[first:last]` on patches from `low` on in one band: to `out` (n, rows, columns)."""
    for n in range(first, last):
        i = points[n]
        for r in range(events.start[i, 0], events.start[i, BATCHES]):
            patch = events.patch[r]
            if patch < low or patch >= low + out.shape[2]:
                continue
            for s in range(len(times.step)):
                row = _row(times, s, max(events.length[r] - times.offset[s], 0.0))
                if row >= 0:
                    out[n, row, patch - low] += events.energy[r, band] * factor[patch, band]


@kernel
def _fill_directed(first, last, points, events, times, column, factor, band, out, y):
    """The same with nine harmonics in one band, to `out` (n, rows, 9, columns)."""
    for n in range(first, last):
        i = points[n]
        for r in range(events.start[i, 0], events.start[i, BATCHES]):
            patch = events.patch[r]
            at = column[patch]
            if at < 0:
                continue
            harmonics(events.direction[r, 0], events.direction[r, 1], events.direction[r, 2], y)
            value = events.energy[r, band] * factor[patch, band]
            for s in range(len(times.step)):
                row = _row(times, s, max(events.length[r] - times.offset[s], 0.0))
                if row >= 0:
                    for c in range(CHANNELS):
                        out[n, row, c, at] += y[c] * value


@kernel
def _take_own(first, last, events, times, factor, table, work):
    """Take off `table` (b, rows, n) what points as both ends make of a walk with itself.

    That leaves pairs of different walks, which are as good as those of two points. `work`: two arrays of as many
    integers as a batch has walks, and events.
    """
    newest, before = work
    for i in range(first, last):
        for k in range(BATCHES):
            start = events.start[i, k]
            newest[:] = -1
            for r in range(start, events.start[i, k + 1]):
                before[r - start] = newest[events.walk[r]]
                newest[events.walk[r]] = r
                o = r
                while o >= 0:
                    if events.patch[o] == events.patch[r]:
                        _take_pair(i, r, o, events, times, factor, table)
                        if o != r:
                            _take_pair(i, o, r, events, times, factor, table)
                    o = before[o - start]


@part
def _take_pair(i, r, o, events, times, factor, table):
    """Take off what first event `r` makes of `o` left on the same patch."""
    for s in range(len(times.step)):
        one = _row(times, s, events.length[o])
        two = _row(times, s, max(events.length[r] - times.offset[s], 0.0))
        row = one + two - times.base[s]
        if one >= 0 and two >= 0 and row < times.base[s + 1]:
            for b in range(len(table)):
                table[b, row, i] -= (
                    events.energy[r, b] * events.energy[o, b] * factor[events.patch[r], b]
                )


@kernel
def _deposit(first, last, columns, whole, back, directed, flat, first_bin, band, table):
    """Add to the columns of `table` (A, B, bins, 9, b) the mean of both ways.

    `whole` (bins, A, B) and `back` (bins, B, A): energy; `directed` (bins, A, n, 9) of the n `columns`: as seen by
    a part of the patches, of which the directions are taken; `flat` (bins,) undoes the flattening.
    """
    for n in range(first, last):
        j = columns[n]
        for i in range(len(table)):
            for t in range(len(flat)):
                energy = 0.5 * (whole[t, i, j] + back[t, j, i]) * flat[t]
                if energy <= 0.0:
                    continue
                row = table[i, j, first_bin + t]
                row[0, band] += energy
                seen = directed[t, i, n, 0]
                if seen > 0.0:
                    for c in range(1, CHANNELS):
                        row[c, band] += energy * min(max(directed[t, i, n, c] / seen, -1.0), 1.0)


def _late_bins(model: Model) -> tuple[int, np.ndarray]:
    """First late bin, and the edges in m of all late ones."""
    edges = model.time_edges * model.config.c
    first = int(np.searchsorted(edges, model.world.settings.late_length - 1e-6))
    return first, edges[first:]


def _stretches(edges: np.ndarray) -> tuple[_Times, list[_Stretch]]:
    """Stretches of equal bins between `edges`."""
    bounds = equal_bins(np.diff(edges))
    starts, ends = bounds[:-1], bounds[1:]
    step = (edges[ends] - edges[starts]) / (ends - starts)
    before = np.floor(edges[starts] / step + 1e-6).astype(np.int64)
    steps = before + ends - starts
    base = np.concatenate([[0], np.cumsum(steps)])
    times = _Times(step, np.maximum(edges[starts] - before * step, 0.0), steps, base)
    rows = [slice(*r) for r in pairwise(base)]
    bins = [slice(*r) for r in zip(starts, ends, strict=True)]
    convolutions = [make_convolution(*n) for n in zip(steps, before, strict=True)]
    return times, [_Stretch(*s) for s in zip(rows, bins, convolutions, strict=True)]


def _draw_directed(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Patches that tell directions, drawn evenly over what scatters, and the inverse of their probability."""
    weight = model.world.patches.weight
    if len(weight) <= _DIRECTED:
        return np.arange(len(weight)), np.ones(len(weight))
    strength = inverse(weight).mean(axis=1)
    low, high = 0.0, float(strength.max()) * len(strength)
    for _ in range(60):  # patches that are stronger than `high` are certain
        half = 0.5 * (low + high)
        low, high = (half, high) if np.minimum(strength / half, 1.0).sum() > _DIRECTED else (low, half)
    chance = np.minimum(strength / high, 1.0)
    u = combine(model.seed, _STREAM) / 2.0**64
    drawn = np.flatnonzero(np.diff(np.floor(np.cumsum(chance) + u), prepend=0.0) > 0.0)
    return drawn, 1.0 / chance[drawn]


def _blocks(count: int) -> list[np.ndarray]:
    """Numbers of points in blocks of `_BLOCK`, the last of which may be short."""
    return np.split(np.arange(count), range(_BLOCK, count, _BLOCK))


class _Plan(NamedTuple):
    """What is the same for all points of a tile."""

    times: _Times
    stretches: list[_Stretch]
    groups: Groups
    shared: SharedWalks
    factor: np.ndarray  # (C, b) 4 / R
    directed: np.ndarray  # patches that tell directions
    directed_column: np.ndarray  # (C,) number among these, -1 for none
    directed_factor: np.ndarray  # (C, b) 4 / R, over the probability that it is one of these

    @property
    def rows(self) -> int:
        return int(self.times.base[-1])


def _plan(model: Model) -> _Plan:
    weight, (_, edges) = model.world.patches.weight, _late_bins(model)
    latest = EARLY_S * model.config.c + model.scene.diagonal  # of no tile: bits depend on none
    groups = make_groups(model.patch_groups, weight, float(edges[-1]), latest, model.shared.decay)
    directed, scale = _draw_directed(model)
    column, factor = np.full(len(weight), -1), (4.0 * weight).astype(np.float32)
    column[directed] = np.arange(len(directed))
    directed_factor = factor.copy()
    directed_factor[directed] *= scale[:, None].astype(np.float32)
    return _Plan(*_stretches(edges), groups, model.shared, factor, directed, column, directed_factor)


class _End(NamedTuple):
    """One side of a tile: where its walks are first scattered, which of these events go on, and what batches of
    them have from each step on (`spread.empty_since`)."""

    events: Events
    draws: Draws
    since: np.ndarray  # (b, N, groups, kept + 1, BATCHES + 1)


def _end(model: Model, plan: _Plan, side: Side) -> _End:
    events = gather_events(side.firsts, model.shared.decay)
    wanted = model.world.settings.specular // BATCHES  # as many go on as there are walks
    draws = draw_events(events, side.ends.keys, wanted, len(model.shared.start))
    return _End(events, draws, sum_firsts(events, plan.groups))


def _transform(stretch: _Stretch, table: np.ndarray) -> np.ndarray:
    """(R, _BLOCK, columns) of a table (n, rows, columns) of a block's points, zero beyond them.

    A product for every point, so that it has the same shape for any number of them.
    """
    forward = stretch.convolution.forward
    out = np.zeros((len(forward), _BLOCK, table.shape[2]), np.float32)
    np.matmul(forward, table[:, stretch.rows], out=out[:, : len(table)].transpose(1, 0, 2))
    return out


def _meet(stretch: _Stretch, of_p: np.ndarray, of_q: np.ndarray) -> np.ndarray:
    """(bins, p, q) of the transforms (R, p, columns) and (R, q, columns)."""
    met = np.matmul(of_p, of_q.transpose(0, 2, 1))
    out = stretch.convolution.back @ met.reshape(len(met), -1)
    return np.asarray(out.reshape(-1, *met.shape[1:]))


class _Left(NamedTuple):
    """What one side leaves."""

    directed: list[
        list[list[np.ndarray]]
    ]  # by band, block and stretch, the transforms on patches that tell directions
    since: np.ndarray  # (b, N, groups, kept + 1, BATCHES + 1), as `spread.empty_since`


def _leave(plan: _Plan, of: _End, to: _End, whole: np.ndarray) -> _Left:
    """What the points of one side leave on the patches; adds to `whole` (b, bins, P, Q) what the first events of
    the other side's points make of it."""
    bands, patches = len(whole), len(plan.factor)
    p_blocks, q_blocks = _blocks(len(of.events.start)), _blocks(len(to.events.start))
    directed: list[list[list[np.ndarray]]] = [[[] for _ in p_blocks] for _ in range(bands)]
    parts = []
    held = max(_ROOM // (4 * bands * plan.rows * patches * _BLOCK), 1)
    for low in range(0, len(p_blocks), held):
        blocks = p_blocks[low : low + held]
        points = np.concatenate(blocks)
        fine = np.empty((bands, len(points), plan.rows, patches), np.float32)
        parts.append(empty_since(plan.groups, len(points)))
        over_rows(
            _fill_left, len(points), points, of.events, of.draws, plan.shared, plan.times, plan.groups,
            fine, parts[-1], chunk=1,
            scratch=lambda: (np.empty((plan.rows, patches, bands), np.float32), empty_sums(plan.groups)),
        )  # fmt: skip
        for band in range(bands):
            for start in range(0, patches, _CHUNK):
                ready = _ready(plan, fine[band, :, :, start : start + _CHUNK])
                _meet_all(plan, ready, to.events, q_blocks, band, start, whole[band], low)
            for n, ready_block in enumerate(_ready(plan, fine[band][:, :, plan.directed])):
                directed[band][low + n] = ready_block
    return _Left(directed, np.concatenate(parts, axis=1))


def _ready(plan: _Plan, table: np.ndarray) -> list[list[np.ndarray]]:
    """Transforms, by block of points and stretch, of a table (n, rows, columns)."""
    out: list[list[np.ndarray]] = [[] for _ in range(-(-len(table) // _BLOCK))]

    def call(first: int, last: int) -> None:
        for n in range(first, last):
            block = table[n * _BLOCK : (n + 1) * _BLOCK]
            out[n] = [_transform(stretch, block) for stretch in plan.stretches]

    over_rows(call, len(out), chunk=1)
    return out


def _meet_all(
    plan: _Plan, ready: list[list[np.ndarray]], events: Events, q_blocks: list[np.ndarray], band: int,
    start: int, whole: np.ndarray, low: int,
) -> None:  # fmt: skip
    """Add to `whole` (bins, P, Q) what blocks of points, from number `low` on, have left on patches from
    `start`."""
    width = min(_CHUNK, len(plan.factor) - start)

    def call(first: int, last: int) -> None:
        for q in range(first, last):
            real = len(q_blocks[q])
            table = np.zeros((real, plan.rows, width), np.float32)
            _fill_firsts(0, real, q_blocks[q], events, plan.times, start, plan.factor, band, table)
            columns = slice(q * _BLOCK, (q + 1) * _BLOCK)
            for n, stretch in enumerate(plan.stretches):
                of_q = _transform(stretch, table)
                for p, block in enumerate(ready):
                    rows = slice((low + p) * _BLOCK, (low + p + 1) * _BLOCK)
                    met = _meet(stretch, block[n], of_q)
                    out = whole[stretch.bins, rows, columns]
                    out += met[:, : out.shape[1], : out.shape[2]]

    over_rows(call, len(q_blocks), chunk=1)


def _direct(
    plan: _Plan, left: _Left, events: Events, band: int, whole: np.ndarray, back: np.ndarray,
    flat: np.ndarray, first_bin: int, table: np.ndarray,
) -> None:  # fmt: skip
    """Deposit in a tile's table, with the directions from which sound comes."""
    q_blocks, bins, points = _blocks(len(events.start)), len(flat), len(table)

    def call(first: int, last: int) -> None:
        for q in range(first, last):
            real = len(q_blocks[q])
            firsts = np.zeros((real, plan.rows, CHANNELS, len(plan.directed)), np.float32)
            _fill_directed(
                0, real, q_blocks[q], events, plan.times, plan.directed_column, plan.directed_factor,
                band, firsts, np.empty(CHANNELS),
            )  # fmt: skip
            firsts = firsts.reshape(real, plan.rows, -1)
            seen = np.empty((bins, len(left.directed[band]) * _BLOCK, _BLOCK, CHANNELS), np.float32)
            for n, stretch in enumerate(plan.stretches):
                of_q = _transform(stretch, firsts).reshape(-1, _BLOCK * CHANNELS, len(plan.directed))
                for p, block in enumerate(left.directed[band]):
                    met = _meet(stretch, block[n], of_q)
                    seen[stretch.bins, p * _BLOCK : (p + 1) * _BLOCK] = met.reshape(
                        *seen[stretch.bins, :_BLOCK].shape
                    )
            _quieten(plan, seen[..., :1])
            _deposit(
                0, real, q_blocks[q], whole, back, seen[:, :points], flat, first_bin, band, table
            )  # fmt: skip

    over_rows(call, len(q_blocks), chunk=1)


def _quieten(plan: _Plan, table: np.ndarray) -> None:
    """Set to zero what rounding has left in (bins, …)."""
    for stretch in plan.stretches:
        late = table[stretch.bins]
        late[late < _NOISE * late.max(axis=0)] = 0.0


def _without_own(
    plan: _Plan, keys: tuple[np.ndarray, np.ndarray], events: Events, whole: np.ndarray
) -> None:
    """Take off `whole` (b, bins, P, Q) pairs of a walk with itself, where a row is the same point as a column."""
    i, j = np.nonzero(keys[0][:, None] == keys[1][None, :])
    if len(i) == 0:
        return
    own = np.zeros((len(whole), plan.rows, len(keys[1])), np.float32)
    most, walks = int(np.diff(events.start, axis=1).max()), int(events.walk.max(initial=0)) + 1
    over_rows(
        _take_own, len(keys[1]), events, plan.times, plan.factor, own, chunk=1,
        scratch=lambda: (np.empty(walks, np.int64), np.empty(most, np.int64)),
    )  # fmt: skip
    for stretch in plan.stretches:
        late = slice(stretch.rows.stop - (stretch.bins.stop - stretch.bins.start), stretch.rows.stop)
        whole[:, stretch.bins, i, j] += own[:, late][:, :, j]


def close(tile: Tile) -> None:
    """Late paths of every pair."""
    model = tile.model
    if not model.world.settings.merging:
        return
    plan = _plan(model)
    first_bin, edges = _late_bins(model)
    a = _end(model, plan, tile.a)
    b = a if tile.same else _end(model, plan, tile.b)
    keys = tile.a.ends.keys, tile.b.ends.keys

    def one_way(of: _End, to: _End, ways: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, _Left]:
        whole = np.zeros(
            (model.world.air.shape[1], len(edges) - 1, len(ways[0]), len(ways[1])), np.float32
        )
        left = _leave(plan, of, to, whole)
        _without_own(plan, ways, to.events, whole)
        for of_band in whole:
            _quieten(plan, of_band)
        return whole, left

    with threadpool_limits(
        limits=1, user_api="blas"
    ):  # our own threads, each with products of one shape
        there, left_a = one_way(a, b, keys)
        back, left_b = (there, left_a) if tile.same else one_way(b, a, keys[::-1])
        for band in range(len(there)):
            flat = _flat(edges, float(model.shared.decay[band]))
            _direct(plan, left_a, b.events, band, there[band], back[band], flat, first_bin, tile.to_b)
            if not tile.same and tile.to_a.shape[2] > 0:
                _direct(
                    plan, left_b, a.events, band, back[band], there[band], flat, first_bin, tile.to_a
                )
            over_rows(
                add_batches, len(tile.pairs), tile.pairs, there[band], back[band], flat, edges[:-1], edges[1:],
                tile.early_length, a.since[band], b.since[band], left_a.since[band],
                left_b.since[band], band, tile.batches,
                scratch=lambda: np.empty((WINDOWS, 2, 2, BATCHES), np.float32),
            )  # fmt: skip
            _note_difference(tile.difference[..., band], there[band], back[band], flat)


def _note_difference(
    difference: np.ndarray, there: np.ndarray, back: np.ndarray, flat: np.ndarray
) -> None:
    """Add half of what (bins, A, B) and (bins, B, A) differ by to `difference` (A, B, bins), if it has any bins.

    That misses the part of their noise that both owe to the first events of the two ends.
    """
    bins = difference.shape[2]
    if bins > 0:
        for i in range(len(difference)):
            difference[i] += (0.5 * flat[-bins:, None] * (there[-bins:, i] - back[-bins:, :, i])).T


def _flat(edges: np.ndarray, decay: float) -> np.ndarray:
    """(bins,) what undoes the flattening: the mean over a bin of exp(-decay length)."""
    half = 0.5 * decay * np.diff(edges)
    mean = np.divide(np.sinh(half), half, out=np.ones_like(half), where=half > 1e-6)
    return np.asarray(np.exp(-0.5 * decay * (edges[1:] + edges[:-1])) * mean)
