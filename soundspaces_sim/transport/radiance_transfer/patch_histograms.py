"""Tables of the sound of points at patches, over time: what they bring there, and what they leave.

A chunk of patches at a time, so that a point's table stays in the cache and those of many points in memory.
What each batch of walks has in it goes to wider tables, for error bars (`spread`).
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.echogram.denoise import equal_bins
from soundspaces_sim.transport.radiance_transfer.batch_variance import put
from soundspaces_sim.transport.radiance_transfer.convolution import Convolution, make_convolution
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import CHUNK
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, harmonics

_DIRECTED_S = 0.02  # what directions are resolved to


class Times(NamedTuple):
    """Stretches of equal bins. A table has a row for every step of every stretch, from time zero on.

    Two series are convolved, and each takes off a part of a step less than its half: `left` and `brought`, which
    make half a step together.
    """

    step: np.ndarray  # (S,) m
    offset: np.ndarray  # (S,) m, by which bins are off multiples of the step
    steps: np.ndarray  # (S,) up to the end of the stretch
    base: np.ndarray  # (S + 1,) where its rows start
    left: float
    brought: float

    @property
    def rows(self) -> int:
        return int(self.base[-1])


class Stretch(NamedTuple):
    """What there is to know of a stretch outside kernels."""

    rows: slice  # of a table
    bins: slice  # of the echogram's late bins
    convolution: Convolution


class Coarse(NamedTuple):
    """Wider steps, `times` of a single stretch, in which directions are told."""

    times: Times
    ratio: int  # of its step to that of the last stretch, whose rows it sums
    convolution: Convolution
    of_bin: np.ndarray  # (late bins,) step of the convolution in which their middles are


def stretch_steps(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the S stretches of equal bins between `edges`, m: bins at which they begin and end (S + 1,), their step,
    m, steps of it before them, and steps up to their end."""
    bounds = equal_bins(np.diff(edges))
    starts, ends = bounds[:-1], bounds[1:]
    step = (edges[ends] - edges[starts]) / (ends - starts)
    before = np.floor(edges[starts] / step + 1e-6).astype(np.int64)
    return bounds, step, before, before + ends - starts


def coarse_steps(step: float, steps: int, c: float) -> tuple[int, int]:
    """How many of a stretch's `steps` of `step` m directions are told for together, and how many such there are."""
    ratio = max(round(_DIRECTED_S * c / step), 1)
    return ratio, -(-steps // ratio)


def make_stretches(edges: np.ndarray) -> tuple[Times, list[Stretch]]:
    """Stretches of equal bins between `edges`, m."""
    bounds, step, before, steps = stretch_steps(edges)
    starts, ends = bounds[:-1], bounds[1:]
    base = np.concatenate([[0], np.cumsum(steps)])
    times = Times(step, np.maximum(edges[starts] - before * step, 0.0), steps, base, 0.25, 0.25)
    rows = [slice(*r) for r in pairwise(base)]
    bins = [slice(*r) for r in zip(starts, ends, strict=True)]
    convolutions = [make_convolution(*n) for n in zip(steps, before, strict=True)]
    return times, [Stretch(*s) for s in zip(rows, bins, convolutions, strict=True)]


def make_coarse(times: Times, edges: np.ndarray, c: float) -> Coarse:
    """Steps of about `_DIRECTED_S` for late bins between `edges`, m, of the stretches `times`."""
    step, offset, steps = float(times.step[-1]), float(times.offset[-1]), int(times.steps[-1])
    ratio, rows = coarse_steps(step, steps, c)
    middles = 0.5 * (edges[1:] + edges[:-1])
    of_bin = np.clip(((middles - offset) / (ratio * step)).astype(np.int64), 0, rows - 1)
    left = times.left / ratio
    wide = Times(
        np.array([ratio * step]),
        np.array([offset]),
        np.array([rows]),
        np.array([0, rows]),
        left,
        0.5 - left,
    )
    first = int(of_bin[0])
    return Coarse(wide, ratio, make_convolution(rows, first), of_bin - first)


@part(forceinline=True)
def _row_left(times, s, length):
    """Row in stretch `s` of what is left on a patch after `length` m, -1 past its end."""
    i = int(length / times.step[s] + times.left)
    return times.base[s] + i if i < times.steps[s] else -1


@part(forceinline=True)
def _row_brought(times, s, length):
    """Row in stretch `s` of what reaches an end from a patch after `length` m, -1 past its end."""
    i = int(max(length - times.offset[s], 0.0) / times.step[s] + times.brought)
    return times.base[s] + i if i < times.steps[s] else -1


@part(forceinline=True)
def _leave(table, sums, times, groups, batch, patch, column, length, energy):
    """Energies (b,) on a patch, to its column of `table` (rows, columns, b) and to batch sums."""
    for s in range(len(times.step)):
        row = _row_left(times, s, length)
        if row >= 0:
            for b in range(len(energy)):
                table[row, column, b] += energy[b]
    put(sums, groups, batch, patch, length, energy)


@part
def _turn(table, sums, out, batches, i):
    """`table` (rows, columns, b) and `sums` (BATCHES, steps, groups, b) to row `i` of arrays with bands first."""
    for b in range(table.shape[2]):
        for row in range(table.shape[0]):
            for c in range(table.shape[1]):
                out[b, i, row, c] = table[row, c, b]
        for k in range(sums.shape[0]):
            for t in range(sums.shape[1]):
                for g in range(sums.shape[2]):
                    batches[b, i, k, t, g] = sums[k, t, g, b]


@kernel
def fill_left(first, last, events, draws, shared, times, groups, chunk, out, batches, work):
    """What the points `first` to `last` leave on the patches of a chunk: `out` (b, N, rows, columns), and by batch
    `batches` (b, N, BATCHES, steps, groups).

    `work`: the same of one point, with bands last, and energies (b,).
    """
    table, sums, energy = work
    low, columns = chunk * CHUNK, out.shape[3]
    chunks = (shared.start.shape[1] - 1) // len(groups.group)
    for i in range(first, last):
        table[:] = 0.0
        sums[:] = 0.0
        for k in range(BATCHES):
            for r in range(events.start[i, k], events.start[i, k + 1]):
                patch = events.patch[r]
                if patch >= low and patch < low + columns:
                    for b in range(len(energy)):
                        energy[b] = events.energy[r, b]
                    _leave(table, sums, times, groups, k, patch, patch - low, events.length[r], energy)
            for d in range(draws.index.shape[2]):
                r = draws.index[i, k, d]
                if r < 0:
                    continue
                walk, length, scale = draws.walk[i, k, d], events.length[r], draws.scale[i, k, d]
                at = events.patch[r] * chunks + chunk
                for e in range(shared.start[walk, at], shared.start[walk, at + 1]):
                    patch = shared.patch[e]
                    for b in range(len(energy)):
                        energy[b] = scale * events.energy[r, b] * shared.energy[e, b]
                    _leave(
                        table,
                        sums,
                        times,
                        groups,
                        k,
                        patch,
                        patch - low,
                        length + shared.length[e],
                        energy,
                    )
        _turn(table, sums, out, batches, i)


@kernel
def fill_brought(first, last, events, times, groups, factor, chunk, out, batches, work):
    """First events of the points `first` to `last` on the patches of a chunk, times `factor` (C, b) in `out`, and
    times `groups.factor` in `batches`: shapes as of `fill_left`."""
    table, sums, energy = work
    low, columns = chunk * CHUNK, out.shape[3]
    for i in range(first, last):
        table[:] = 0.0
        sums[:] = 0.0
        for k in range(BATCHES):
            for r in range(events.start[i, k], events.start[i, k + 1]):
                patch, length = events.patch[r], events.length[r]
                if patch < low or patch >= low + columns:
                    continue
                for s in range(len(times.step)):
                    row = _row_brought(times, s, length)
                    if row >= 0:
                        for b in range(len(energy)):
                            table[row, patch - low, b] += events.energy[r, b] * factor[patch, b]
                for b in range(len(energy)):
                    energy[b] = events.energy[r, b] * groups.factor[patch, b]
                put(sums, groups, k, patch, length, energy)
        _turn(table, sums, out, batches, i)


@kernel
def fill_directed(first, last, points, events, times, column, factor, out, y):
    """First events of `points[first:last]` on patches that have a `column`, with nine harmonics of where they are
    seen, times `factor` (C, b): to `out` (b, n, rows, 9, columns)."""
    for n in range(first, last):
        i = points[n]
        for k in range(BATCHES):
            for r in range(events.start[i, k], events.start[i, k + 1]):
                patch, d = events.patch[r], events.direction[i, k, events.walk[r]]
                at, row = column[patch], _row_brought(times, 0, events.length[r])
                if at < 0 or row < 0:
                    continue
                harmonics(d[0], d[1], d[2], y)
                for b in range(len(out)):
                    value = events.energy[r, b] * factor[patch, b]
                    for c in range(CHANNELS):
                        out[b, n, row, c, at] += y[c] * value


def coarse_rows(coarse: Coarse, table: np.ndarray) -> np.ndarray:
    """(n, coarse rows, columns) of the rows of the last stretch (n, rows, columns), summed."""
    out = np.zeros((len(table), coarse.times.rows, table.shape[2]), np.float32)
    for n in range(coarse.ratio):
        every = table[:, n :: coarse.ratio]
        out[:, : every.shape[1]] += every
    return out


@kernel
def fill_own(first, last, events, times, factor, table, work):
    """What points as both ends make of each walk with itself: `table` (b, rows, n).

    `work`: two arrays of as many integers as a batch has walks, and events.
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
                        _add_pair(i, r, o, events, times, factor, table)
                        if o != r:
                            _add_pair(i, o, r, events, times, factor, table)
                    o = before[o - start]


@part
def _add_pair(i, r, o, events, times, factor, table):
    """Add what first event `r` makes of `o` left on the same patch."""
    for s in range(len(times.step)):
        one = _row_left(times, s, events.length[o])
        two = _row_brought(times, s, events.length[r])
        row = one + two - times.base[s]
        if one >= 0 and two >= 0 and row < times.base[s + 1]:
            for b in range(len(table)):
                table[b, row, i] += (
                    events.energy[r, b] * events.energy[o, b] * factor[events.patch[r], b]
                )
