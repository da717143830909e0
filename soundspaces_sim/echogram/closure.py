"""Energy with other absorption from counts of reflections: ln of the counts' generating function.

Counts are whole numbers: of a carpet that some paths meet once and others never. So the closure is that of Poisson
distributions whose mean is itself random, in cumulants of z, not of ln(1 + z) (docs/theory.md, section 11).
Windows W, groups M, bands b, as in `echogram.reflection_counts`; apart from it, as reading needs no Numba.
"""

from __future__ import annotations

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.echogram.reflection_counts import Change, ReflectionCounts

_MOST_LOSS, _MOST_GAIN = 0.95, 0.5  # of r in `_closures`, which end at 1 and 1/2
_OPEN = (
    0.1  # share of what counts differ by from Poisson ones that may be off: their shape and correlations
)


def change(counts: ReflectionCounts, x: np.ndarray) -> Change:
    """What x (M, b), ln ρ'/ρ of every group, does to the bins of one echogram."""
    time, mean, variance, correlation, z = (
        np.ascontiguousarray(array, float)
        for array in (counts.time, counts.mean, counts.dispersion, counts.correlation, np.expm1(x))
    )
    out = Change(time, *np.empty((2, *time.shape)))
    close(mean, variance, correlation, z, out.nepers, out.error)
    return out


@kernel
def close(
    mean: np.ndarray,
    dispersion: np.ndarray,
    correlation: np.ndarray,
    z: np.ndarray,
    nepers: np.ndarray,
    error: np.ndarray,
) -> None:
    """Fill `nepers` and `error` (W, b) from `ReflectionCounts`' arrays and z (M, b).

    What absorbs more, z⁻, and what absorbs less, z⁺, have a closure each, of their means m = n̄·z and factorial
    variances f = zᵀ C z - n̄·z²; and z⁻ᵀ C z⁺ between both.
    """
    for w in range(mean.shape[0]):
        for b in range(mean.shape[2]):
            down, up, poisson_down, poisson_up = 0.0, 0.0, 0.0, 0.0
            of_down, of_up, cross, row = 0.0, 0.0, 0.0, 0
            for m in range(mean.shape[1]):
                n, of_m = mean[w, m, b], z[m, b]
                if of_m < 0.0:
                    down, poisson_down = down + n * of_m, poisson_down + n * of_m * of_m
                else:
                    up, poisson_up = up + n * of_m, poisson_up + n * of_m * of_m
                deviation = of_m * math.sqrt(n * dispersion[w, m, b])
                for k in range(m + 1):
                    other = z[k, b] * math.sqrt(mean[w, k, b] * dispersion[w, k, b])
                    both = correlation[row + k, b] * deviation * other
                    if (of_m < 0.0) != (z[k, b] < 0.0):
                        cross += both
                    elif of_m < 0.0:
                        of_down += both if k == m else 2.0 * both
                    else:
                        of_up += both if k == m else 2.0 * both
                row += m + 1
            of_down, of_up = max(of_down, 0.0), max(of_up, 0.0)
            most = math.sqrt(of_down * of_up)
            low, low_off = _closures(down, of_down - poisson_down)
            high, high_off = _closures(up, of_up - poisson_up)
            nepers[w, b] = low + high + min(max(cross, -most), most)
            error[w, b] = math.hypot(low_off, high_off)


@part(forceinline=True)
def _closures(m: float, f: float) -> tuple[float, float]:
    """ln of the generating function of counts of mean m and factorial variance f, both with z, and what it may be
    off by.

    Poisson distributions with means of gamma distribution: -(m / r) ln(1 - r), r = f / m. It is off by as much as
    those with means of inverse Gaussian distribution, (m / r) (1 - sqrt(1 - 2 r)), differ from it, and a share of
    what it differs by from m.
    """
    r = min(f / m, _MOST_LOSS if m < 0.0 else _MOST_GAIN) if m != 0.0 else 0.0
    if abs(r) < 1e-6:
        return m, 0.0
    gamma = -m * math.log1p(-r) / r
    s = min(r, _MOST_GAIN)
    gaussian = m * (1.0 - math.sqrt(1.0 - 2.0 * s)) / s
    return gamma, math.hypot(gaussian - gamma, _OPEN * (gamma - m))
