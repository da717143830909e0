"""Denoising of late bins: noise is averaged, structure that stands out of it stays.

Every late bin E is the mean of two estimates: by subpaths of one end, and by subpaths of the other. Half of their
difference D has the mean zero and the noise of E, bin by bin, and costs nothing. So the share of noise in the
structure of E is known at every scale and place: it is that of the same structure of D. A subpath that both
estimates have in common is no part of D, but of one batch of subpaths. So where the variance by batches of a window
of time is more than `_LACKING` times the sum of D², what is lacking is noise, too: of each bin there in proportion
to E² − D², and, as batches may be off in time by half a window, of those in the nearer half of a long neighbour
(T44a).

Scales are those of the wavelet transform "à trous" with the B3 spline h (Starck & Murtagh 1994). Energies are
taken relative to a decay f,

    S_j = (h_j ∗ E) / (h_j ∗ f),

so that a slope is no structure and no weight is negative. f is continuous and log-linear between the centres of
windows and has the sums of E over windows (`decay_curves`): a single strong subpath raises a window, and does not
turn its slope. The coarsest details are those against f itself, S_J − 1.

Details S_(j−1) − S_j are shrunk by the share of noise in their energy, pooled over what is around them (firm
shrinkage, Gao & Bruce 1997). What is retained at a scale is retained at all coarser ones, so the result is f
times a mean of raw E / f with weights from 0 to 1: no energy becomes negative, and ratios of moments to energy
stay in their bounds. In the end every window gets back the energy that it had, by a factor that is continuous and
log-linear between centres; what its fit leaves (less than .01 dB) by one factor per window. Rises that few
subpaths have made are spread over earlier windows before (`pool_windows`).

Sources: J.-L. Starck and F. Murtagh (1994), Astronomy and Astrophysics 288, 342–348; H.-Y. Gao and A. G. Bruce
(1997), WaveShrink with firm shrinkage, Statistica Sinica 7, 855–874.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.echogram.decay_curves import CurveScratch, fit_curve, make_curve_scratch
from soundspaces_sim.echogram.denoise_plan import WIDEST_S, DenoisePlan, PairWindows, cut_windows
from soundspaces_sim.echogram.pool_windows import Groups, make_groups, pool_windows
from soundspaces_sim.echogram.wavelets import (
    RunningSums,
    ScaleBins,
    add_retained,
    convolve_spline,
    shrink,
)

_BLUR = 0.5  # part of the difference's energy that is noise where detectors are wider than the scale: each is
# another mean over places, and a single arrival comes at other times
# Times the variance that D tells of: by chance one in forty estimates from batches is more.
_LACKING = 2.0


class Noise(NamedTuple):
    """What is known of the noise of echograms' energies."""

    # (S, L, late bins, b) D, half of what estimates by either end differ by, of any sign
    difference: np.ndarray
    error: np.ndarray  # (S, L, W, b) standard errors of energies in windows of time, by batches
    window: np.ndarray  # (bins,) number among W


class _Work(NamedTuple):
    """What a pair is worked on in."""

    row: np.ndarray  # (bins, channels, b) of a pair with shares of windows; no bins without them
    squares: np.ndarray  # (W, b) of E² − D²
    known: np.ndarray  # (W, b) of D²
    lacking: np.ndarray  # (W, b) standard errors that D does not tell of
    energy: np.ndarray  # (W, b)
    noise: np.ndarray  # (late bins, b)
    fine: ScaleBins
    coarse: ScaleBins
    decay: np.ndarray  # (late bins, b) f
    running: RunningSums
    weight: np.ndarray  # (b,)
    out: np.ndarray  # (late bins, 9 b) smoothed
    windows: PairWindows
    groups: Groups
    curves: CurveScratch


class _Span(NamedTuple):
    """Bins that are worked on together."""

    low: int  # the first, among the late bins
    count: int
    windows: int  # of the pair to which curves are fitted


def _make_work(plan: DenoisePlan, total: int, channels: int, bands: int, of_time: int) -> _Work:
    """For `channels` of energies; `total`: bins of `_Work.row`; `of_time`: windows of time, W."""
    bins = int(np.diff(plan.stretches).max(initial=0))
    late, windows = len(plan.edges) - 1, len(plan.windows) + 1

    def make_bins() -> ScaleBins:
        energy = np.empty((bins, channels * bands))
        return ScaleBins(energy, *np.empty((3, bins, bands)))

    ends, wide = np.empty((2, windows + 1), np.int64)
    sums = np.empty((windows, (channels + 1) * bands))
    return _Work(
        row=np.empty((total, channels, bands), np.float32),
        squares=np.empty((of_time, bands)),
        known=np.empty((of_time, bands)),
        lacking=np.empty((of_time, bands)),
        energy=np.empty((of_time, bands)),
        noise=np.empty((late, bands)),
        fine=make_bins(),
        coarse=make_bins(),
        decay=np.empty((late, bands)),
        running=RunningSums(*np.empty((2, bins + 1))),
        weight=np.empty(bands),
        out=np.empty((late, channels * bands)),
        windows=PairWindows(ends, wide, np.empty((windows, bands)), sums, np.empty((windows, bands))),
        groups=make_groups(windows),
        curves=make_curve_scratch(windows, late),
    )


@part
def _find_noise(
    row: np.ndarray,
    difference: np.ndarray,
    error: np.ndarray,
    window: np.ndarray,
    plan: DenoisePlan,
    work: _Work,
) -> None:
    """The noise of a pair's late bins, to `work.noise`: D, and what it lacks of the variance by batches."""
    known, lacking, squares, energy = work.known, work.lacking, work.squares, work.energy
    bands, windows, first = row.shape[2], len(error), len(row) - len(difference)
    squares[:], known[:], energy[:] = 0.0, 0.0, 0.0
    for t in range(len(row)):
        w = window[t]
        for b in range(bands):
            own, d = np.float64(row[t, 0, b]), 0.0
            if t >= first:
                d = np.float64(difference[t - first, b])
            squares[w, b] += max(own * own - d * d, 0.0)
            energy[w, b] += own
            known[w, b] += d * d
    for w in range(windows):
        for b in range(bands):
            variance = np.float64(error[w, b]) ** 2
            lacks = variance > _LACKING * known[w, b]
            lacking[w, b] = math.sqrt(variance - known[w, b]) if lacks else 0.0
    begin = end = first
    for t in range(first, len(row)):
        w = window[t]
        if t == end:
            begin = t
            while end < len(row) and window[end] == w:
                end += 1
        other = w - 1 if 2 * t < begin + end - 1 else w + 1
        long = plan.edges[end - first] - plan.edges[begin - first] > WIDEST_S
        for b in range(bands):
            d, lack = np.float64(difference[t - first, b]), lacking[w, b]
            if long and 0 <= other < windows and energy[other, b] > 0.0:
                lack += lacking[other, b] * max(1.0, energy[w, b] / energy[other, b])
            if lack > 0.0 and squares[w, b] > 0.0:
                own = max(np.float64(row[t, 0, b]) ** 2 - d * d, 0.0)
                d = math.copysign(math.sqrt(d * d + own * min(lack * lack / squares[w, b], 1.0)), d)
            work.noise[t - first, b] = d


@part
def _sum_windows(
    row: np.ndarray, noise: np.ndarray, first: int, count: int, fitted: int, windows: PairWindows
) -> None:
    """Sum a pair's `row` (bins, 9, b), from bin `first` on, and `noise` (late bins, b) over its windows."""
    bands, energies = row.shape[2], row.shape[1] * row.shape[2]
    windows.energy[:count], windows.sums[:fitted], windows.noise[:fitted] = 0.0, 0.0, 0.0
    for w in range(count):
        for t in range(windows.ends[w], windows.ends[w + 1]):
            for b in range(bands):
                windows.energy[w, b] += row[first + t, 0, b]
    for w in range(fitted):
        for t in range(windows.wide[w], windows.wide[w + 1]):
            for b in range(bands):
                windows.sums[w, energies + b] += noise[t, b]
                windows.noise[w, b] += noise[t, b] ** 2
                for c in range(row.shape[1]):
                    windows.sums[w, c * bands + b] += row[first + t, c, b]


@part
def _fit_decay(plan: DenoisePlan, fitted: int, work: _Work) -> None:
    """The decay f that has the energies of a pair's windows, to `work.decay`; its base are the widths of bins."""
    windows, curves = work.windows, work.curves
    low, high = windows.wide[0], windows.wide[fitted]
    for b in range(work.decay.shape[1]):
        fit_curve(windows.wide[: fitted + 1], windows.sums[:fitted, b], plan.edges, True, curves)
        for t in range(low, high):
            work.decay[t, b] = curves.base[t] * curves.curve[t]


@part
def _draw_means(plan: DenoisePlan, span: _Span, work: _Work, coarse: ScaleBins) -> None:
    """To `coarse`: f, with the moments and noise of windows relative to it linear between their centres."""
    wide, sums, edges, w = work.windows.wide, work.windows.sums, plan.edges, 0
    energies, bands = work.out.shape[1], work.decay.shape[1]
    for t in range(span.count):
        time = edges[span.low + t] + edges[span.low + t + 1]
        while w < span.windows and time >= edges[wide[w]] + edges[wide[w + 1]]:
            w += 1
        left, right, share = max(w - 1, 0), min(w, span.windows - 1), 0.0
        if left < right:
            start = edges[wide[left]] + edges[wide[right]]
            share = (time - start) / (edges[wide[right]] + edges[wide[right + 1]] - start)
        for b in range(bands):
            decay, some, more = work.decay[span.low + t, b], sums[left, b], sums[right, b]
            coarse.decay[t, b] = decay
            before, after = 1.0 - share if some > 0.0 else 0.0, share if more > 0.0 else 0.0
            scale = decay / max(before + after, 1e-300)  # a window without energy has no directions
            before, after = scale * before / max(some, 1e-300), scale * after / max(more, 1e-300)
            for k in range(b, energies + bands, bands):
                mean = before * sums[left, k] + after * sums[right, k]
                if k < energies:
                    coarse.energy[t, k] = mean
                else:
                    coarse.noise[t, b] = mean


@part
def _load(row: np.ndarray, first: int, span: _Span, work: _Work) -> None:
    """The raw bins of a span, to `work.fine`."""
    fine, bands = work.fine, row.shape[2]
    for t in range(span.count):
        for b in range(bands):
            for c in range(row.shape[1]):
                fine.energy[t, c * bands + b] = row[first + span.low + t, c, b]
            fine.decay[t, b] = work.decay[span.low + t, b]
            fine.noise[t, b] = work.noise[span.low + t, b]
            fine.retained[t, b] = 0.0


@part
def _smooth_stretch(plan: DenoisePlan, k: int, span: _Span, work: _Work) -> None:
    """The late bins of `work.fine`, of stretch `k`, smoothed but for their sums, to `work.out`."""
    n, bands, levels = span.count, work.decay.shape[1], plan.levels[k]
    while levels > 0 and 2 * 2**levels > n:
        levels -= 1
    fine, coarse = work.fine, work.coarse
    for t in range(n):
        for c in range(work.out.shape[1]):
            work.out[span.low + t, c] = fine.energy[t, c] if levels <= 0 else 0.0
    if levels <= 0:
        return
    for level in range(levels + 2):
        step = 2**level
        if level < levels:
            convolve_spline(fine.energy, coarse.energy, n, step)
            convolve_spline(fine.noise, coarse.noise, n, step)
            convolve_spline(fine.decay, coarse.decay, n, step)
        elif level == levels:
            _draw_means(plan, span, work, coarse)
        if level <= levels:
            noisy = _BLUR if level < plan.blurred[k] else 1.0
            for b in range(bands):
                shrink(work.running, fine, coarse, n, step, noisy, b)
        else:
            coarse.retained[:n] = 1.0
        add_retained(fine, coarse, work.decay, span.low, n, work.weight, work.out)
        fine, coarse = coarse, fine


@part
def _fill(row: np.ndarray, plan: DenoisePlan, window: int, b: int, work: _Work) -> None:
    """Give band `b` of a window of no sound, to which others have given energy, the decay f and their moments."""
    wide, sums, bands, fitted = work.windows.wide, work.windows.sums, row.shape[2], 0
    low, high = work.windows.ends[window], work.windows.ends[window + 1]
    while wide[fitted + 1] <= low:
        fitted += 1
    total = 0.0
    for t in range(low, high):
        total += work.decay[t, b]
    for t in range(low, high):
        energy = work.windows.energy[window, b] * work.decay[t, b] / total
        for c in range(row.shape[1]):
            row[plan.first + t, c, b] = energy * sums[fitted, c * bands + b] / sums[fitted, b]


@part
def _restore(row: np.ndarray, plan: DenoisePlan, count: int, fitted: int, work: _Work) -> None:
    """Give a pair's smoothed bins the energy of its windows: by a continuous factor, and by what is left of
    it."""
    bands, windows, curves = row.shape[2], work.windows, work.curves
    ends = windows.ends
    for b in range(bands):
        for t in range(ends[0], ends[count]):
            curves.base[t] = work.out[t, b]
        fit_curve(windows.wide[: fitted + 1], windows.sums[:fitted, b], plan.edges, False, curves)
        for w in range(count):
            total = 0.0
            for t in range(ends[w], ends[w + 1]):
                total += curves.base[t] * curves.curve[t]
            if total <= 0.0 < windows.energy[w, b]:
                _fill(row, plan, w, b, work)
                continue
            scale = windows.energy[w, b] / total if total > 0.0 else 0.0
            for t in range(ends[w], ends[w + 1]):
                for c in range(row.shape[1]):
                    row[plan.first + t, c, b] = scale * curves.curve[t] * work.out[t, c * bands + b]


@part(forceinline=True)
def _is_silent(row: np.ndarray, t: int) -> bool:
    """Whether a bin has no energy."""
    total = 0.0
    for b in range(row.shape[2]):
        total += row[t, 0, b]
    return total <= 0.0


@part
def _split_windows(energy: np.ndarray, window: np.ndarray, row: np.ndarray) -> None:
    """Copy a pair's `energy` (bins, 9, b) to `row` (bins, 9 + W, b), with that of every `window` in a channel of
    its own."""
    channels = energy.shape[1]
    for t in range(len(row)):
        for b in range(row.shape[2]):
            for c in range(row.shape[1]):
                row[t, c, b] = energy[t, c, b] if c < channels else 0.0
            row[t, channels + window[t], b] = energy[t, 0, b]


@part
def _join_windows(row: np.ndarray, window: np.ndarray, energy: np.ndarray, moved: np.ndarray) -> None:
    """Copy the first channels of `row` back, and sum those of windows by `window`: to `moved` (W, W, b)."""
    channels = energy.shape[1]
    moved[:] = 0.0
    for t in range(len(row)):
        for b in range(row.shape[2]):
            for c in range(channels):
                energy[t, c, b] = row[t, c, b]
            for w in range(moved.shape[1]):
                moved[window[t], w, b] += row[t, channels + w, b]


@part
def _smooth_pair(
    row: np.ndarray,
    difference: np.ndarray,
    error: np.ndarray,
    window: np.ndarray,
    split: int,
    plan: DenoisePlan,
    work: _Work,
) -> None:
    """Smooth a pair's `row` (bins, channels, b), of which the first channel tells how; noise as `Noise` has it."""
    onset, bins = 0, len(difference)
    while onset < bins and _is_silent(row, plan.first + onset):
        onset += 1  # nothing may come before the first sound
    if onset == bins:
        return
    count, fitted = cut_windows(plan, onset, split - plan.first, work.windows)
    _find_noise(row, difference, error, window, plan, work)
    _sum_windows(row, work.noise, plan.first, count, fitted, work.windows)
    for t in range(work.windows.wide[0], work.windows.wide[fitted]):
        work.curves.base[t] = plan.edges[t + 1] - plan.edges[t]
    pool_windows(work.windows, plan.edges, split - plan.first, count, fitted, work.groups, work.curves)
    _fit_decay(plan, fitted, work)
    for k in range(len(plan.levels)):
        if onset < plan.stretches[k + 1]:
            low = max(plan.stretches[k], onset)
            span = _Span(low, plan.stretches[k + 1] - low, fitted)
            _load(row, plan.first, span, work)
            _smooth_stretch(plan, k, span, work)
    _restore(row, plan, count, fitted, work)


@kernel
def _smooth(
    first: int,
    last: int,
    energy: np.ndarray,
    noise: Noise,
    splits: np.ndarray,
    plan: DenoisePlan,
    moved: np.ndarray,
    work: _Work,
) -> None:
    """Smooth the pairs `first` to `last`, counted row by row; arrays as `smooth_late`'s."""
    columns, window = energy.shape[1], noise.window
    for n in range(first, last):
        i, j = n // columns, n % columns
        difference, error, split = noise.difference[i, j], noise.error[i, j], splits[i, j]
        if len(work.row) == 0:
            _smooth_pair(energy[i, j], difference, error, window, split, plan, work)
        else:
            _split_windows(energy[i, j], window, work.row)
            _smooth_pair(work.row, difference, error, window, split, plan, work)
            _join_windows(work.row, window, energy[i, j], moved[i, j])


def smooth_late(
    energy: np.ndarray, noise: Noise, splits: np.ndarray, plan: DenoisePlan, count_moved: bool = False
) -> np.ndarray | None:
    """Smooth the late bins of echograms in place.

    `energy` (S, L, bins, 9, b), J/m²; `splits` (S, L): number of a bin before and from which on sums are kept, as
    they are between `plan.windows` that are known. Where there is no noise nothing changes beyond rounding.

    With `count_moved` returns (S, L, W, W, b): energy in a window of time afterwards that was in another one
    before, J/m².
    """
    noise = Noise(*(np.ascontiguousarray(x) for x in noise))
    sources, listeners, bins, channels, bands = energy.shape
    of_time = noise.error.shape[2]
    windows, total = (of_time, bins) if count_moved else (0, 0)
    moved = np.empty((sources, listeners, windows, windows, bands), np.float32)
    over_rows(
        _smooth, sources * listeners, energy, noise, np.ascontiguousarray(splits), plan, moved,
        scratch=lambda: _make_work(plan, total, channels + windows, bands, of_time),
    )  # fmt: skip
    return moved if count_moved else None
