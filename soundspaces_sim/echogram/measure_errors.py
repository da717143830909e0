"""Standard errors of room measures, by the jackknife over batches of walks.

With E the energy of a pair and E_k what it is without batch k of its K batches of walks, the variance of a measure
m is (K - 1)/K times the sum over k of (m(E_k) - mean)² (Efron & Stein 1981). Batches are kept in windows of time:
in each, leaving out batch k multiplies the energy that walks have brought by one factor. Discrete arrivals have no
error.

The variance of a variance from so few batches is large. Bands share the walks, so relative variances (of levels in
dB: absolute ones) are drawn towards their mean over the bands, as if that had `_PRIOR` degrees of freedom (a
moderated variance, Smyth 2004). Four standard errors are to be exceeded as rarely as four of a normal distribution:
of Student's t with this many degrees of freedom that asks for `_STUDENT` times as much.

Rare walks that carry much may be in none of the batches of one end. Late energies are means of estimates by walks
of either end, of which half the difference is known: half of what a measure differs by between both is told if it
is more.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.echogram.echogram import Arrivals
from soundspaces_sim.echogram.measure_names import MEASURES

_T20, _T30, _EDT, _C50, _C80, _D50, _TS, _DRR = range(len(MEASURES))
_LEVELS = np.array([name in ("c50", "c80", "drr") for name in MEASURES])  # in dB
_PRIOR = 15.0
_STUDENT = 1.161  # t.isf(norm.sf(4), 15 + _PRIOR) / 4
_DIRECT_S = 0.0025
ONSET = 0.01  # of the peak: where a response without direct sound starts


class _Work(NamedTuple):
    fixed: np.ndarray  # (bins, b) energy of discrete arrivals
    total: np.ndarray  # (bins,)
    sums: np.ndarray  # (windows,)
    found: np.ndarray  # (M, batches + 3): without each batch, of all, by walks of either end
    value: np.ndarray  # (M, b) by which relative errors are multiplied
    apart: np.ndarray  # (M, b) half of what both ends differ by
    lines: np.ndarray  # (3, 5) sums of a straight line's fit, for T20, T30, EDT


@part(forceinline=True)
def _fit(line, width, t, level):
    line[0] += width
    line[1] += width * t
    line[2] += width * level
    line[3] += width * t * t
    line[4] += width * t * level


@part(forceinline=True)
def _time(line):
    """60 dB over the slope of a fitted line, NaN if it does not fall."""
    below = line[0] * line[3] - line[1] * line[1]
    slope = line[0] * line[4] - line[1] * line[2]
    return -60.0 * below / slope if below > 0.0 and slope < 0.0 else math.nan


@part
def _measure(edges, total, start, onset, work, k):
    """Measures of energies `total` from bin `start` on to column `k` of `work.found`."""
    lines, found = work.lines, work.found
    lines[:] = 0.0
    whole, moment = 0.0, 0.0
    early = (0.0, 0.0, 0.0)  # up to 2.5, 50 and 80 ms
    for t in range(len(total) - 1, start - 1, -1):
        whole += total[t]
        moment += total[t] * (0.5 * (edges[t] + edges[t + 1]) - onset)
        width = edges[t + 1] - edges[t]
        a = min(max((onset + _DIRECT_S - edges[t]) / width, 0.0), 1.0)
        b = min(max((onset + 0.05 - edges[t]) / width, 0.0), 1.0)
        c = min(max((onset + 0.08 - edges[t]) / width, 0.0), 1.0)
        early = (early[0] + a * total[t], early[1] + b * total[t], early[2] + c * total[t])
    left = whole
    for t in range(start, len(total)):
        if left <= 0.0 or whole <= 0.0:
            break
        level = 10.0 * math.log10(left / whole)
        if level < -35.0:
            break
        width = edges[t + 1] - edges[t]
        if -25.0 <= level <= -5.0:
            _fit(lines[0], width, edges[t], level)
        if level <= -5.0:
            _fit(lines[1], width, edges[t], level)
        if level >= -10.0:
            _fit(lines[2], width, edges[t], level)
        left -= total[t]
    for n in range(3):
        found[n, k] = _time(lines[n])
    found[_C50, k] = _ratio(early[1], whole)
    found[_C80, k] = _ratio(early[2], whole)
    found[_D50, k] = early[1] / whole if whole > 0.0 else math.nan
    found[_TS, k] = moment / whole if whole > 0.0 else math.nan
    found[_DRR, k] = _ratio(early[0], whole)


@part(forceinline=True)
def _ratio(early, whole):
    """dB, NaN where one of both is nothing."""
    late = whole - early
    return 10.0 * math.log10(early / late) if early > 0.0 and late > 1e-12 * whole else math.nan


@part
def _discrete(edges, direct, delay, early, first, last, fixed):
    """Fill `fixed` (bins, b) with the direct sound and arrivals `first` to `last`; whether the former is there."""
    fixed[:] = 0.0
    for r in range(first, last):
        for b in range(len(direct)):
            fixed[_bin(edges, early.delay[r]), b] += early.energy[r, b]
    lit = False
    for b in range(len(direct)):
        lit |= direct[b] > 0.0
        fixed[_bin(edges, delay), b] += direct[b]
    return lit


@part
def _without(k, b, energy, batches, window, work):
    """`work.total` of band `b` without batch `k`, or of all batches if there is no such."""
    count = len(batches)
    for t in range(len(work.total)):
        factor, w = 1.0, window[t]
        if k < count and work.sums[w] > 0.0:
            factor = max((1.0 - batches[k, w, b] / work.sums[w]) * count / (count - 1.0), 0.0)
        work.total[t] = work.fixed[t, b] + factor * energy[t, 0, b]


@part
def _by_one_end(sign, b, energy, difference, work):
    """`work.total` of band `b` by walks of one end, so far as it is known."""
    first = len(work.total) - len(difference)
    for t in range(len(work.total)):
        of_end = energy[t, 0, b]
        if t >= first:
            of_end = max(of_end + sign * difference[t - first, b], 0.0)
        work.total[t] = work.fixed[t, b] + of_end


@part
def _jackknife(found, count):
    """Standard error of a measure whose values without each batch are the first `count` of `found`."""
    mean, squares = 0.0, 0.0
    for k in range(count):
        mean += found[k] / count
    for k in range(count):
        squares += (found[k] - mean) ** 2
    return math.sqrt(squares * (count - 1.0) / count)


@kernel
def _errors(
    first, last, edges, energy, direct, delay, start, early, batches, difference, window, out, work
):
    """Fill rows `first` to `last` of `out` (pairs, M, b); energies and batches have a row per pair."""
    count = batches.shape[1]
    for n in range(first, last):
        lit = _discrete(edges, direct[n], delay[n], early, start[n], start[n + 1], work.fixed)
        begins = _bin(edges, delay[n]) if lit else _onset(edges, energy[n], work.fixed)
        onset = edges[begins]  # whole bins, as `measures` has it
        for b in range(direct.shape[1]):
            work.sums[:] = 0.0
            for k in range(count):
                for w in range(len(work.sums)):
                    work.sums[w] += batches[n, k, w, b]
            for k in range(count + 1):
                _without(k, b, energy[n], batches[n], window, work)
                _measure(edges, work.total, begins, onset, work, k)
            for end in range(2):
                _by_one_end(2.0 * end - 1.0, b, energy[n], difference[n], work)
                _measure(edges, work.total, begins, onset, work, count + 1 + end)
            for m in range(out.shape[1]):
                found = work.found[m]
                scale = 1.0 if _LEVELS[m] else found[count]
                if m == _D50:  # alike over bands is the error of C50, 10 lg(D / (1 - D))
                    scale *= 1.0 - scale
                out[n, m, b] = _jackknife(found, count) / scale if scale > 0.0 else math.nan
                work.value[m, b], work.apart[m, b] = (
                    scale,
                    0.5 * abs(found[count + 2] - found[count + 1]),
                )
        _moderate(out[n], count - 1.0)
        for m in range(out.shape[1]):
            for b in range(out.shape[2]):
                out[n, m, b] *= _STUDENT * work.value[m, b]
                if work.apart[m, b] > out[n, m, b]:
                    out[n, m, b] = work.apart[m, b]


@part
def _moderate(errors, degrees):
    """Draw squares of errors (M, b) towards their mean over bands."""
    for m in range(errors.shape[0]):
        mean, known = 0.0, 0
        for b in range(errors.shape[1]):
            if errors[m, b] >= 0.0:
                mean += errors[m, b] ** 2
                known += 1
        for b in range(errors.shape[1]):
            if errors[m, b] >= 0.0:
                square = degrees * errors[m, b] ** 2 + _PRIOR * mean / known
                errors[m, b] = math.sqrt(square / (degrees + _PRIOR))


@part(forceinline=True)
def _bin(edges, time):
    """Number of the bin that holds a time; the last one for later times."""
    return min(max(np.searchsorted(edges, time, "right") - 1, 0), len(edges) - 2)


@part
def _onset(edges, energy, fixed):
    """Number of the first bin with as much energy per time as `ONSET` of the most (ISO 3382-1, A.3.4)."""
    most = 0.0
    for look in range(2):
        for t in range(len(fixed)):
            whole = 0.0
            for b in range(fixed.shape[1]):
                whole += (energy[t, 0, b] + fixed[t, b]) / (edges[t + 1] - edges[t])
            if look == 0:
                most = max(most, whole)
            elif whole > 0.0 and whole >= ONSET * most:
                return t
    return 0


def measure_errors(
    time_edges: np.ndarray, energy: np.ndarray, direct: np.ndarray, delay: np.ndarray,
    early_start: np.ndarray, early: Arrivals, batches: np.ndarray, difference: np.ndarray, window: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(S, L, M, b) standard errors of `MEASURES`, each in its own unit: s, dB, or 1 of D50.

    `energy` (S, L, bins, 9, b) between `time_edges` (bins + 1,) s, `direct` (S, L, b), `delay` (S, L) of the direct
    sound, s; discrete arrivals as `Echograms` has them; `batches` (S, L, K, windows, b) the energy of each batch of
    walks in windows, of which bin t belongs to `window[t]`; `difference` (S, L, late bins, b) half of what
    estimates of the last bins by walks of either end differ by. NaN where a measure is not defined without a batch.
    """
    pairs, bands, windows = energy.shape[0] * energy.shape[1], energy.shape[4], batches.shape[3]
    out = np.empty((pairs, len(MEASURES), bands))
    bins, count = len(time_edges) - 1, batches.shape[2]
    over_rows(
        _errors, pairs, time_edges, energy.reshape(pairs, *energy.shape[2:]), direct.reshape(pairs, bands),
        delay.ravel(), early_start, _Early(early.delay, early.energy), batches.reshape(pairs, *batches.shape[2:]),
        difference.reshape(pairs, *difference.shape[2:]),
        window, out,
        scratch=lambda: _Work(
            np.empty((bins, bands)), np.empty(bins), np.empty(windows),
            np.empty((len(MEASURES), count + 3)), *np.empty((2, len(MEASURES), bands)), np.empty((3, 5)),
        ),
    )  # fmt: skip
    return out.reshape(*energy.shape[:2], len(MEASURES), bands)


class _Early(NamedTuple):
    delay: np.ndarray
    energy: np.ndarray
