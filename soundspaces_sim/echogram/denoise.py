"""Denoising of late bins: noise is averaged, structure that stands out of it stays.

Every late bin E is the mean of two estimates: by subpaths of one end, and by subpaths of the other. Half of their
difference D has the mean zero and the noise of E, bin by bin, and costs nothing. So the share of noise in the
structure of E is known at every scale and place: it is that of the same structure of D.

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
log-linear between centres; what its fit leaves (less than .01 dB) by one factor per window.

Sources: J.-L. Starck and F. Murtagh (1994), Astronomy and Astrophysics 288, 342–348; H.-Y. Gao and A. G. Bruce
(1997), WaveShrink with firm shrinkage, Statistica Sinica 7, 855–874.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.echogram.decay_curves import CurveScratch, fit_curve, make_curve_scratch
from soundspaces_sim.echogram.wavelets import (
    RunningSums,
    ScaleBins,
    add_retained,
    convolve_spline,
    shrink,
)

_FROM_S = 0.05  # earlier bins stay as they are
_WINDOWS_S = (0.1, 0.2, 0.35)  # energies between these times stay what they were, …
_LATER_S = 0.15  # … and after them every so long
_WIDEST_S = 0.08  # scale of the coarsest details but those against the decay
_BLUR = 0.5  # part of the difference's energy that is noise where detectors are wider than the scale: each is
# another mean over places, and a single arrival comes at other times


class DenoisePlan(NamedTuple):
    """Which bins are smoothed together: numbers of bins, counted from the first late one."""

    first: int  # of the late bins, among all
    stretches: np.ndarray  # (K + 1,) ends of stretches of equal bins
    levels: np.ndarray  # (K,) scales
    blurred: np.ndarray  # (K,) of them, those at which detectors blur
    windows: np.ndarray  # (M + 1,) ends of windows, of which those of stretches are some
    edges: np.ndarray  # (late bins + 1,) times, s


def first_late(time_edges: np.ndarray, connection_window: float) -> int:
    """Number of the first bin that may be smoothed; that of bins if there is none."""
    first = int(np.searchsorted(time_edges, max(_FROM_S, connection_window) - 1e-9))
    return min(first, len(time_edges) - 1)


def equal_bins(widths: np.ndarray) -> np.ndarray:
    """(K + 1,) ends of the K stretches of bins of one width."""
    changes = np.flatnonzero(np.abs(np.diff(widths)) > 1e-6 * widths[:-1]) + 1
    return np.unique(np.concatenate([[0], changes, [len(widths)]]))


def make_denoise_plan(time_edges: np.ndarray, connection_window: float, blur: float) -> DenoisePlan:
    """What to do with bins between `time_edges` (bins + 1,), s; `blur`: time of sound through a detector, s."""
    first = first_late(time_edges, connection_window)
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
    return DenoisePlan(
        first, stretches, levels.astype(np.int64), blurred.astype(np.int64), windows, edges.copy()
    )


class _Windows(NamedTuple):
    """Windows of a pair, M at most, and what is in them."""

    ends: np.ndarray  # (M + 1,) of windows whose energies stay
    wide: np.ndarray  # (M + 1,) of those among them to which curves are fitted
    energy: np.ndarray  # (M, b) J/m² between `ends` before a pair is smoothed
    sums: np.ndarray  # (M, 10 b) between `wide`: of all channels, and of D


class _Work(NamedTuple):
    """What a pair is worked on in."""

    fine: ScaleBins
    coarse: ScaleBins
    decay: np.ndarray  # (late bins, b) f
    running: RunningSums
    weight: np.ndarray  # (b,)
    out: np.ndarray  # (late bins, 9 b) smoothed
    windows: _Windows
    curves: CurveScratch


class _Span(NamedTuple):
    """Bins that are worked on together."""

    low: int  # the first, among the late bins
    count: int
    windows: int  # of the pair to which curves are fitted


def _make_work(plan: DenoisePlan, channels: int, bands: int) -> _Work:
    bins = int(np.diff(plan.stretches).max(initial=0))
    late, windows = len(plan.edges) - 1, len(plan.windows) + 1

    def make_bins() -> ScaleBins:
        energy = np.empty((bins, channels * bands))
        return ScaleBins(energy, *np.empty((3, bins, bands)))

    ends, wide = np.empty((2, windows + 1), np.int64)
    sums = np.empty((windows, (channels + 1) * bands))
    return _Work(
        fine=make_bins(),
        coarse=make_bins(),
        decay=np.empty((late, bands)),
        running=RunningSums(*np.empty((2, bins + 1))),
        weight=np.empty(bands),
        out=np.empty((late, channels * bands)),
        windows=_Windows(ends, wide, np.empty((windows, bands)), sums),
        curves=make_curve_scratch(windows, late),
    )


@part
def _cut_windows(plan: DenoisePlan, low: int, split: int, windows: _Windows) -> tuple[int, int]:
    """Windows of a pair from the late bin `low` on: (number of those whose energies stay, number of those to
    which curves are fitted).

    Sums over less than half of the coarsest scale are mostly noise, so such a window shares a knot with another.
    """
    ends, wide, count, fitted, k = windows.ends, windows.wide, 0, 0, 0
    ends[0], wide[0] = low, low
    for w in range(1, len(plan.windows)):
        for end in (min(split, plan.windows[w]), plan.windows[w]):
            if end <= ends[count]:
                continue
            count += 1
            ends[count] = end
            while plan.stretches[k + 1] < end:
                k += 1
            if 2 * (end - wide[fitted]) >= 2 ** plan.levels[k]:
                fitted += 1
            if fitted > 0:
                wide[fitted] = end
    if fitted == 0:
        fitted, wide[1] = 1, ends[count]
    if fitted == 1 and wide[1] > low + 1:  # a slope takes two
        fitted, wide[2], wide[1] = 2, wide[1], (low + wide[1]) // 2
    return count, fitted


@part
def _sum_windows(
    row: np.ndarray, difference: np.ndarray, first: int, count: int, fitted: int, windows: _Windows
) -> None:
    """Sum a pair's `row` (bins, 9, b), from bin `first` on, and `difference` (late bins, b) over its windows."""
    bands, energies = row.shape[2], row.shape[1] * row.shape[2]
    windows.energy[:count], windows.sums[:fitted] = 0.0, 0.0
    for w in range(count):
        for t in range(windows.ends[w], windows.ends[w + 1]):
            for b in range(bands):
                windows.energy[w, b] += row[first + t, 0, b]
    for w in range(fitted):
        for t in range(windows.wide[w], windows.wide[w + 1]):
            for b in range(bands):
                windows.sums[w, energies + b] += difference[t, b]
                for c in range(row.shape[1]):
                    windows.sums[w, c * bands + b] += row[first + t, c, b]


@part
def _fit_decay(plan: DenoisePlan, fitted: int, work: _Work) -> None:
    """The decay f that has the energies of a pair's windows, to `work.decay`."""
    windows, curves = work.windows, work.curves
    low, high = windows.wide[0], windows.wide[fitted]
    for t in range(low, high):
        curves.base[t] = plan.edges[t + 1] - plan.edges[t]
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
def _load(row: np.ndarray, difference: np.ndarray, first: int, span: _Span, work: _Work) -> None:
    """The raw bins of a span, to `work.fine`."""
    fine, bands = work.fine, row.shape[2]
    for t in range(span.count):
        for b in range(bands):
            for c in range(row.shape[1]):
                fine.energy[t, c * bands + b] = row[first + span.low + t, c, b]
            fine.decay[t, b] = work.decay[span.low + t, b]
            fine.noise[t, b] = difference[span.low + t, b]
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


@kernel
def _smooth(
    first: int,
    last: int,
    energy: np.ndarray,
    difference: np.ndarray,
    splits: np.ndarray,
    plan: DenoisePlan,
    work: _Work,
) -> None:
    """Smooth the pairs `first` to `last`, counted row by row; arrays as `smooth_late`'s."""
    columns, bins = energy.shape[1], difference.shape[2]
    for n in range(first, last):
        i, j = n // columns, n % columns
        row, onset = energy[i, j], 0
        while onset < bins and _is_silent(row, plan.first + onset):
            onset += 1  # nothing may come before the first sound
        if onset == bins:
            continue
        count, fitted = _cut_windows(plan, onset, splits[i, j] - plan.first, work.windows)
        _sum_windows(row, difference[i, j], plan.first, count, fitted, work.windows)
        _fit_decay(plan, fitted, work)
        for k in range(len(plan.levels)):
            if onset < plan.stretches[k + 1]:
                low = max(plan.stretches[k], onset)
                span = _Span(low, plan.stretches[k + 1] - low, fitted)
                _load(row, difference[i, j], plan.first, span, work)
                _smooth_stretch(plan, k, span, work)
        _restore(row, plan, count, fitted, work)


def smooth_late(
    energy: np.ndarray, difference: np.ndarray, splits: np.ndarray, plan: DenoisePlan
) -> None:
    """Smooth the late bins of echograms in place.

    `energy` (S, L, bins, 9, b), J/m²; `difference` (S, L, late bins, b): half of what estimates of it by subpaths
    of either end differ by, of any sign; `splits` (S, L): number of a bin before and from which on sums are kept,
    as they are between `plan.windows`. Where the difference is zero nothing changes beyond rounding.
    """
    late, splits = np.ascontiguousarray(difference), np.ascontiguousarray(splits)
    pairs = energy.shape[0] * energy.shape[1]
    over_rows(
        _smooth, pairs, energy, late, splits, plan, scratch=lambda: _make_work(plan, *energy.shape[3:])
    )
