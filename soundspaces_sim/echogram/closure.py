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
from soundspaces_sim.echogram.reflection_counts import Change, ReflectionCounts

_MOST_LOSS, _MOST_GAIN = (
    0.95,
    0.5,
)  # of r in `_gamma`, which ends at 1, and `_gaussian`, which ends at 1/2


def change(counts: ReflectionCounts, x: np.ndarray) -> Change:
    """What x (M, b), ln ρ'/ρ of every group, does to the bins of one echogram."""
    arrays = counts.mean, counts.dispersion, counts.halved, counts.correlation
    mean, variance, halved, correlation, z, time = (
        np.ascontiguousarray(array, float) for array in (*arrays, np.expm1(x), counts.time)
    )
    out = Change(time, *np.empty((3, *time.shape)))
    close(Spread(mean, variance, halved, correlation), z, out)
    return out


class Spread(NamedTuple):
    """`ReflectionCounts`' arrays of one echogram."""

    mean: np.ndarray
    dispersion: np.ndarray
    halved: np.ndarray
    correlation: np.ndarray


@kernel
def close(spread: Spread, z: np.ndarray, out: Change) -> None:
    """Fill `nepers`, `error` and `variance` (W, b) of `out` from z (M, b).

    What absorbs more, z⁻, and what absorbs less, z⁺, have a closure each, of their means m = n̄·z and factorial
    variances f = zᵀ C z - n̄·z²; and z⁻ᵀ C z⁺ between both. Errors: theory, section 11. Variance: zᵀ C z.
    """
    mean, groups = spread.mean, spread.mean.shape[1]
    for w in range(len(mean)):
        for b in range(mean.shape[2]):
            down, up, of_down, of_up, cross, row = 0.0, 0.0, 0.0, 0.0, 0.0, 0
            shape_down, shape_up = 0.0, 0.0  # what the closures' f are off by
            variance = 0.0
            for m in range(groups):
                n, of_m, ratio = mean[w, m, b], z[m, b], spread.dispersion[w, m, b]
                deviation = of_m * math.sqrt(n * ratio)
                own = n * of_m * of_m
                variance += deviation * deviation
                shape = own * (spread.halved[w, m, b] - ratio) * 2.0 * abs(of_m)
                if of_m < 0.0:
                    down, of_down, shape_down = (
                        down + n * of_m,
                        of_down + own * (ratio - 1.0),
                        shape_down + shape,
                    )
                else:
                    up, of_up, shape_up = up + n * of_m, of_up + own * (ratio - 1.0), shape_up + shape
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
            out.nepers[w, b] = _gamma(down, of_down) + _gamma(up, of_up) + cross
            apart = math.hypot(_family(down, of_down), _family(up, of_up))
            shapes = 0.5 * math.hypot(shape_down, shape_up)
            out.error[w, b] = math.hypot(
                apart, math.hypot(shapes, _order(down, up, of_down, of_up, cross))
            )


@part(forceinline=True)
def _gamma(m: float, f: float) -> float:
    """ln of the generating function of counts of mean m and factorial variance f, both with z: Poisson
    distributions with means of gamma distribution, -(m / r) ln(1 - r), r = f / m."""
    r = min(f / m, _MOST_LOSS if m < 0.0 else _MOST_GAIN) if m != 0.0 else 0.0
    return m if abs(r) < 1e-6 else -m * math.log1p(-r) / r


@part(forceinline=True)
def _family(m: float, f: float) -> float:
    """What `_gamma` differs by from means of inverse Gaussian distribution, (m / r) (1 - sqrt(1 - 2 r))."""
    r = min(f / m, _MOST_GAIN) if m != 0.0 else 0.0
    return 0.0 if abs(r) < 1e-6 else m * (1.0 - math.sqrt(1.0 - 2.0 * r)) / r - _gamma(m, f)


@part(forceinline=True)
def _order(down: float, up: float, of_down: float, of_up: float, cross: float) -> float:
    """What closures for more and for less absorption differ by from one for both, of all counts' mean and factorial
    variance; that of second order where the mean is too small for it."""
    if down == 0.0 or up == 0.0:
        return 0.0
    m, f = down + up, of_down + of_up + 2.0 * cross
    together = _gamma(m, f) if abs(f) < _MOST_GAIN * abs(m) else m + 0.5 * f
    return _gamma(down, of_down) + _gamma(up, of_up) + cross - together
