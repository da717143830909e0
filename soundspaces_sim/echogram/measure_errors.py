"""Standard errors of room measures, by balanced half-samples of batches of subpaths.

With K batches, K a power of two, a Hadamard matrix of order K has K - 1 rows of as many +1 as -1, all
orthogonal. Each tells two half-samples: batches with +1 count twice and others not at all, and the other way
round. The variance of a measure is its mean squared deviation over them (balanced repeated replication,
McCarthy 1969). For a sum that is the variance by batches; as a half-sample is off by about a standard error, it
also meets what is not smooth, such as an arrival that crosses the level from which a decay is fitted, or
another onset. Batches are kept in windows of time, in each of which a half-sample multiplies energy by one
factor. Discrete arrivals have no error.

The variance of a variance from so few batches is large. Bands share the subpaths, so relative variances (of
levels in dB: absolute ones) are drawn towards their mean over the bands, as if that had `_PRIOR` degrees of
freedom (a moderated variance, Smyth 2004). Four standard errors are to be exceeded as rarely as four of a
normal distribution: of Student's t with this many degrees of freedom that asks for `_STUDENT` times as much.

Rare subpaths that carry much may be in none of the batches of one end. Late energies are means of estimates by
either end: an error is at least half of what a measure differs by between both, and at least what denoising late
bins has moved the measure by (`widened`).
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import hadamard

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.measure_names import MEASURES

_T20, _T30, _EDT, _C50, _C80, _D50, _TS, _DRR = range(len(MEASURES))
_LEVELS = np.array([name in ("c50", "c80", "drr") for name in MEASURES])  # in dB
_PRIOR = 15.0
_STUDENT = 1.161  # t.isf(norm.sf(4), 15 + _PRIOR) / 4
DIRECT_S = 0.0025  # of the direct sound, for the direct-to-reverberant ratio
ONSET = 0.01  # of the peak: where a response without direct sound starts


class _Pairs(NamedTuple):
    """What echograms have, with a row per pair."""

    edges: np.ndarray  # (bins + 1,) s
    energy: np.ndarray  # (pairs, bins, 9, b)
    direct: np.ndarray  # (pairs, b)
    delay: np.ndarray  # (pairs,) of the direct sound, s
    start: np.ndarray  # (pairs + 1,) rows of discrete arrivals
    at: np.ndarray  # (n,) their delays, s
    arrived: np.ndarray  # (n, b) their energies


class _Samples(NamedTuple):
    """By which errors are measured, with a row per pair."""

    batches: np.ndarray  # (pairs, K, windows, b) energy of each batch of subpaths
    difference: np.ndarray  # (pairs, late bins, b) half of what estimates by either end differ by
    window: np.ndarray  # (bins,) of `batches`
    signs: np.ndarray  # (K - 1, K) of batches in each half-sample and its complement


class _Work(NamedTuple):
    fixed: np.ndarray  # (bins, b) energy of discrete arrivals
    total: np.ndarray  # (bins, b)
    found: np.ndarray  # (M, b, half-samples + 3): of these, of all, by subpaths of either end
    value: np.ndarray  # (M, b) by which relative errors are multiplied
    lines: np.ndarray  # (3, 5) sums of a straight line's fit, for T20, T30, EDT


@part(forceinline=True)
def _fit(line: np.ndarray, width: float, t: float, level: float) -> None:
    line[0] += width
    line[1] += width * t
    line[2] += width * level
    line[3] += width * t * t
    line[4] += width * t * level


@part(forceinline=True)
def _time(line: np.ndarray) -> float:
    """60 dB over the slope of a fitted line, NaN if it does not fall."""
    below, slope = line[0] * line[3] - line[1] * line[1], line[0] * line[4] - line[1] * line[2]
    return -60.0 * below / slope if below > 0.0 and slope < 0.0 else math.nan


@part(forceinline=True)
def _share(end: float, start: float, width: float) -> float:
    """Part of a bin that lies before a time."""
    return min(max((end - start) / width, 0.0), 1.0)


@part
def _measure_band(edges: np.ndarray, start: int, b: int, work: _Work, k: int) -> None:
    """Measures of band `b` of `work.total` from bin `start` on to column `k` of `work.found`."""
    lines, found, total, onset = work.lines, work.found, work.total, edges[start]
    lines[:] = 0.0
    whole, moment = 0.0, 0.0
    early = (0.0, 0.0, 0.0)  # up to 2.5, 50 and 80 ms
    for t in range(len(total) - 1, start - 1, -1):
        whole += total[t, b]
        moment += total[t, b] * (0.5 * (edges[t] + edges[t + 1]) - onset)
        width = edges[t + 1] - edges[t]
        early = (
            early[0] + _share(onset + DIRECT_S, edges[t], width) * total[t, b],
            early[1] + _share(onset + 0.05, edges[t], width) * total[t, b],
            early[2] + _share(onset + 0.08, edges[t], width) * total[t, b],
        )
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
        left -= total[t, b]
    for n in range(3):
        found[n, b, k] = _time(lines[n])
    found[_C50, b, k] = _ratio(early[1], whole)
    found[_C80, b, k] = _ratio(early[2], whole)
    found[_D50, b, k] = early[1] / whole if whole > 0.0 else math.nan
    found[_TS, b, k] = moment / whole if whole > 0.0 else math.nan
    found[_DRR, b, k] = _ratio(early[0], whole)


@part(forceinline=True)
def _ratio(early: float, whole: float) -> float:
    """dB, NaN where one of both is nothing."""
    late = whole - early
    return 10.0 * math.log10(early / late) if early > 0.0 and late > 1e-12 * whole else math.nan


@part
def _place(pairs: _Pairs, n: int, fixed: np.ndarray) -> bool:
    """Fill `fixed` (bins, b) with the discrete arrivals of pair `n`; whether the direct sound is one."""
    edges, direct, lit = pairs.edges, pairs.direct[n], False
    fixed[:] = 0.0
    for r in range(pairs.start[n], pairs.start[n + 1]):
        for b in range(len(direct)):
            fixed[_bin(edges, pairs.at[r]), b] += pairs.arrived[r, b]
    for b in range(len(direct)):
        lit |= direct[b] > 0.0
        fixed[_bin(edges, pairs.delay[n]), b] += direct[b]
    return lit


@part
def _measure(pairs: _Pairs, n: int, lit: bool, work: _Work, k: int) -> None:
    """Measures of `work.total` to column `k` of `work.found`, from the bin of its onset on, as in `measures`."""
    start = _bin(pairs.edges, pairs.delay[n]) if lit else _onset(pairs.edges, work.total)
    for b in range(work.total.shape[1]):
        _measure_band(pairs.edges, start, b, work, k)


@part
def _whole(energy: np.ndarray, work: _Work) -> None:
    """Fill `work.total`."""
    for t in range(len(work.total)):
        for b in range(work.total.shape[1]):
            work.total[t, b] = work.fixed[t, b] + energy[t, 0, b]


@part
def _half(samples: _Samples, n: int, k: int, energy: np.ndarray, work: _Work) -> None:
    """Fill `work.total` with half-sample `k` of pair `n`: batches whose sign is +1, or, of odd `k`, -1."""
    signs, turn = samples.signs[k // 2], 1.0 - 2.0 * (k % 2)
    batches, window = samples.batches[n], samples.window
    for b in range(work.total.shape[1]):
        factor, last = 1.0, -1
        for t in range(len(work.total)):
            if window[t] != last:
                last = window[t]
                whole, more = 0.0, 0.0
                for k in range(len(batches)):
                    whole += batches[k, last, b]
                    more += signs[k] * batches[k, last, b]
                factor = max(1.0 + turn * more / whole, 0.0) if whole > 0.0 else 1.0
            work.total[t, b] = work.fixed[t, b] + factor * energy[t, 0, b]


@part
def _by_one_end(sign: float, energy: np.ndarray, difference: np.ndarray, work: _Work) -> None:
    """Fill `work.total` with what subpaths of one end say, so far as it is known."""
    first = len(work.total) - len(difference)
    _whole(energy, work)
    for t in range(len(difference)):
        for b in range(work.total.shape[1]):
            of_end = max(energy[first + t, 0, b] + sign * difference[t, b], 0.0)
            work.total[first + t, b] = work.fixed[first + t, b] + of_end


@part(forceinline=True)
def _spread(found: np.ndarray, halves: int) -> float:
    """Root of the mean square by which the first `halves` of `found` differ from the value that follows them."""
    squares = 0.0
    for k in range(halves):
        squares += (found[k] - found[halves]) ** 2
    return math.sqrt(squares / halves)


@kernel
def _errors(
    first: int, last: int, pairs: _Pairs, samples: _Samples, out: np.ndarray, work: _Work
) -> None:
    """Fill rows `first` to `last` of `out` (pairs, M, b)."""
    degrees, halves = len(samples.signs), 2 * len(samples.signs)
    for n in range(first, last):
        energy, found, value = pairs.energy[n], work.found, work.value
        lit = _place(pairs, n, work.fixed)
        for k in range(halves):
            _half(samples, n, k, energy, work)
            _measure(pairs, n, lit, work, k)
        _whole(energy, work)
        _measure(pairs, n, lit, work, halves)
        for end in range(2):
            _by_one_end(2.0 * end - 1.0, energy, samples.difference[n], work)
            _measure(pairs, n, lit, work, halves + 1 + end)
        for m in range(out.shape[1]):
            for b in range(out.shape[2]):
                scale = 1.0 if _LEVELS[m] else found[m, b, halves]
                if m == _D50:  # alike over bands is the error of C50, 10 lg(D / (1 - D))
                    scale *= 1.0 - scale
                out[n, m, b] = _spread(found[m, b], halves) / scale if scale > 0.0 else math.nan
                value[m, b] = scale
        _moderate(out[n], degrees)
        for m in range(out.shape[1]):
            for b in range(out.shape[2]):
                out[n, m, b] *= _STUDENT * value[m, b]
                apart = 0.5 * abs(found[m, b, halves + 2] - found[m, b, halves + 1])
                if apart > out[n, m, b]:
                    out[n, m, b] = apart


@kernel
def _values(first: int, last: int, pairs: _Pairs, out: np.ndarray, work: _Work) -> None:
    """Fill rows `first` to `last` of `out` (pairs, M, b)."""
    for n in range(first, last):
        lit = _place(pairs, n, work.fixed)
        _whole(pairs.energy[n], work)
        _measure(pairs, n, lit, work, 0)
        for m in range(out.shape[1]):
            for b in range(out.shape[2]):
                out[n, m, b] = work.found[m, b, 0]


@part
def _moderate(errors: np.ndarray, degrees: int) -> None:
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
def _bin(edges: np.ndarray, time: float) -> int:
    """Number of the bin that holds a time; the last one for later times."""
    return min(max(np.searchsorted(edges, time, "right") - 1, 0), len(edges) - 2)  # type: ignore[return-value]


@part
def _onset(edges: np.ndarray, total: np.ndarray) -> int:
    """Number of the first bin with as much energy per time as `ONSET` of the most (ISO 3382-1, A.3.4)."""
    most = 0.0
    for look in range(2):
        for t in range(len(total)):
            whole = 0.0
            for b in range(total.shape[1]):
                whole += total[t, b] / (edges[t + 1] - edges[t])
            if look == 0:
                most = max(most, whole)
            elif whole > 0.0 and whole >= ONSET * most:
                return t
    return 0


def _pairs(echoes: Echograms) -> _Pairs:
    count = echoes.shape[0] * echoes.shape[1]
    return _Pairs(
        echoes.time_edges,
        echoes.energy.reshape(count, *echoes.energy.shape[2:]),
        np.ascontiguousarray(echoes.direct_energy.reshape(count, -1), float),
        echoes.direct_length.ravel() / echoes.speed_of_sound,
        echoes.early_start,
        echoes.early.delay,
        echoes.early.energy,
    )


def _work(bins: int, bands: int, columns: int) -> _Work:
    shape = len(MEASURES), bands
    return _Work(
        np.empty((bins, bands)),
        np.empty((bins, bands)),
        np.empty((*shape, columns)),
        np.empty(shape),
        np.empty((3, 5)),
    )


def measure_values(echoes: Echograms) -> np.ndarray:
    """(S, L, M, b) values of `MEASURES` from bins as they are stored, of every decay, however short."""
    pairs, bands = _pairs(echoes), echoes.energy.shape[4]
    out = np.empty((len(pairs.energy), len(MEASURES), bands))
    over_rows(_values, len(out), pairs, out, scratch=lambda: _work(echoes.energy.shape[2], bands, 1))
    return out.reshape(*echoes.shape, len(MEASURES), bands)


def measure_errors(
    echoes: Echograms, batches: np.ndarray, difference: np.ndarray, window: np.ndarray
) -> np.ndarray:
    """(S, L, M, b) standard errors of `MEASURES`, each in its own unit: s, dB, or 1 of D50.

    `batches` (S, L, K, windows, b) the energy of each batch of subpaths in windows, of which bin t belongs to
    `window[t]`, in order; K a power of two; `difference` (S, L, late bins, b) half of what estimates of the last
    bins by subpaths of either end differ by. NaN where a measure is not defined in a half-sample, and of the
    direct-to-reverberant ratio out of sight.
    """
    pairs, bands = _pairs(echoes), echoes.energy.shape[4]
    count, signs = len(pairs.energy), hadamard(batches.shape[2], float)[1:]
    out = np.empty((count, len(MEASURES), bands))
    samples = _Samples(
        batches.reshape(count, *batches.shape[2:]),
        difference.reshape(count, *difference.shape[2:]),
        window,
        signs,
    )
    columns, bins = 2 * len(signs) + 3, echoes.energy.shape[2]
    over_rows(_errors, count, pairs, samples, out, scratch=lambda: _work(bins, bands, columns))
    out = out.reshape(*echoes.shape, len(MEASURES), bands)
    out[echoes.walls > 0, _DRR] = np.nan
    return out


def widened(echoes: Echograms, values: np.ndarray) -> Echograms:
    """Smoothed echograms, with errors not below what measures have moved by from `values` (S, L, M, b)."""
    assert echoes.measure_error is not None  # of all that is traced
    moved = np.abs(measure_values(echoes) - values).astype(np.float32)
    return replace(echoes, measure_error=np.maximum(echoes.measure_error, moved))
