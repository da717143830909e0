"""Energy with other absorption from counts of reflections: ln of the counts' generating function.

Counts are whole numbers: of a carpet that some paths meet once and others never. So the closure is that of Poisson
distributions whose mean is itself random, in cumulants of z, not of ln(1 + z) (docs/theory.md, section 11).
Windows W, groups M, bands b, as in `echogram.reflection_counts`; apart from it, as reading needs no Numba.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.echogram.reflection_counts import MOST_RATIO, Change, ReflectionCounts

MOST_GAIN = 0.5  # of r in `_gamma` of what absorbs less


def change(counts: ReflectionCounts, x: np.ndarray) -> Change:
    """What x (M, b), ln ρ'/ρ of every group, does to the bins of one echogram."""
    arrays = counts.mean, counts.dispersion, counts.anchored, counts.correlation, counts.groups.anchor
    mean, variance, anchored, correlation, anchor, z, time = (
        np.ascontiguousarray(array, float) for array in (*arrays, np.expm1(x), counts.time)
    )
    out = Change(time, *np.empty((3, *time.shape)))
    close(Spread(mean, variance, anchored, correlation, anchor), z, out)
    return out


class Spread(NamedTuple):
    """`ReflectionCounts`' arrays of one echogram."""

    mean: np.ndarray
    dispersion: np.ndarray
    anchored: np.ndarray
    correlation: np.ndarray
    anchor: np.ndarray  # of the groups


@kernel
def close(spread: Spread, z: np.ndarray, out: Change) -> None:
    """Fill `nepers`, `error` and `variance` (W, b) of `out` from z (M, b).

    What absorbs more, z⁻, and what absorbs less, z⁺, have a closure each, of their means m = n̄·z and factorial
    variances f = zᵀ C z - n̄·z²; z⁻ᵀ C z⁺ between both, which either closure amplifies; and of each material its
    `_third` order. Errors: theory, section 11. Variance: zᵀ C z.
    """
    mean, groups = spread.mean, spread.mean.shape[1]
    for w in range(len(mean)):
        for b in range(mean.shape[2]):
            down, up, of_down, of_up, cross, row = 0.0, 0.0, 0.0, 0.0, 0.0, 0
            third, roots, shapes, variance = 0.0, 0.0, 0.0, 0.0
            known_down, known_up = 0.0, 0.0
            for m in range(groups):
                n, of_m, ratio = mean[w, m, b], z[m, b], spread.dispersion[w, m, b]
                deviation = of_m * math.sqrt(n * ratio)
                own = n * of_m * of_m
                variance += deviation * deviation
                order, known, shape = _third(
                    n, ratio, spread.anchored[w, m, b], spread.anchor[m, b], of_m
                )
                third, shapes = third + order, shapes + shape * shape
                roots += math.copysign(abs(order) ** (1.0 / 3.0), order)
                if of_m < 0.0:
                    down, known_down = down + n * of_m, known_down + known
                    of_down += own * (ratio - 1.0)
                else:
                    up, known_up = up + n * of_m, known_up + known
                    of_up += own * (ratio - 1.0)
                for k in range(m):
                    other = z[k, b] * math.sqrt(mean[w, k, b] * spread.dispersion[w, k, b])
                    both = spread.correlation[w, row + k, b] * deviation * other
                    variance += 2.0 * both
                    if (of_m < 0.0) != (z[k, b] < 0.0):
                        cross += both
                    elif of_m < 0.0:
                        of_down += 2.0 * both
                    else:
                        of_up += 2.0 * both
                row += m
            out.variance[w, b] = max(variance, 0.0)
            amplified, unknown = _coupled(_ratio(down, of_down), _ratio(up, of_up))
            out.nepers[w, b] = _gamma(down, of_down) + _gamma(up, of_up) + cross * amplified + third
            apart = math.hypot(_beyond(down, of_down) - known_down, _beyond(up, of_up) - known_up)
            mixed = math.hypot(cross * unknown, roots**3 - third)
            out.error[w, b] = math.hypot(math.hypot(apart, math.sqrt(shapes)), mixed)


@part(forceinline=True)
def _third(
    n: float, ratio: float, anchored: float, anchor: float, z: float
) -> tuple[float, float, float]:
    """Of one material, the third order that makes its closure what `anchored` tells of z = `anchor`; what that
    tells of `_beyond`, no more than at the anchor; and what it differs by from the next order that does.

    Beyond the anchor it grows by the second order only, as closures of losses do. On the other side of 0, of which
    the anchor does not tell, it is left out, and may be missing.
    """
    t = z / anchor if anchor != 0.0 else 0.0
    if n <= 0.0 or t == 0.0:
        return 0.0, 0.0, 0.0
    m, f = n * anchor, n * anchor * anchor * (ratio - 1.0)
    off = _generating(m, (anchored - 1.0) * anchor) - _gamma(m, f)
    inside = min(abs(t), 1.0) ** 3
    order = off * inside * max(abs(t), 1.0) ** 2
    return (0.0, 0.0, order) if t < 0.0 else (order, _beyond(m, f) * inside, order * (1.0 - t))


@part(forceinline=True)
def _ratio(m: float, f: float) -> float:
    """r = f / m within the limits of `_gamma`."""
    return min(f / m, MOST_RATIO if m < 0.0 else MOST_GAIN) if m != 0.0 else 0.0


@part(forceinline=True)
def _gamma(m: float, f: float) -> float:
    """ln of the generating function of counts of mean m and factorial variance f, both with z: Poisson
    distributions with means of gamma distribution, -(m / r) ln(1 - r), r = f / m."""
    return _generating(m, _ratio(m, f))


@part(forceinline=True)
def _generating(m: float, r: float) -> float:
    """-(m / r) ln(1 - r) for r up to `MOST_RATIO`."""
    r = min(r, MOST_RATIO)
    return m if abs(r) < 1e-6 else -m * math.log1p(-r) / r


@part(forceinline=True)
def _beyond(m: float, f: float) -> float:
    """What `_gamma` has beyond the second order, in which alone it is known: less m + f / 2."""
    r = _ratio(m, f)
    return _generating(m, r) - m - 0.5 * m * r


@part(forceinline=True)
def _coupled(down: float, up: float) -> tuple[float, float]:
    """By what the covariance of two sums of counts with `_ratio`s r of their own is multiplied, and how much of it
    is not known.

    Where one sum goes with the other on a line, a gamma distribution of the other amplifies it by 1 / (1 - r).
    Counts need not go on a line, so that the lowest order, r, of either may be off by as much as it is.
    """
    one, two = 1.0 / (1.0 - down), 1.0 / (1.0 - up)
    return one * two, abs(down) * two + abs(up) * one
