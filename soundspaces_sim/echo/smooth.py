"""Late bins, smoothed as far as noise hides what is in them.

Every late bin is the mean of two estimates: by walks of one end, and by walks of the other. Half of what they
differ by (the difference, below) has the mean zero and the noise of their mean, bin by bin, and comes for nothing.
So at every scale and place it is known how much of what sets bins apart from their surroundings is noise: the
same of the difference.

Scales are those of the wavelet transform "à trous" with the B3 spline h (Starck & Murtagh 1994). Energies are taken
relative to a decay f that is exponential within windows, S_j = (h_j * E) / (h_j * f): slopes are no structure, and
no weight is negative. The details S_(j-1) - S_j are kept or not by the share of noise in their energy, pooled over
what is around them (between two limits in part: firm shrinkage, Gao & Bruce 1997). What is kept at a scale is kept
at all coarser ones, so the result is f times a mean of raw E / f with weights from 0 to 1: no energy becomes
negative, and ratios of moments to energy stay in their bounds. At last every window is given back the energy that
it had.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.base.kernel import kernel, over_rows, part

_FROM_S = 0.05  # earlier bins stay as they are
_WINDOWS_S = (0.1, 0.2, 0.35)  # energies between these times stay what they were, …
_LATER_S = 0.15  # … and after them every so long
_WIDEST_S = 0.08  # scale of the coarsest details
_ALL, _NONE = 0.15, 0.6  # share of noise up to which details stay, and from which on they go
_AROUND = 6  # bins on either side that tell a share, for each bin of the scale
_NEAR = 1  # … of a single echo, which would be lost among them
_CERTAIN = 1.2  # times the noise, for so few bins
_BLUR = 0.5  # part of the difference's energy that is noise where detectors are wider than the scale: each is
# another mean over places, and a single arrival comes at other times


class Plan(NamedTuple):
    """Which bins are smoothed together: numbers of bins, counted from the first late one."""

    first: int  # of the late bins, among all
    stretches: np.ndarray  # (K + 1,) ends of stretches of equal bins
    levels: np.ndarray  # (K,) scales
    blurred: np.ndarray  # (K,) of them, those at which detectors blur
    windows: np.ndarray  # (M + 1,) ends of windows, of which those of stretches are some


def first_late(time_edges: np.ndarray, join_window: float) -> int:
    """Number of the first bin that may be smoothed; that of bins if there is none."""
    first = int(np.searchsorted(time_edges, max(_FROM_S, join_window) - 1e-9))
    return min(first, len(time_edges) - 1)


def equal_bins(widths: np.ndarray) -> np.ndarray:
    """(K + 1,) ends of the K stretches of bins of one width."""
    changes = np.flatnonzero(np.abs(np.diff(widths)) > 1e-6 * widths[:-1]) + 1
    return np.unique(np.concatenate([[0], changes, [len(widths)]]))


def make_plan(time_edges: np.ndarray, join_window: float, blur: float) -> Plan:
    """What to do with bins between `time_edges` (bins + 1,), s; `blur`: time of sound through a detector, s."""
    first = first_late(time_edges, join_window)
    edges = time_edges[first:]
    widths = np.diff(edges)
    stretches = equal_bins(widths)
    own = widths[stretches[:-1]]
    most = np.minimum(_WIDEST_S / own, 0.5 * np.diff(stretches))
    levels = np.floor(np.log2(np.maximum(most, 1.0)) + 1e-9)
    blurred = np.clip(np.ceil(np.log2(np.maximum(blur / own, 1.0)) - 1e-9), 0.0, levels)
    later = np.arange(_WINDOWS_S[-1] + _LATER_S, edges[-1] - 0.5 * _LATER_S, _LATER_S)
    cuts = np.searchsorted(edges, np.concatenate([_WINDOWS_S, later]) - 1e-9)
    windows = np.unique(np.concatenate([stretches, np.minimum(cuts, len(widths))]))
    return Plan(first, stretches, levels.astype(np.int64), blurred.astype(np.int64), windows)


class _Work(NamedTuple):
    """What a pair is worked on in. Columns are the channels of a table's row times its bands, or bands."""

    energy: np.ndarray  # (2, bins, 9 b) before and after a step
    noise: np.ndarray  # (2, bins, b)
    decay: np.ndarray  # (2, bins, b)
    flat: np.ndarray  # (bins, b) the decay itself
    kept: np.ndarray  # (2, bins, b) part of the details that stays, of the finer scale and of this one
    sums: np.ndarray  # (bins + 1, 2) running sums of energies of details
    weight: np.ndarray  # (b,)
    out: np.ndarray  # (bins, 9 b)


def _make_work(plan: Plan, channels: int, bands: int) -> _Work:
    bins = int(np.diff(plan.stretches).max(initial=0))
    return _Work(
        np.empty((2, bins, channels * bands)), np.empty((2, bins, bands)), np.empty((2, bins, bands)),
        np.empty((bins, bands)), np.empty((2, bins, bands)), np.empty((bins + 1, 2)),
        np.empty(bands), np.empty((bins, channels * bands)),
    )  # fmt: skip


@part(forceinline=True)
def _mirrored(i, n):
    """Number of a bin among `n` whose ends are mirrors."""
    while i < 0 or i >= n:
        i = -1 - i if i < 0 else 2 * n - 1 - i
    return i


@part
def _spread(source, target, n, step):
    """Convolve `n` rows with the B3 spline of nodes `step` apart."""
    for t in range(n):
        before, after = _mirrored(t - step, n), _mirrored(t + step, n)
        first, last = _mirrored(t - 2 * step, n), _mirrored(t + 2 * step, n)
        for k in range(source.shape[1]):
            target[t, k] = (
                0.375 * source[t, k]
                + 0.25 * (source[before, k] + source[after, k])
                + 0.0625 * (source[first, k] + source[last, k])
            )


@part
def _fit_decay(row, plan, low, high, decay):
    """A continuous curve over the late bins `low` to `high`, exponential in each window by what its halves hold."""
    for b in range(row.shape[2]):
        level = 0.0
        for w in range(len(plan.windows) - 1):
            start, end = max(plan.windows[w], low), min(plan.windows[w + 1], high)
            if start >= end:
                continue
            half = (end - start) // 2
            soon, late = 0.0, 0.0
            for t in range(half):
                soon += row[plan.first + start + t, 0, b]
                late += row[plan.first + end - 1 - t, 0, b]
            rate = 0.0
            if soon > 0.0 and late > 0.0:
                rate = math.log(soon / late) / (end - start - half)
            for t in range(start, end):
                decay[t - low, b] = math.exp(min(max(level - rate * (t - start), -300.0), 300.0))
            level -= rate * (end - start)


@part(forceinline=True)
def _firm(noise, whole):
    """The part of details that stays, by their energy and the noise in it."""
    if whole <= 0.0:
        return 1.0
    return min(max((_NONE - noise / whole) / (_NONE - _ALL), 0.0), 1.0)


@part
def _keep(work, now, n, step, noisy, b):
    """How much of the details between row `now` of `work` and the other one stays in band `b`; to `work.kept`."""
    then, sums = 1 - now, work.sums
    sums[0, 0], sums[0, 1] = 0.0, 0.0
    for t in range(n):
        fine, coarse = work.decay[now, t, b], work.decay[then, t, b]
        detail = work.energy[now, t, b] / fine - work.energy[then, t, b] / coarse
        noise = work.noise[now, t, b] / fine - work.noise[then, t, b] / coarse
        sums[t + 1, 0] = sums[t, 0] + detail * detail
        sums[t + 1, 1] = sums[t, 1] + noisy * noise * noise
    for t in range(n):
        start, end = max(t - 2 * _AROUND * step, 0), min(t + 2 * _AROUND * step + 1, n)
        noise = sums[end, 1] - sums[start, 1]
        part_kept = _firm(noise, sums[end, 0] - sums[start, 0])
        mean = noise / (end - start)
        start, end = max(t - 2 * _NEAR * step, 0), min(t + 2 * _NEAR * step + 1, n)
        noise = max(sums[end, 1] - sums[start, 1], mean * (end - start))
        part_kept = max(part_kept, _firm(_CERTAIN * noise, sums[end, 0] - sums[start, 0]))
        work.kept[then, t, b] = max(part_kept, work.kept[now, t, b])


@part
def _smooth_stretch(row, difference, plan, k, low, high, work):
    """`work.out` for the late bins `low` to `high` of a pair, of stretch `k`; false if they stay as they are."""
    n, bands = high - low, row.shape[2]
    levels = plan.levels[k]
    while levels > 0 and 2 * 2**levels > n:
        levels -= 1
    if levels <= 0:
        return False
    _fit_decay(row, plan, low, high, work.flat)
    for t in range(n):
        for b in range(bands):
            work.decay[0, t, b] = work.flat[t, b]
            work.noise[0, t, b] = difference[low + t, b]
            work.kept[0, t, b] = 0.0
        for c in range(row.shape[1]):
            for b in range(bands):
                work.energy[0, t, c * bands + b] = row[plan.first + low + t, c, b]
                work.out[t, c * bands + b] = 0.0
    now = 0
    for level in range(levels + 1):
        step, then = 2**level, 1 - now
        if level < levels:
            _spread(work.energy[now], work.energy[then], n, step)
            _spread(work.noise[now], work.noise[then], n, step)
            _spread(work.decay[now], work.decay[then], n, step)
            for b in range(bands):
                _keep(work, now, n, step, _BLUR if level < plan.blurred[k] else 1.0, b)
        else:
            work.kept[then, :n] = 1.0
        for t in range(n):
            some = False
            for b in range(bands):
                more = work.kept[then, t, b] - work.kept[now, t, b]
                work.weight[b] = more * work.flat[t, b] / work.decay[now, t, b]
                some |= more > 0.0
            if some:
                for c in range(row.shape[1]):
                    for b in range(bands):
                        work.out[t, c * bands + b] += work.weight[b] * work.energy[now, t, c * bands + b]
        now = then
    return True


@part
def _store(row, plan, low, high, split, out):
    """Write `out` to the late bins `low` to `high` of a pair, with the energy that its windows had.

    `split`: number of a bin at which a window ends as well.
    """
    bands, start = row.shape[2], low
    while start < high:
        end = high
        if start < split < end:
            end = split
        for w in range(len(plan.windows)):
            if start < plan.windows[w] < end:
                end = plan.windows[w]
        for b in range(bands):
            before, after = 0.0, 0.0
            for t in range(start, end):
                before += row[plan.first + t, 0, b]
                after += out[t - low, b]
            scale = before / after if after > 0.0 else 0.0
            for t in range(start, end):
                for c in range(row.shape[1]):
                    row[plan.first + t, c, b] = scale * out[t - low, c * bands + b]
        start = end


@part(forceinline=True)
def _silent(row, t):
    total = 0.0
    for b in range(row.shape[2]):
        total += row[t, 0, b]
    return total <= 0.0


@kernel
def _smooth(first, last, energy, difference, splits, plan, work):
    """Smooth the pairs `first` to `last`, counted row by row; arrays as `smooth_late`'s."""
    columns, bins = energy.shape[1], difference.shape[2]
    for n in range(first, last):
        i, j = n // columns, n % columns
        row, onset = energy[i, j], 0
        while onset < bins and _silent(row, plan.first + onset):
            onset += 1  # nothing may come before the first sound
        for k in range(len(plan.levels)):
            low, high = max(plan.stretches[k], onset), plan.stretches[k + 1]
            if low < high and _smooth_stretch(row, difference[i, j], plan, k, low, high, work):
                _store(row, plan, low, high, splits[i, j] - plan.first, work.out)


def smooth_late(energy: np.ndarray, difference: np.ndarray, splits: np.ndarray, plan: Plan) -> None:
    """Smooth the late bins of echograms in place.

    `energy` (S, L, bins, 9, b), J/m²; `difference` (S, L, late bins, b): half of what estimates of it by walks of
    either end differ by, of any sign; `splits` (S, L): number of a bin before and from which on sums are kept, as
    they are between `plan.windows`. Where the difference is zero nothing changes beyond rounding.
    """
    over_rows(
        _smooth, energy.shape[0] * energy.shape[1], energy, np.ascontiguousarray(difference),
        np.ascontiguousarray(splits), plan, scratch=lambda: _make_work(plan, *energy.shape[3:]),
    )  # fmt: skip
