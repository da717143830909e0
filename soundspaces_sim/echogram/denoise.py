"""Late bins, smoothed as far as noise hides what is in them.

Every late bin is the mean of two estimates: by walks of one end, and by walks of the other. Half of what they
differ by (the difference, below) has the mean zero and the noise of their mean, bin by bin, and comes for nothing.
So at every scale and place it is known how much of what sets bins apart from their surroundings is noise: the
same of the difference.

Scales are those of the wavelet transform "à trous" with the B3 spline h (Starck & Murtagh 1994). Energies are taken
relative to a decay f, S_j = (h_j * E) / (h_j * f): slopes are no structure, and no weight is negative. f is
continuous and log-linear between the centres of windows, and its sums over windows are those of E: a single strong
walk raises a window, and does not turn its slope. The coarsest details are those against f itself, S_J - 1.
Details S_(j-1) - S_j are kept or not by the share of noise in their energy, pooled over what is around them
(between two limits in part: firm shrinkage, Gao & Bruce 1997). What is kept at a scale is kept at all coarser ones,
so the result is f times a mean of raw E / f with weights from 0 to 1: no energy becomes negative, and ratios of
moments to energy stay in their bounds. At last every window is given back the energy that it had, by a factor that
is continuous and log-linear between centres; what its fit leaves (less than .01 dB) by one factor per window.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part

_FROM_S = 0.05  # earlier bins stay as they are
_WINDOWS_S = (0.1, 0.2, 0.35)  # energies between these times stay what they were, …
_LATER_S = 0.15  # … and after them every so long
_WIDEST_S = 0.08  # scale of the coarsest details but those against the decay
_ROUNDS = 6  # in which curves are fitted to sums over windows
_STEP = 4.0 / 3.0  # of a round, times the error, whose derivatives have eigenvalues mostly from .4 to 1
_FARTHEST = 40.0  # of a curve from a window's mean, Np: bounded where no continuous curve has the sums
_ALL, _NONE = 0.15, 0.6  # share of noise up to which details stay, and from which on they go
_AROUND = 6  # bins on either side that tell a share, for each bin of the scale
_NEAR = 1  # … of a single echo, which would be lost among them
_BLUR = 0.5  # part of the difference's energy that is noise where detectors are wider than the scale: each is
# another mean over places, and a single arrival comes at other times


class Plan(NamedTuple):
    """Which bins are smoothed together: numbers of bins, counted from the first late one."""

    first: int  # of the late bins, among all
    stretches: np.ndarray  # (K + 1,) ends of stretches of equal bins
    levels: np.ndarray  # (K,) scales
    blurred: np.ndarray  # (K,) of them, those at which detectors blur
    windows: np.ndarray  # (M + 1,) ends of windows, of which those of stretches are some
    edges: np.ndarray  # (late bins + 1,) times, s


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
    return Plan(
        first, stretches, levels.astype(np.int64), blurred.astype(np.int64), windows, edges.copy()
    )


class _Work(NamedTuple):
    """What a pair is worked on in. Columns are the channels of a table's row times its bands, or bands."""

    energy: np.ndarray  # (2, bins, 9 b) before and after a step
    noise: np.ndarray  # (2, bins, b)
    decay: np.ndarray  # (2, bins, b)
    flat: np.ndarray  # (late bins, b) the decay itself
    kept: np.ndarray  # (2, bins, b) part of the details that stays, of the finer scale and of this one
    sums: np.ndarray  # (bins + 1, 2) running sums of energies of details
    weight: np.ndarray  # (b,)
    out: np.ndarray  # (late bins, 9 b) smoothed
    ends: np.ndarray  # (windows + 1,) whose sums stay
    wide: np.ndarray  # (windows + 1,) of those among them that curves are fitted to
    had: np.ndarray  # (windows, b) energy between `ends` before a pair is smoothed
    sum: np.ndarray  # (windows, 10 b) sums between `wide`, of all channels and of the difference
    knots: np.ndarray  # (windows + 2, 3) time, s, level of a curve, Np, and level at first
    at: np.ndarray  # (windows + 2,) window of each of them; the first and the last are ends
    base: np.ndarray  # (late bins,) what a curve is multiplied by
    curve: np.ndarray  # (late bins,)


def _make_work(plan: Plan, channels: int, bands: int) -> _Work:
    bins = int(np.diff(plan.stretches).max(initial=0))
    late, windows = len(plan.edges) - 1, len(plan.windows) + 1
    return _Work(
        np.empty((2, bins, channels * bands)), np.empty((2, bins, bands)), np.empty((2, bins, bands)),
        np.empty((late, bands)), np.empty((2, bins, bands)), np.empty((bins + 1, 2)),
        np.empty(bands), np.empty((late, channels * bands)), np.empty(windows + 1, np.int64),
        np.empty(windows + 1, np.int64), np.empty((windows, bands)), np.empty((windows, (channels + 1) * bands)),
        np.empty((windows + 2, 3)), np.empty(windows + 2, np.int64), np.empty(late), np.empty(late),
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
def _cut(plan, low, split, work):
    """Windows of a pair from the late bin `low` on: numbers of those whose sums stay, and of those of curves.

    Sums over less than half of the coarsest scale are mostly noise, so such a window shares a knot with another.
    """
    ends, wide, count, joined, k = work.ends, work.wide, 0, 0, 0
    ends[0], wide[0] = low, low
    for w in range(1, len(plan.windows)):
        for end in (min(split, plan.windows[w]), plan.windows[w]):
            if end <= ends[count]:
                continue
            count += 1
            ends[count] = end
            while plan.stretches[k + 1] < end:
                k += 1
            if 2 * (end - wide[joined]) >= 2 ** plan.levels[k]:
                joined += 1
            if joined > 0:
                wide[joined] = end
    if joined == 0:
        joined, wide[1] = 1, ends[count]
    if joined == 1 and wide[1] > low + 1:  # a slope takes two
        joined, wide[2], wide[1] = 2, wide[1], (low + wide[1]) // 2
    return count, joined


@part
def _draw(knots, plan, low, high, curve):
    """A continuous curve: log-linear between knots, constant beyond them."""
    edges, k, value, ratio = plan.edges, 0, 1.0, 1.0
    for t in range(low, high):
        time, width = 0.5 * (edges[t] + edges[t + 1]), edges[t + 1] - edges[t]
        turns = t == low or abs(width - edges[t] + edges[t - 1]) > 1e-6 * width
        while k < len(knots) and time >= knots[k, 0]:
            k += 1
            turns = True
        if turns and len(knots) > 0:
            near, rate = max(k - 1, 0), 0.0
            if 0 < k < len(knots):
                rate = (knots[k, 1] - knots[near, 1]) / (knots[k, 0] - knots[near, 0])
            value = math.exp(knots[near, 1] + rate * (time - knots[near, 0]))
            ratio = math.exp(rate * width)
        curve[t] = value
        value *= ratio


@part
def _extend(knots, sloping):
    """Levels of the first and last knots: as slopes beside say if `sloping`, but never rising at last."""
    last = len(knots) - 1
    knots[0, 1], knots[last, 1] = knots[1, 1], knots[last - 1, 1]
    if sloping and last > 2:
        rate = (knots[2, 1] - knots[1, 1]) / (knots[2, 0] - knots[1, 0])
        knots[0, 1] += rate * (knots[0, 0] - knots[1, 0])
        rate = (knots[last - 1, 1] - knots[last - 2, 1]) / (knots[last - 1, 0] - knots[last - 2, 0])
        knots[last, 1] += min(rate, 0.0) * (knots[last, 0] - knots[last - 1, 0])


@part
def _fit(ends, sums, plan, sloping, work):
    """The curve that gives `work.base` these sums over windows, to `work.curve`."""
    count, edges = 0, plan.edges
    for w in range(len(ends) - 1):
        total = 0.0
        for t in range(ends[w], ends[w + 1]):
            total += work.base[t]
        if sums[w] > 0.0 and total > 0.0:
            if count == 0:
                work.knots[0, 0] = edges[ends[w]]
            count += 1
            work.knots[count, 0] = 0.5 * (edges[ends[w]] + edges[ends[w + 1]])
            work.knots[count, 1:] = math.log(sums[w] / total)
            work.knots[count + 1, 0] = edges[ends[w + 1]]
            work.at[count] = w
    if count == 0:
        work.curve[ends[0] : ends[-1]] = 1.0
        return
    knots = work.knots[: count + 2]
    for turn in range(_ROUNDS + 1):
        for k in range(1, count + 1 if turn > 0 else 1):
            w, total = work.at[k], 0.0
            for t in range(ends[w], ends[w + 1]):
                total += work.base[t] * work.curve[t]
            level = knots[k, 1] + _STEP * math.log(sums[w] / total)
            knots[k, 1] = min(max(level, knots[k, 2] - _FARTHEST), knots[k, 2] + _FARTHEST)
        _extend(knots, sloping)
        _draw(knots, plan, ends[0], ends[-1], work.curve)


@part
def _fit_decay(row, difference, plan, count, joined, work):
    """Sums over a pair's windows, and the decay that has them."""
    bands, energies = row.shape[2], row.shape[1] * row.shape[2]
    work.had[:count], work.sum[:joined] = 0.0, 0.0
    for w in range(count):
        for t in range(work.ends[w], work.ends[w + 1]):
            for b in range(bands):
                work.had[w, b] += row[plan.first + t, 0, b]
    for w in range(joined):
        for t in range(work.wide[w], work.wide[w + 1]):
            for b in range(bands):
                work.sum[w, energies + b] += difference[t, b]
                for c in range(row.shape[1]):
                    work.sum[w, c * bands + b] += row[plan.first + t, c, b]
    low, high = work.wide[0], work.wide[joined]
    for t in range(low, high):
        work.base[t] = plan.edges[t + 1] - plan.edges[t]
    for b in range(bands):
        _fit(work.wide[: joined + 1], work.sum[:joined, b], plan, True, work)
        for t in range(low, high):
            work.flat[t, b] = work.base[t] * work.curve[t]


@part
def _draw_means(plan, low, n, then, joined, bands, work):
    """To row `then` of `work`: the decay, with the moments and noise of windows, linear between their centres."""
    energies, edges, wide, w = work.out.shape[1], plan.edges, work.wide, 0
    for t in range(n):
        time = edges[low + t] + edges[low + t + 1]
        while w < joined and time >= edges[wide[w]] + edges[wide[w + 1]]:
            w += 1
        left, right, share = max(w - 1, 0), min(w, joined - 1), 0.0
        if left < right:
            start = edges[wide[left]] + edges[wide[right]]
            share = (time - start) / (edges[wide[right]] + edges[wide[right + 1]] - start)
        for b in range(bands):
            flat, some, more = work.flat[low + t, b], work.sum[left, b], work.sum[right, b]
            work.decay[then, t, b] = flat
            before, after = 1.0 - share if some > 0.0 else 0.0, share if more > 0.0 else 0.0
            scale = flat / max(before + after, 1e-300)  # a window without energy has no directions
            before, after = scale * before / max(some, 1e-300), scale * after / max(more, 1e-300)
            for k in range(b, energies + bands, bands):
                mean = before * work.sum[left, k] + after * work.sum[right, k]
                if k < energies:
                    work.energy[then, t, k] = mean
                else:
                    work.noise[then, t, b] = mean


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
        part_kept = max(part_kept, _firm(noise, sums[end, 0] - sums[start, 0]))
        work.kept[then, t, b] = max(part_kept, work.kept[now, t, b])


@part
def _smooth_stretch(row, difference, plan, k, low, joined, work):
    """The late bins of a pair from `low` to the end of stretch `k`, smoothed but for their sums, to `work.out`."""
    high = plan.stretches[k + 1]
    n, bands = high - low, row.shape[2]
    levels = plan.levels[k]
    while levels > 0 and 2 * 2**levels > n:
        levels -= 1
    for t in range(n):
        for c in range(row.shape[1]):
            for b in range(bands):
                work.energy[0, t, c * bands + b] = row[plan.first + low + t, c, b]
                work.out[low + t, c * bands + b] = (
                    row[plan.first + low + t, c, b] if levels <= 0 else 0.0
                )
        for b in range(bands):
            work.decay[0, t, b] = work.flat[low + t, b]
            work.noise[0, t, b] = difference[low + t, b]
            work.kept[0, t, b] = 0.0
    if levels <= 0:
        return
    now = 0
    for level in range(levels + 2):
        step, then = 2**level, 1 - now
        if level < levels:
            _spread(work.energy[now], work.energy[then], n, step)
            _spread(work.noise[now], work.noise[then], n, step)
            _spread(work.decay[now], work.decay[then], n, step)
        elif level == levels:
            _draw_means(plan, low, n, then, joined, bands, work)
        if level <= levels:
            for b in range(bands):
                _keep(work, now, n, step, _BLUR if level < plan.blurred[k] else 1.0, b)
        else:
            work.kept[then, :n] = 1.0
        for t in range(n):
            some = False
            for b in range(bands):
                more = work.kept[then, t, b] - work.kept[now, t, b]
                work.weight[b] = more * work.flat[low + t, b] / work.decay[now, t, b]
                some |= more > 0.0
            if some:
                for c in range(row.shape[1]):
                    for b in range(bands):
                        work.out[low + t, c * bands + b] += (
                            work.weight[b] * work.energy[now, t, c * bands + b]
                        )
        now = then


@part
def _restore(row, plan, count, joined, work):
    """Give a pair's smoothed bins the energy of its windows: by a continuous factor, and by what is left of it."""
    bands = row.shape[2]
    for b in range(bands):
        for t in range(work.ends[0], work.ends[count]):
            work.base[t] = work.out[t, b]
        _fit(work.wide[: joined + 1], work.sum[:joined, b], plan, False, work)
        for w in range(count):
            total = 0.0
            for t in range(work.ends[w], work.ends[w + 1]):
                total += work.base[t] * work.curve[t]
            scale = work.had[w, b] / total if total > 0.0 else 0.0
            for t in range(work.ends[w], work.ends[w + 1]):
                for c in range(row.shape[1]):
                    row[plan.first + t, c, b] = scale * work.curve[t] * work.out[t, c * bands + b]


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
        if onset == bins:
            continue
        count, joined = _cut(plan, onset, splits[i, j] - plan.first, work)
        _fit_decay(row, difference[i, j], plan, count, joined, work)
        for k in range(len(plan.levels)):
            if onset < plan.stretches[k + 1]:
                _smooth_stretch(
                    row, difference[i, j], plan, k, max(plan.stretches[k], onset), joined, work
                )
        _restore(row, plan, count, joined, work)


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
