"""Standard errors of room measures, by balanced half-samples of batches of subpaths.

With K batches, K a power of two, a Hadamard matrix of order K has K - 1 rows of as many +1 as -1, all
orthogonal. Each tells two half-samples: batches with +1 count twice and others not at all, and the other way
round. The variance of a measure is its mean squared deviation over them (balanced repeated replication,
McCarthy 1969). For a sum that is the variance by batches; as a half-sample is off by about a standard error, it
also meets what is not smooth, such as an arrival that crosses the level from which a decay is fitted, or
another onset. Batches are kept in windows of time, in each of which a half-sample multiplies energy by one
factor. Discrete arrivals have no error. Times come from straight lines through levels, so from a logarithm for each
bin, band and half-sample. That would be most of the work, so the logarithm is one that several bins share
instructions for (`_take_logarithms`).

The variance of a variance from so few batches is large. Bands share the subpaths, so relative variances (of
levels in dB: absolute ones) that are below their mean over the bands are drawn towards it, as if that had `_PRIOR`
degrees of freedom (a moderated variance, Smyth 2004); a band that owes more to chance than others keeps its own.
Deviations over errors are then of Student's t with that many degrees of freedom, whose standard deviation is
`_STUDENT`: errors are as much larger, so that it is 1.

A reverberation time may owe much to few lucky subpaths, and a seed that lacks them has a small error. As few
batches then carry what is left later, at `LATER` of the last level. If n do, the error is as much wider as
Student's t has a larger standard deviation with n - 1 degrees of freedom than with K - 1.

Rare subpaths that carry much may be in none of the batches of one end. Late energies are means of estimates by
either end. Where half of what a measure differs by between both is above `UNLIKELY` errors, it is the error.
Without that limit it would be above a right error in one of three cases. An error is at least what denoising late
bins has moved the measure by (`widened`).

Out of sight, sound begins where it comes within 20 dB of its peak. The peak is a single bin, whose noise is more
than that of its window: of energies that are alike its relative variance is that of the window times the ratio of
both energies. Half of what measures differ by, from the onsets for a peak one standard error higher and lower,
adds to the error as an independent one.

What a measure rests on may be by fewer subpaths than early or late energy as a whole: what comes within 50 or 80 ms
of the onset, for clarity and definition; for reverberation times, what is left where the levels end to which a line
is fitted. Where `LEAST_EFFECTIVE` batches do not carry it, the error is not known (`_judge_numbers`).
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
_STUDENT = math.sqrt((15.0 + _PRIOR) / (13.0 + _PRIOR))
LEAST_EFFECTIVE = (
    8.0  # batches that carry an estimate: as of 15 subpaths of equal energy (theory, section 7)
)
UNLIKELY = 3.0  # standard errors by which estimates of either end may lie off their mean
#: What errors rest on: energy up to so many s from the onset, or what is left at such a level; and which on which.
_RESTS_ON = ((0.05, 0.0), (0.08, 0.0), (0.0, 0.1), (0.0, 10.0**-2.5), (0.0, 10.0**-3.5))
_RESTING = np.array(
    [{"c50": 0, "d50": 0, "c80": 1, "edt": 2, "t20": 3, "t30": 4}.get(m, -1) for m in MEASURES]
)
LATER = 0.1  # of what is left at such a level: there batches are counted that tell how well an error is known
_LEAST_COUNTED = 4.0  # down to which errors are as much wider as Student's t says
DIRECT_S = 0.0025  # of the direct sound, for the direct-to-reverberant ratio
_LOWEST = 10.0**-3.51  # of the energy of a decay: no measure looks below -35 dB
_ROOT_BITS = np.int32(0x3F3504F3)  # of the root of one half in single precision
_DB_OF_E = 10.0 / math.log(10.0)
_DB_OF_TWO = 10.0 * math.log10(2.0)
ONSET = 0.01  # of the peak: where a response without direct sound starts


class _Bins(NamedTuple):
    """Of an echogram."""

    edges: np.ndarray  # (bins + 1,) s
    width: np.ndarray  # (bins,) s
    middle: np.ndarray  # (bins,) s
    # (3, bins + 1) of widths, times t and times t², of bins that begin at t, before each
    sums: np.ndarray


class _Pairs(NamedTuple):
    """What echograms have, with a row per pair."""

    bins: _Bins
    energy: np.ndarray  # (pairs, bins, 9, b)
    direct: np.ndarray  # (pairs, b)
    delay: np.ndarray  # (pairs,) of the direct sound, s
    start: np.ndarray  # (pairs + 1,) rows of discrete arrivals
    at: np.ndarray  # (n,) their delays, s
    arrived: np.ndarray  # (n, b) their energies
    wanted: np.ndarray  # (w,) pairs that are looked at


class _Samples(NamedTuple):
    """By which errors are measured, with a row per pair."""

    batches: np.ndarray  # (pairs, K, windows, b) energy of each batch of subpaths
    difference: np.ndarray  # (pairs, late bins, b) half of what estimates by either end differ by
    first: np.ndarray  # (windows + 1,) bin with which each window of `batches` begins
    signs: np.ndarray  # (K - 1, K) of batches in each half-sample and its complement


class _Levels(NamedTuple):
    """Levels of a decay, and what their logarithms are made in; some are two views of the same memory."""

    level: np.ndarray  # (bins,) dB
    ratio: np.ndarray  # (bins,) float32
    ratio_bits: np.ndarray  # the same, int32
    scaled: np.ndarray  # (bins,) float32, from .7 to 1.4
    scaled_bits: np.ndarray  # the same, int32
    exponent: np.ndarray  # (bins,) float32


class _Work(NamedTuple):
    fixed: np.ndarray  # (b, bins) energy of discrete arrivals
    energy: np.ndarray  # (b, bins) of all else
    total: np.ndarray  # (b, bins)
    rate: np.ndarray  # (bins,) energy per time of all bands
    whole: np.ndarray  # (windows, b) of all batches
    squares: np.ndarray  # (windows, b) of the energies of batches, summed
    more: np.ndarray  # (K - 1, windows, b) by which batches with +1 exceed those with -1
    levels: _Levels
    # (M, b, half-samples + 5): of these, of all, by subpaths of either end, by either onset
    found: np.ndarray
    value: np.ndarray  # (M, b) by which relative errors are multiplied
    inverse: np.ndarray  # (2, b) of `_inverse_numbers`: of a band alone, and drawn to the median


@part(forceinline=True)
def _take_logarithms(levels: _Levels, count: int) -> None:
    """10 lg of the first `count` of `levels.ratio`, above zero, to `levels.level`, to 1e-6 dB: the exponent of two,
    and a series of lg((1 + s) / (1 - s))."""
    for t in range(count):
        exponent = (levels.ratio_bits[t] - _ROOT_BITS) >> 23
        levels.exponent[t] = exponent
        levels.scaled_bits[t] = levels.ratio_bits[t] - (exponent << 23)
    for t in range(count):
        s = (levels.scaled[t] - 1.0) / (levels.scaled[t] + 1.0)
        square = s * s
        series = 1.0 + square * (1.0 / 3.0 + square * (0.2 + square * (1.0 / 7.0 + square / 9.0)))
        levels.level[t] = _DB_OF_TWO * levels.exponent[t] + _DB_OF_E * 2.0 * s * series


@part(forceinline=True, fastmath={"reassoc", "contract"})
def _line_time(bins: _Bins, level: np.ndarray, start: int, first: int, last: int) -> float:
    """60 dB over the slope of a straight line through the levels `first` to `last`, of bins from `start` on; NaN if
    it does not fall."""
    low, high = start + first, start + max(last, first)
    levels, widths, times = level[first:last], bins.width[low:high], bins.edges[low:high]
    of_level, of_both = 0.0, 0.0
    for n in range(len(levels)):
        weighted = widths[n] * levels[n]
        of_level += weighted
        of_both += weighted * times[n]
    width = bins.sums[0, high] - bins.sums[0, low]
    of_time = bins.sums[1, high] - bins.sums[1, low]
    square = bins.sums[2, high] - bins.sums[2, low]
    below, slope = width * square - of_time * of_time, width * of_both - of_time * of_level
    return -60.0 * below / slope if below > 0.0 and slope < 0.0 else math.nan


@part(forceinline=True, fastmath={"reassoc", "contract"})
def _sum(values: np.ndarray) -> float:
    total = 0.0
    for t in range(len(values)):
        total += values[t]
    return total


@part(forceinline=True, fastmath={"reassoc", "contract"})
def _sum_times(values: np.ndarray, factor: np.ndarray) -> float:
    total = 0.0
    for t in range(len(values)):
        total += values[t] * factor[t]
    return total


@part(forceinline=True)
def _find_levels(total: np.ndarray, whole: float, levels: _Levels) -> int:
    """Levels of the energy that is left at the beginning of bins, as far as `_LOWEST`; how many."""
    count, left, least, scale = 0, whole, _LOWEST * whole, 1.0 / whole
    for t in range(len(total)):
        if left <= least:
            break
        levels.ratio[t] = left * scale
        left -= total[t]
        count += 1
    _take_logarithms(levels, count)
    return count


@part(forceinline=True)
def _until(level: np.ndarray, first: int, count: int, least: float) -> int:
    """The first from `first` on whose level is below `least`, or `count`."""
    while first < count and level[first] >= least:
        first += 1
    return first


@part(forceinline=True)
def _place_of(bins: _Bins, start: int, after: float) -> tuple[int, float]:
    """The bin, counted from bin `start` on, and the part of it that end so long after the beginning of that."""
    t = max(_bin(bins.edges, bins.edges[start] + after), start)
    return t - start, min((bins.edges[start] + after - bins.edges[t]) / bins.width[t], 1.0)


@part
def _measure_band(
    bins: _Bins, start: int, limits: tuple[tuple[int, float], ...], b: int, work: _Work, k: int
) -> None:
    """Measures of band `b` of `work.total` from bin `start` on to column `k` of `work.found`; `limits`: where 2.5,
    50 and 80 ms end."""
    found, onset = work.found, bins.edges[start]
    total, middle = work.total[b, start:], bins.middle[start:]
    whole = _sum(total)
    if whole <= 0.0:
        for m in range(len(found)):
            found[m, b, k] = math.nan
        return
    direct, clear, clearest = limits
    of_direct = _sum(total[: direct[0]])
    before = of_direct + _sum(total[direct[0] : clear[0]])
    up_to_50 = before + clear[1] * total[clear[0]]
    up_to_80 = before + _sum(total[clear[0] : clearest[0]]) + clearest[1] * total[clearest[0]]
    level = work.levels.level
    count = _find_levels(total, whole, work.levels)
    first = _until(level, 0, count, -5.0)
    tenth = _until(level, first, count, -10.0)
    twenty = _until(level, tenth, count, -25.0)
    thirty = _until(level, twenty, count, -35.0)
    found[_T20, b, k] = _line_time(bins, level, start, first, twenty)
    found[_T30, b, k] = _line_time(bins, level, start, first, thirty)
    found[_EDT, b, k] = _line_time(bins, level, start, 0, tenth)
    found[_C50, b, k] = _ratio(up_to_50, whole)
    found[_C80, b, k] = _ratio(up_to_80, whole)
    found[_D50, b, k] = up_to_50 / whole
    found[_TS, b, k] = _sum_times(total, middle) / whole - onset
    found[_DRR, b, k] = _ratio(of_direct + direct[1] * total[direct[0]], whole)


@part(forceinline=True)
def _ratio(early: float, whole: float) -> float:
    """dB, NaN where one of both is nothing."""
    late = whole - early
    return 10.0 * math.log10(early / late) if early > 0.0 and late > 1e-12 * whole else math.nan


@part
def _load(pairs: _Pairs, n: int, work: _Work) -> bool:
    """Fill `work.fixed` with the discrete arrivals of pair `n`, and `work.energy`; whether direct sound is one."""
    edges, direct, lit = pairs.bins.edges, pairs.direct[n], False
    work.fixed[:] = 0.0
    for r in range(pairs.start[n], pairs.start[n + 1]):
        t = _bin(edges, pairs.at[r])
        for b in range(len(direct)):
            work.fixed[b, t] += pairs.arrived[r, b]
    at = _bin(edges, pairs.delay[n])
    for b in range(len(direct)):
        lit |= direct[b] > 0.0
        work.fixed[b, at] += direct[b]
        for t in range(work.energy.shape[1]):
            work.energy[b, t] = pairs.energy[n, t, 0, b]
    return lit


@part(forceinline=True)
def _start(pairs: _Pairs, n: int, lit: bool, work: _Work) -> int:
    """The bin of the onset of `work.total`."""
    return _bin(pairs.bins.edges, pairs.delay[n]) if lit else _onset(pairs.bins, work, ONSET)


@part
def _measure(pairs: _Pairs, n: int, lit: bool, work: _Work, k: int) -> None:
    """Measures of `work.total` to column `k` of `work.found`, from the bin of its onset on, as in `measures`."""
    _measure_from(pairs.bins, _start(pairs, n, lit, work), work, k)


@part
def _measure_from(bins: _Bins, start: int, work: _Work, k: int) -> None:
    """The same from bin `start` on."""
    limits = (
        _place_of(bins, start, DIRECT_S),
        _place_of(bins, start, 0.05),
        _place_of(bins, start, 0.08),
    )
    for b in range(len(work.total)):
        _measure_band(bins, start, limits, b, work, k)


@part
def _whole(work: _Work) -> None:
    """Fill `work.total`."""
    for b in range(len(work.total)):
        for t in range(work.total.shape[1]):
            work.total[b, t] = work.fixed[b, t] + work.energy[b, t]


@part
def _sum_batches(samples: _Samples, n: int, work: _Work) -> None:
    """Fill `work.whole`, `work.squares`, and `work.more` with what half-samples of pair `n` differ by."""
    batches, signs = samples.batches[n], samples.signs
    work.whole[:], work.squares[:], work.more[:] = 0.0, 0.0, 0.0
    for k in range(len(batches)):
        for w in range(batches.shape[1]):
            for b in range(batches.shape[2]):
                work.whole[w, b] += batches[k, w, b]
                work.squares[w, b] += np.float64(batches[k, w, b]) ** 2
        for h in range(len(signs)):
            sign = signs[h, k]
            for w in range(batches.shape[1]):
                for b in range(batches.shape[2]):
                    work.more[h, w, b] += sign * batches[k, w, b]


@part
def _half(samples: _Samples, k: int, work: _Work) -> None:
    """Fill `work.total` with half-sample `k`: batches whose sign is +1, or, of odd `k`, -1."""
    turn, first = 1.0 - 2.0 * (k % 2), samples.first
    for b in range(len(work.total)):
        for w in range(len(first) - 1):
            whole = work.whole[w, b]
            factor = max(1.0 + turn * work.more[k // 2, w, b] / whole, 0.0) if whole > 0.0 else 1.0
            low, high = first[w], first[w + 1]
            total, fixed, energy = (
                work.total[b, low:high],
                work.fixed[b, low:high],
                work.energy[b, low:high],
            )
            for t in range(len(total)):
                total[t] = fixed[t] + factor * energy[t]


@part
def _by_one_end(sign: float, difference: np.ndarray, work: _Work) -> None:
    """Fill `work.total` with what subpaths of one end say, so far as it is known."""
    first = work.total.shape[1] - len(difference)
    _whole(work)
    for t in range(len(difference)):
        for b in range(len(work.total)):
            of_end = max(work.energy[b, first + t] + sign * difference[t, b], 0.0)
            work.total[b, first + t] = work.fixed[b, first + t] + of_end


@part
def _peak_error(samples: _Samples, work: _Work) -> float:
    """Relative standard error of the highest rate of all bands, `work.rate` as `_onset` has left it of
    `work.total`; at most 1."""
    peak, first = int(np.argmax(work.rate)), samples.first
    w = 0
    while w + 2 < len(first) and first[w + 1] <= peak:
        w += 1
    of_bin, of_window, whole, total, squares = 0.0, 0.0, 0.0, 0.0, 0.0
    for b in range(len(work.total)):
        of_bin += work.energy[b, peak]
        of_window += _sum(work.energy[b, first[w] : first[w + 1]])
        total += work.total[b, peak]
        whole += work.whole[w, b]
    for h in range(len(work.more)):
        apart = 0.0
        for b in range(len(work.total)):
            apart += work.more[h, w, b]
        squares += apart * apart
    if of_bin <= 0.0 or whole <= 0.0:
        return 0.0
    variance = squares / len(work.more) / (whole * whole) * of_window / of_bin
    return min(math.sqrt(variance), 1.0) * of_bin / total


@part
def _measure_onsets(pairs: _Pairs, samples: _Samples, work: _Work, k: int) -> bool:
    """Measures of `work.total`, out of sight, to columns `k` and `k + 1` of `work.found`, from the onsets for a
    peak one standard error lower and higher; whether these differ."""
    _onset(pairs.bins, work, ONSET)
    higher = 1.0 + _peak_error(samples, work)
    late, early = _onset(pairs.bins, work, ONSET * higher), _onset(pairs.bins, work, ONSET / higher)
    if early == late:
        return False
    _measure_from(pairs.bins, early, work, k)
    _measure_from(pairs.bins, late, work, k + 1)
    return True


@part
def _inverse_number(
    samples: _Samples, bins: _Bins, work: _Work, b: int, begin: float, end: float
) -> float:
    """1 / the number of batches that carry what arrives from `begin` to `end` s in a band, in the harmonic mean
    over energy (`integrator.effective_batches`); what is exact is carried by all."""
    first, batches = samples.first, samples.batches.shape[1]
    by_number, whole = 0.0, 0.0
    for w in range(len(first) - 1):
        low, high = bins.edges[first[w]], bins.edges[first[w + 1]]
        share = max((min(end, high) - max(begin, low)) / (high - low), 0.0)
        exact = share * _sum(work.fixed[b, first[w] : first[w + 1]])
        by_number += exact / batches
        if work.whole[w, b] > 0.0:
            by_number += share * work.squares[w, b] / work.whole[w, b]
        whole += exact + share * work.whole[w, b]
    return by_number / whole if whole > 0.0 else 1.0 / batches


@part(forceinline=True)
def _level_time(bins: _Bins, total: np.ndarray, level: float) -> float:
    """When as much of all energy is left as `level` says."""
    least, left, t = level * _sum(total), 0.0, len(total)
    while t > 0 and left < least:
        t -= 1
        left += total[t]
    return bins.edges[t]


@part
def _inverse_numbers(
    samples: _Samples, bins: _Bins, start: int, work: _Work, after: float, level: float
) -> None:
    """Fill `work.inverse` by band with 1 / the number of batches that carry what comes up to `after` s from bin
    `start` on or, if `level` is above zero, what is left from that level on; and with the same drawn half way to
    the median over bands, which share the subpaths."""
    bands, inverse, onset = len(work.total), work.inverse, bins.edges[start]
    for b in range(bands):
        begin, end = onset, onset + after
        if level > 0.0:
            begin, end = _level_time(bins, work.total[b], level), bins.edges[len(bins.edges) - 1]
        inverse[0, b] = _inverse_number(samples, bins, work, b, begin, end)
        place = b
        while place > 0 and inverse[1, place - 1] > inverse[0, b]:
            inverse[1, place] = inverse[1, place - 1]
            place -= 1
        inverse[1, place] = inverse[0, b]
    median = 0.5 * (inverse[1, bands // 2] + inverse[1, (bands - 1) // 2])
    for b in range(bands):
        inverse[1, b] = 0.5 * (inverse[0, b] + median)


@part
def _judge_numbers(samples: _Samples, bins: _Bins, start: int, work: _Work, out: np.ndarray) -> None:
    """Make errors `out` (M, b) NaN where too few batches carry what a measure rests on: what comes up to 50 or
    80 ms from bin `start` on, or what is left at the end of the levels to which a line is fitted. Fill `work.value`
    with how much wider errors are, as so few carry what is left `LATER`."""
    inverse, batches = work.inverse, samples.batches.shape[1]
    work.value[:] = 1.0
    for n in range(len(_RESTS_ON)):
        after, level = _RESTS_ON[n]
        _inverse_numbers(samples, bins, start, work, after, level)
        for m in range(len(out)):
            for b in range(out.shape[1]):
                if _RESTING[m] == n and inverse[1, b] > 1.0 / LEAST_EFFECTIVE:
                    out[m, b] = math.nan
        if level == 0.0:
            continue
        _inverse_numbers(samples, bins, start, work, after, LATER * level)
        for m in range(len(out)):
            for b in range(out.shape[1]):
                if _RESTING[m] == n:
                    number = max(1.0 / max(inverse[0, b], inverse[1, b]), _LEAST_COUNTED)
                    squared = (number - 1.0) / (number - 3.0) * (batches - 3.0) / (batches - 1.0)
                    work.value[m, b] = math.sqrt(squared)


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
    """Fill rows `first` to `last` of `out` (w, M, b)."""
    degrees, halves = len(samples.signs), 2 * len(samples.signs)
    for row in range(first, last):
        n, found, value = pairs.wanted[row], work.found, work.value
        lit = _load(pairs, n, work)
        _sum_batches(samples, n, work)
        for k in range(halves):
            _half(samples, k, work)
            _measure(pairs, n, lit, work, k)
        _whole(work)
        _measure(pairs, n, lit, work, halves)
        start = _start(pairs, n, lit, work)
        doubtful = not lit and _measure_onsets(pairs, samples, work, halves + 3)
        out[row] = 0.0
        _judge_numbers(samples, pairs.bins, start, work, out[row])
        for end in range(2):
            _by_one_end(2.0 * end - 1.0, samples.difference[n], work)
            _measure(pairs, n, lit, work, halves + 1 + end)
        for m in range(out.shape[1]):
            for b in range(out.shape[2]):
                scale = 1.0 if _LEVELS[m] else found[m, b, halves]
                if m == _D50:  # alike over bands is the error of C50, 10 lg(D / (1 - D))
                    scale *= 1.0 - scale
                out[row, m, b] += _spread(found[m, b], halves) / scale if scale > 0.0 else math.nan
                value[m, b] *= scale
        _moderate(out[row], degrees)
        for m in range(out.shape[1]):
            for b in range(out.shape[2]):
                out[row, m, b] *= _STUDENT * value[m, b]
                apart = 0.5 * abs(found[m, b, halves + 2] - found[m, b, halves + 1])
                if apart > UNLIKELY * out[row, m, b]:
                    out[row, m, b] = apart
                if doubtful:
                    apart = 0.5 * (found[m, b, halves + 4] - found[m, b, halves + 3])
                    out[row, m, b] = math.hypot(out[row, m, b], apart)


@kernel
def _values(first: int, last: int, pairs: _Pairs, out: np.ndarray, work: _Work) -> None:
    """Fill rows `first` to `last` of `out` (w, M, b)."""
    for row in range(first, last):
        n = pairs.wanted[row]
        lit = _load(pairs, n, work)
        _whole(work)
        _measure(pairs, n, lit, work, 0)
        for m in range(out.shape[1]):
            for b in range(out.shape[2]):
                out[row, m, b] = work.found[m, b, 0]


@part
def _moderate(errors: np.ndarray, degrees: int) -> None:
    """Draw squares of errors (M, b) up towards their mean over bands."""
    for m in range(errors.shape[0]):
        mean, known = 0.0, 0
        for b in range(errors.shape[1]):
            if errors[m, b] >= 0.0:
                mean += errors[m, b] ** 2
                known += 1
        for b in range(errors.shape[1]):
            if errors[m, b] >= 0.0:
                own = errors[m, b] ** 2
                square = degrees * own + _PRIOR * max(mean / known, own)
                errors[m, b] = math.sqrt(square / (degrees + _PRIOR))


@part(forceinline=True)
def _bin(edges: np.ndarray, time: float) -> int:
    """Number of the bin that holds a time; the last one for later times."""
    return min(max(np.searchsorted(edges, time, "right") - 1, 0), len(edges) - 2)  # type: ignore[return-value]


@part
def _onset(bins: _Bins, work: _Work, of_most: float) -> int:
    """Number of the first bin with as much energy per time as `of_most` of the most (ISO 3382-1, A.3.4)."""
    rate, most = work.rate, 0.0
    rate[:] = 0.0
    for b in range(len(work.total)):
        for t in range(len(rate)):
            rate[t] += work.total[b, t]
    for t in range(len(rate)):
        rate[t] /= bins.width[t]
        most = max(most, rate[t])
    for t in range(len(rate)):
        if rate[t] > 0.0 and rate[t] >= of_most * most:
            return t
    return 0


def _make_bins(edges: np.ndarray) -> _Bins:
    width, times = np.diff(edges), edges[:-1]
    sums = np.zeros((3, len(edges)))
    sums[:, 1:] = np.cumsum([width, width * times, width * times**2], axis=1)
    return _Bins(edges, width, 0.5 * (edges[1:] + edges[:-1]), sums)


def _pairs(echoes: Echograms, same: bool) -> _Pairs:
    """All pairs, or with `same`, of points with themselves, each once."""
    sources, listeners = echoes.shape
    count = sources * listeners
    chosen = np.tri(sources, dtype=bool).T if same else np.ones((sources, listeners), bool)
    return _Pairs(
        _make_bins(echoes.time_edges),
        echoes.energy.reshape(count, *echoes.energy.shape[2:]),
        np.ascontiguousarray(echoes.direct_energy.reshape(count, -1), float),
        echoes.direct_length.ravel() / echoes.speed_of_sound,
        echoes.early_start,
        echoes.early.delay,
        echoes.early.energy,
        np.flatnonzero(chosen),
    )


def _of_all(found: np.ndarray, pairs: _Pairs, shape: tuple[int, int]) -> np.ndarray:
    """(S, L, …) of all pairs from that of those that were `wanted`."""
    out = np.empty((*shape, *found.shape[1:]))
    source, listener = np.divmod(pairs.wanted, shape[1])
    out[source, listener] = found
    if len(found) < shape[0] * shape[1]:
        out[listener, source] = found
    return out


def _make_work(bins: int, bands: int, columns: int, halves: int = 0, windows: int = 0) -> _Work:
    shape = len(MEASURES), bands
    ratio, scaled, exponent = np.empty((3, bins), np.float32)
    return _Work(
        *np.empty((3, bands, bins)),
        np.empty(bins),
        *np.empty((2, windows, bands)),
        np.empty((halves, windows, bands)),
        _Levels(np.empty(bins), ratio, ratio.view(np.int32), scaled, scaled.view(np.int32), exponent),
        np.empty((*shape, columns)),
        np.empty(shape),
        np.empty((2, bands)),
    )


def measure_values(echoes: Echograms, same: bool = False) -> np.ndarray:
    """(S, L, M, b) values of `MEASURES` from bins as they are stored, of every decay, however short. `same`: of
    points with themselves, whose energies are alike both ways."""
    pairs, bands = _pairs(echoes, same), echoes.energy.shape[4]
    out = np.empty((len(pairs.wanted), len(MEASURES), bands))
    bins = echoes.energy.shape[2]
    over_rows(_values, len(out), pairs, out, scratch=lambda: _make_work(bins, bands, 1))
    return _of_all(out, pairs, echoes.shape)


def measure_errors(
    echoes: Echograms,
    batches: np.ndarray,
    difference: np.ndarray,
    window: np.ndarray,
    same: bool = False,
) -> np.ndarray:
    """(S, L, M, b) standard errors of `MEASURES`, each in its own unit: s, dB, or 1 of D50.

    `batches` (S, L, K, windows, b) the energy of each batch of subpaths in windows, of which bin t belongs to
    `window[t]`, in order; K a power of two; `difference` (S, L, late bins, b) half of what estimates of the last
    bins by subpaths of either end differ by. NaN where a measure is not defined in a half-sample, and of the
    direct-to-reverberant ratio out of sight. `same`: of points with themselves, whose energies are alike both ways.
    """
    pairs, bands = _pairs(echoes, same), echoes.energy.shape[4]
    count, signs = echoes.shape[0] * echoes.shape[1], hadamard(batches.shape[2], float)[1:]
    windows = batches.shape[3]
    out = np.empty((len(pairs.wanted), len(MEASURES), bands))
    samples = _Samples(
        np.ascontiguousarray(batches).reshape(count, *batches.shape[2:]),  # one kernel is enough
        difference.reshape(count, *difference.shape[2:]),
        np.searchsorted(window, np.arange(windows + 1)),
        signs,
    )
    sizes = echoes.energy.shape[2], bands, 2 * len(signs) + 5, len(signs), windows
    over_rows(_errors, len(out), pairs, samples, out, scratch=lambda: _make_work(*sizes))
    out = _of_all(out, pairs, echoes.shape)
    out[echoes.walls > 0, _DRR] = np.nan
    return out


def widened(echoes: Echograms, values: np.ndarray, same: bool = False) -> Echograms:
    """Smoothed echograms, with errors not below what measures have moved by from `values` (S, L, M, b)."""
    assert echoes.measure_error is not None  # of all that is traced
    moved = np.abs(measure_values(echoes, same) - values).astype(np.float32)
    return replace(echoes, measure_error=np.maximum(echoes.measure_error, moved))
