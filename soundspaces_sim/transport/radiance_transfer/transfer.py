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

Sums over patches and times are matrix products (`convolve`), a chunk of patches at a time (`at_patches`), with
blocks of fixed shape, because BLAS adds in another order for other shapes. Tables are flattened: divided by a
common decay, so that nothing is lost to rounding and bins may be wide. Air is left out of them: what it leaves of
a band is a function of the whole path, not a product over its parts. It is put to the sums, at the middles of bins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, thread_count
from soundspaces_sim.core.numerics.rng import combine
from soundspaces_sim.transport.model import Model, air_transmission
from soundspaces_sim.transport.radiance_transfer.batch_variance import (
    COLUMNS,
    STEPS,
    Groups,
    add_batches,
    add_products,
    make_groups,
)
from soundspaces_sim.transport.radiance_transfer.convolution import (
    BLOCK,
    Convolution,
    meet,
    multiply,
    padded,
    transform,
    turn_back,
)
from soundspaces_sim.transport.radiance_transfer.first_reflections import (
    Draws,
    Events,
    FirstReflections,
    draw_events,
    gather_events,
)
from soundspaces_sim.transport.radiance_transfer.patch_histograms import (
    Coarse,
    Stretch,
    Times,
    coarse_rows,
    fill_brought,
    fill_directed,
    fill_left,
    fill_own,
    make_coarse,
    make_stretches,
)
from soundspaces_sim.transport.radiance_transfer.patches import inverse
from soundspaces_sim.transport.radiance_transfer.prepared import patch_groups, transfer_subpaths
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import CHUNK, SharedWalks
from soundspaces_sim.transport.tables import BATCHES, CHANNELS
from soundspaces_sim.transport.tile import Side, Tile

_STREAM = 0xD1CE  # keeps the draw of patches apart from others
DIRECTED = 512  # patches that tell where sound comes from, if there are more
_NOISE = 1e-5  # of the greatest value: what rounding leaves of nothing


class _Plan(NamedTuple):
    """What is the same for all points of a tile."""

    times: Times
    stretches: list[Stretch]
    coarse: Coarse
    groups: Groups
    shared: SharedWalks
    factor: np.ndarray  # (C, b) 4 / R
    directed: np.ndarray  # (D,) patches that tell directions, in order
    directed_column: np.ndarray  # (C,) number among these, -1 for none
    directed_factor: np.ndarray  # (C, b) 4 / R, over the probability that it is one of these
    first_bin: int  # that is late
    edges: np.ndarray  # m, of late bins
    flat: np.ndarray  # (late bins, b) undoes the flattening

    @property
    def chunk(self) -> int:
        """Patches of a chunk that there is room for."""
        return min(CHUNK, len(self.factor))


def _plan(model: Model) -> _Plan:
    weight, shared = model.world.patches.weight, model.once(transfer_subpaths)
    edges = model.time_edges * model.config.c
    first_bin = int(np.searchsorted(edges, model.world.settings.late_length - 1e-6))
    edges = edges[first_bin:]
    times, stretches = make_stretches(edges)
    coarse = make_coarse(times, edges, model.config.c)
    groups = make_groups(model.once(patch_groups), weight, float(edges[-1]))
    directed, scale = _draw_directed(model)
    column, factor = np.full(len(weight), -1), (4.0 * weight).astype(np.float32)
    column[directed] = np.arange(len(directed))
    directed_factor = factor.copy()
    directed_factor[directed] *= scale[:, None].astype(np.float32)
    return _Plan(
        times, stretches, coarse, groups, shared, factor, directed, column, directed_factor, first_bin,
        edges, _flat(edges, shared.decay, model.config),
    )  # fmt: skip


def _flat(edges: np.ndarray, decay: np.ndarray, config: SimulationConfig) -> np.ndarray:
    """(bins, b) what undoes the flattening, the mean over a bin of exp(-decay length), times what air leaves."""
    part = decay * np.diff(edges)[:, None]
    mean = np.divide(-np.expm1(-part), part, out=np.ones_like(part), where=part > 1e-9)
    left = air_transmission(config, 0.5 * (edges[1:] + edges[:-1]))
    return np.asarray(np.exp(-decay * edges[:-1, None]) * mean * left)


def _draw_directed(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Patches that tell directions, drawn evenly over what scatters, and the inverse of their probability."""
    weight = model.world.patches.weight
    if len(weight) <= DIRECTED:
        return np.arange(len(weight)), np.ones(len(weight))
    strength = inverse(weight).mean(axis=1)
    low, high = 0.0, float(strength.max()) * len(strength)
    for _ in range(60):  # patches that are stronger than `high` are certain
        half = 0.5 * (low + high)
        low, high = (half, high) if np.minimum(strength / half, 1.0).sum() > DIRECTED else (low, half)
    chance = np.minimum(strength / high, 1.0)
    u = combine(model.seed, _STREAM) / 2.0**64
    drawn = np.flatnonzero(np.diff(np.floor(np.cumsum(chance) + u), prepend=0.0) > 0.0)
    return drawn, 1.0 / chance[drawn]


class _End(NamedTuple):
    """One side of a tile: where its walks are first scattered, and which of these events go on."""

    events: Events
    draws: Draws
    keys: np.ndarray  # of its points

    @property
    def points(self) -> int:
        return len(self.keys)


def _end(model: Model, side: Side) -> _End:
    shared = model.once(transfer_subpaths)
    events = gather_events(side.once(FirstReflections.of).blocks, shared.decay, shared.reach)
    wanted = model.world.settings.specular // BATCHES  # as many go on as there are walks
    keys = side.ends.keys
    return _End(events, draw_events(events, keys, wanted, len(shared.start)), keys)


class _Way(NamedTuple):
    """From the P points of one side to the Q of the other."""

    whole: np.ndarray  # (b, P, Q, late bins) energy, flattened
    left: np.ndarray  # (b, P, BATCHES, Q, STEPS) by batch of what is left: see `add_products`
    brought: np.ndarray  # (b, Q, BATCHES, P, STEPS) by batch of what is brought
    directed: np.ndarray  # (b, P, coarse rows, D) what the points leave on patches that tell directions


class _Room(NamedTuple):
    """What is filled anew for every chunk of patches."""

    left: np.ndarray  # (b, P, rows, columns)
    brought: np.ndarray  # (b, Q, rows, columns)
    one: np.ndarray  # (R, P', columns) transforms of these, P filled up to whole blocks
    other: np.ndarray  # (R, Q', columns)
    met: np.ndarray  # (R, P' Q') of as many of the Q as are held at once


def _room(plan: _Plan, of: _End, to: _End) -> _Room:
    bands, rows = plan.factor.shape[1], plan.times.rows
    products = max(len(stretch.convolution.forward) for stretch in plan.stretches)
    p, q = padded(of.points), padded(to.points)
    return _Room(
        np.empty((bands, of.points, rows, plan.chunk), np.float32),
        np.empty((bands, to.points, rows, plan.chunk), np.float32),
        np.zeros((products, p, plan.chunk), np.float32),
        np.zeros((products, q, plan.chunk), np.float32),
        np.empty((products, p * min(q, COLUMNS)), np.float32),
    )


def _one_way(plan: _Plan, of: _End, to: _End) -> _Way:
    """What the points `of` leave on patches and the first events of the points `to` make of it."""
    bands = plan.factor.shape[1]
    shape = bands, of.points, to.points
    way = _Way(
        np.zeros((*shape, len(plan.edges) - 1), np.float32),
        np.zeros((bands, of.points, BATCHES, to.points, STEPS), np.float32),
        np.zeros((bands, to.points, BATCHES, of.points, STEPS), np.float32),
        np.zeros((bands, of.points, plan.coarse.times.rows, len(plan.directed)), np.float32),
    )
    room = _room(plan, of, to)
    for chunk in range(len(plan.groups.count)):
        _add_chunk(plan, of, to, chunk, room, way)
    _take_own(plan, of, to, way.whole)
    for of_band in way.whole:
        for rows in of_band:
            _quieten(plan, rows)
    return way


def _add_chunk(plan: _Plan, of: _End, to: _End, chunk: int, room: _Room, way: _Way) -> None:
    """Add what goes by way of the patches of a chunk."""
    bands, rows, columns = plan.factor.shape[1], plan.times.rows, plan.chunk
    shape = BATCHES, STEPS, int(plan.groups.count[chunk])
    left, brought = (np.zeros((bands, padded(end.points), *shape), np.float32) for end in (of, to))

    def work() -> tuple[np.ndarray, ...]:
        table, sums = np.empty((rows, columns, bands), np.float32), np.empty((*shape, bands), np.float32)
        return table, sums, np.empty(bands, np.float32)

    over_rows(
        fill_left, of.points, of.events, of.draws, plan.shared, plan.times, plan.groups, chunk, room.left,
        left, chunk=4, scratch=work,
    )  # fmt: skip
    over_rows(
        fill_brought, to.points, to.events, plan.times, plan.groups, plan.factor, chunk, room.brought,
        brought, chunk=4, scratch=work,
    )  # fmt: skip
    directed = plan.directed // CHUNK == chunk
    of_directed = plan.directed[directed] - chunk * CHUNK
    for band in range(bands):
        late = room.left[band][:, plan.stretches[-1].rows]
        way.directed[band][:, :, directed] = coarse_rows(plan.coarse, late[:, :, of_directed])
        _add_energy(plan, band, room, way.whole[band])
        add_products(plan.groups, left[band], brought[band].sum(axis=1), way.left[band])
        add_products(plan.groups, brought[band], left[band].sum(axis=1), way.brought[band])


def _add_energy(plan: _Plan, band: int, room: _Room, whole: np.ndarray) -> None:
    """Add to `whole` (P, Q, late bins) what the tables of a chunk make."""
    for stretch in plan.stretches:
        products = len(stretch.convolution.forward)
        one, other, met = room.one[:products], room.other[:products], room.met[:products]
        transform(stretch.convolution, room.left[band][:, stretch.rows], one)
        transform(stretch.convolution, room.brought[band][:, stretch.rows], other)
        for start in range(0, whole.shape[1], COLUMNS):
            columns = slice(start, start + COLUMNS)
            meet(stretch.convolution, one, other[:, columns], met, whole[:, columns, stretch.bins])


def _take_own(plan: _Plan, of: _End, to: _End, whole: np.ndarray) -> None:
    """Take off `whole` (b, P, Q, late bins) what a walk makes with itself, where both ends are the same point.

    That leaves pairs of different walks, which are as good as those of two points.
    """
    i, j = np.nonzero(of.keys[:, None] == to.keys[None, :])
    if len(i) == 0:
        return
    events = to.events
    own = np.zeros((len(whole), plan.times.rows, to.points), np.float32)
    most, walks = int(np.diff(events.start, axis=1).max()), int(events.walk.max(initial=0)) + 1
    over_rows(
        fill_own, to.points, events, plan.times, plan.factor, own, chunk=1,
        scratch=lambda: (np.empty(walks, np.int64), np.empty(most, np.int64)),
    )  # fmt: skip
    for stretch in plan.stretches:
        late = slice(stretch.rows.stop - (stretch.bins.stop - stretch.bins.start), stretch.rows.stop)
        whole[:, i, j, stretch.bins] -= own[:, late][:, :, j].transpose(0, 2, 1)


def _quieten(plan: _Plan, table: np.ndarray) -> None:
    """Set to zero what rounding has left in (n, late bins)."""
    for stretch in plan.stretches:
        late = table[:, stretch.bins]
        late[late < _NOISE * late.max(axis=1, keepdims=True)] = 0.0


@kernel
def _deposit(first, last, columns, whole, back, directed, of_bin, flat, first_bin, table):
    """Add to the columns of `table` (A, B, bins, 9, b) the mean of both ways.

    `whole` (b, A, B, late bins) and `back` (b, B, A, late bins): energy; `directed`: for every band what `_look`
    gives for the n `columns`, of some patches, whose directions are taken; `of_bin` (late bins,) its steps;
    `flat` (late bins, b) undoes the flattening.
    """
    for n in range(first, last):
        j = columns[n]
        for i in range(len(table)):
            block, row_of = i // BLOCK, i % BLOCK
            for band in range(len(whole)):
                for t in range(len(flat)):
                    energy = 0.5 * (whole[band, i, j, t] + back[band, j, i, t]) * flat[t, band]
                    if energy <= 0.0:
                        continue
                    row, step = table[i, j, first_bin + t], of_bin[t]
                    row[0, band] += energy
                    seen = directed[band, block, step, row_of, n]
                    if seen[0] > 0.0:
                        for c in range(1, CHANNELS):
                            row[c, band] += energy * min(max(seen[c] / seen[0], -1.0), 1.0)


def _direct(plan: _Plan, way: _Way, back: _Way, to: _End, table: np.ndarray) -> None:
    """Deposit in a tile's table, with the directions from which sound comes."""
    convolution, rows = plan.coarse.convolution, plan.coarse.times.rows
    bands, points, _, patches = way.directed.shape
    shape = bands, len(convolution.forward), padded(points), patches
    ones = np.zeros(shape, np.float32)
    for band in range(bands):
        transform(convolution, way.directed[band], ones[band])

    blocks = padded(to.points) // BLOCK

    def call(first: int, last: int) -> None:
        brought = np.empty((bands, BLOCK, rows, CHANNELS, patches), np.float32)
        for q in range(first, last):
            columns = np.arange(q * BLOCK, min((q + 1) * BLOCK, to.points))
            brought[:] = 0.0
            fill_directed(
                0, len(columns), columns, to.events, plan.coarse.times, plan.directed_column,
                plan.directed_factor, brought, np.empty(CHANNELS),
            )  # fmt: skip
            pairs = zip(ones, brought, strict=True)
            seen = np.stack([_look(convolution, *of_band) for of_band in pairs])
            _deposit(
                0, len(columns), columns, way.whole, back.whole, seen, plan.coarse.of_bin, plan.flat,
                plan.first_bin, table,
            )  # fmt: skip

    over_rows(call, blocks, chunk=-(-blocks // thread_count()))  # a table for each thread


def _look(convolution: Convolution, one: np.ndarray, brought: np.ndarray) -> np.ndarray:
    """Of transforms (R, P, D) and a table (BLOCK, coarse rows, 9, D) what the points of one side leave, as those of
    a block of the other see it: (P blocks, steps, BLOCK, BLOCK, 9)."""
    products, points, patches = one.shape
    other = np.empty((products, BLOCK, CHANNELS * patches), np.float32)
    tables = brought.reshape(BLOCK, -1, CHANNELS * patches)
    np.matmul(convolution.forward, tables, out=other.transpose(1, 0, 2))
    of_channel = other.reshape(products, BLOCK, CHANNELS, patches).transpose(2, 0, 1, 3)
    steps = np.stack([_steps(convolution, one, channel) for channel in of_channel], axis=-1)
    seen = np.ascontiguousarray(
        steps.reshape(points // BLOCK, BLOCK, *steps.shape[1:]).transpose(0, 3, 1, 2, 4)
    )
    energy = seen[..., 0]
    energy[energy < _NOISE * energy.max(axis=1, keepdims=True)] = 0.0
    return np.asarray(seen)


def _steps(convolution: Convolution, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(P, BLOCK, steps) convolutions of all rows of two transforms (R, P, D) and (R, BLOCK, D), summed over D."""
    turned = turn_back(convolution, multiply(one, other))
    return turned.reshape(one.shape[1], BLOCK, -1)


def connect(tile: Tile) -> None:
    """Late paths of every pair."""
    model = tile.model
    if not model.world.settings.merging:
        return
    plan = _plan(model)
    a = _end(model, tile.a)
    b = a if tile.same else _end(model, tile.b)
    with threadpool_limits(limits=1, user_api="blas"):  # threads are ours, products of one shape
        there = _one_way(plan, a, b)
        back = there if tile.same else _one_way(plan, b, a)
        _direct(plan, there, back, b, tile.to_b)
        if not tile.same and tile.to_a.shape[2] > 0:
            _direct(plan, back, there, a, tile.to_a)
    steps, windows = plan.groups.step_of(plan.edges), model.world.window_of_bin[plan.first_bin :]
    for band in range(len(there.whole)):
        flat = plan.flat[:, band]
        over_rows(
            add_batches, len(tile.pairs), tile.pairs, there.whole[band], back.whole[band], flat,
            steps, windows, (there.left[band], back.brought[band]), (back.left[band], there.brought[band]), band,
            tile.batches, scratch=lambda: np.empty((STEPS, BATCHES)),
        )  # fmt: skip
        _note_difference(tile.difference[..., band], there.whole[band], back.whole[band], flat)


def _note_difference(
    difference: np.ndarray, there: np.ndarray, back: np.ndarray, flat: np.ndarray
) -> None:
    """Add half of what (A, B, late bins) and (B, A, late bins) differ by to `difference` (A, B, last bins).

    That misses the part of their noise that both owe to the first events of the two ends.
    """
    bins = difference.shape[2]
    for i in range(len(difference)):
        difference[i] += (
            0.5 * flat[len(flat) - bins :] * (there[i] - back[:, i])[:, there.shape[2] - bins :]
        )
