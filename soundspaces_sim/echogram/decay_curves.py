"""Curves over time, log-linear between knots, with given sums over windows of bins.

A curve g is exp of a piecewise linear function whose knots are the centres of windows, so that it is continuous.
The levels λ_w of the knots are those for which the sums of g times a base function b are the given ones,

    sum over t in w of b(t) g(t) = s_w    for all windows w,

found by fixed-point iteration, λ_w ← λ_w + `_STEP` ln(s_w / sum of b g), from λ_w = ln(s_w / sum of b).
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part

_ROUNDS = 6  # of the iteration
_STEP = 4.0 / 3.0  # of a round, times the error, whose derivatives have eigenvalues mostly from .4 to 1
_FARTHEST = 40.0  # Np, of a level from the first one: bounded where no continuous curve has the sums


class Knots(NamedTuple):
    """Room for the knots of a curve over at most M windows: one for each that has a sum, and the two ends."""

    time: np.ndarray  # (M + 2,) s
    level: np.ndarray  # (M + 2,) Np, λ
    initial: np.ndarray  # (M + 2,) Np, λ at first
    window: np.ndarray  # (M + 2,) number of its window


class CurveScratch(NamedTuple):
    """A curve over T bins, and what it is fitted with."""

    knots: Knots
    base: np.ndarray  # (T,) b
    curve: np.ndarray  # (T,) g


def make_curve_scratch(windows: int, bins: int) -> CurveScratch:
    """For curves over at most so many windows."""
    time, level, initial = np.empty((3, windows + 2))
    knots = Knots(time, level, initial, np.empty(windows + 2, np.int64))
    return CurveScratch(knots, np.empty(bins), np.empty(bins))


@part
def fit_curve(
    ends: np.ndarray, sums: np.ndarray, edges: np.ndarray, sloping: bool, scratch: CurveScratch
) -> None:
    """Fit `scratch.curve` to `sums` (M,) over windows of bins between `ends` (M + 1,), given `scratch.base`.

    `edges` (T + 1,) s of the bins. Windows without energy have no knot. `sloping`: beyond the first and last centre
    the curve goes on as its slopes there; else it is constant.
    """
    knots, count = scratch.knots, 0
    for w in range(len(ends) - 1):
        total = 0.0
        for t in range(ends[w], ends[w + 1]):
            total += scratch.base[t]
        if sums[w] > 0.0 and total > 0.0:
            if count == 0:
                knots.time[0] = edges[ends[w]]
            count += 1
            level = math.log(sums[w] / total)
            knots.time[count] = 0.5 * (edges[ends[w]] + edges[ends[w + 1]])
            knots.level[count], knots.initial[count] = level, level
            knots.time[count + 1] = edges[ends[w + 1]]
            knots.window[count] = w
    if count == 0:
        scratch.curve[ends[0] : ends[-1]] = 1.0
        return
    for turn in range(_ROUNDS + 1):
        for k in range(1, count + 1 if turn > 0 else 1):
            w, total = knots.window[k], 0.0
            for t in range(ends[w], ends[w + 1]):
                total += scratch.base[t] * scratch.curve[t]
            level, initial = knots.level[k] + _STEP * math.log(sums[w] / total), knots.initial[k]
            knots.level[k] = min(max(level, initial - _FARTHEST), initial + _FARTHEST)
        _extrapolate(knots, count + 1, sloping)
        _draw(knots, count + 2, edges, ends[0], ends[-1], scratch.curve)


@part
def _extrapolate(knots: Knots, last: int, sloping: bool) -> None:
    """Levels of the first knot and of knot `last`: as the slopes beside them if `sloping`, but never rising at
    last."""
    time, level = knots.time, knots.level
    level[0], level[last] = level[1], level[last - 1]
    if sloping and last > 2:
        rate = (level[2] - level[1]) / (time[2] - time[1])
        level[0] += rate * (time[0] - time[1])
        rate = (level[last - 1] - level[last - 2]) / (time[last - 1] - time[last - 2])
        level[last] += min(rate, 0.0) * (time[last] - time[last - 1])


@part
def _draw(knots: Knots, count: int, edges: np.ndarray, low: int, high: int, curve: np.ndarray) -> None:
    """Fill bins `low` to `high` of `curve`: log-linear between the first `count` knots, constant beyond them.

    Between knots, bins of one width have a constant ratio: one exponential serves them all.
    """
    k, value, ratio = 0, 1.0, 1.0
    for t in range(low, high):
        time, width = 0.5 * (edges[t] + edges[t + 1]), edges[t + 1] - edges[t]
        turns = t == low or abs(width - edges[t] + edges[t - 1]) > 1e-6 * width
        while k < count and time >= knots.time[k]:
            k += 1
            turns = True
        if turns:
            near, rate = max(k - 1, 0), 0.0
            if 0 < k < count:
                rate = (knots.level[k] - knots.level[near]) / (knots.time[k] - knots.time[near])
            value = math.exp(knots.level[near] + rate * (time - knots.time[near]))
            ratio = math.exp(rate * width)
        curve[t] = value
        value *= ratio
