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

_MOST_LOSS, _MOST_GAIN = 0.95, 0.5  # of r in `_gamma`, which ends at 1, and `_family`, which ends at 1/2
_MOST_STEPS = 2.0  # of an anchor: so far its third order goes


def change(counts: ReflectionCounts, x: np.ndarray) -> Change:
    """What x (M, b), ln ρ'/ρ of every group, does to the bins of one echogram."""
    arrays = counts.mean, counts.dispersion, counts.doubled, counts.correlation, counts.groups.anchor
    mean, variance, doubled, correlation, anchor, z, time = (
        np.ascontiguousarray(array, float) for array in (*arrays, np.expm1(x), counts.time)
    )
    out = Change(time, *np.empty((3, *time.shape)))
    close(Spread(mean, variance, doubled, correlation, anchor), z, out)
    return out


class Spread(NamedTuple):
    """`ReflectionCounts`' arrays of one echogram."""

    mean: np.ndarray
    dispersion: np.ndarray
    doubled: np.ndarray
    correlation: np.ndarray
    anchor: np.ndarray  # of the groups


@kernel
def close(spread: Spread, z: np.ndarray, out: Change) -> None:
    """Fill `nepers`, `error` and `variance` (W, b) of `out` from z (M, b).

    What absorbs more, z⁻, and what absorbs less, z⁺, have a closure each, of their means m = n̄·z and factorial
    variances f = zᵀ C z - n̄·z²; z⁻ᵀ C z⁺ between both; and of each material its `_third` order. Errors: theory,
    section 11. Variance: zᵀ C z.
    """
    mean, groups = spread.mean, spread.mean.shape[1]
    for w in range(len(mean)):
        for b in range(mean.shape[2]):
            down, up, of_down, of_up, cross, row = 0.0, 0.0, 0.0, 0.0, 0.0, 0
            third, roots, shapes, variance = 0.0, 0.0, 0.0, 0.0
            family_down, family_up = 0.0, 0.0
            for m in range(groups):
                n, of_m, ratio = mean[w, m, b], z[m, b], spread.dispersion[w, m, b]
                deviation = of_m * math.sqrt(n * ratio)
                own = n * of_m * of_m
                variance += deviation * deviation
                order, family, shape = _third(
                    n, ratio, spread.doubled[w, m, b], spread.anchor[m, b], of_m
                )
                third, shapes = third + order, shapes + shape * shape
                roots += math.copysign(abs(order) ** (1.0 / 3.0), order)
                if of_m < 0.0:
                    down, of_down, family_down = (
                        down + n * of_m,
                        of_down + own * (ratio - 1.0),
                        family_down - family,
                    )
                else:
                    up, of_up, family_up = up + n * of_m, of_up + own * (ratio - 1.0), family_up - family
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
            out.nepers[w, b] = _gamma(down, of_down) + _gamma(up, of_up) + cross + third
            apart = math.hypot(family_down + _family(down, of_down), family_up + _family(up, of_up))
            mixed = math.hypot(_order(down, up, of_down, of_up, cross), roots**3 - third)
            out.error[w, b] = math.hypot(math.hypot(apart, math.sqrt(shapes)), mixed)


@part(forceinline=True)
def _third(
    n: float, ratio: float, doubled: float, anchor: float, z: float
) -> tuple[float, float, float]:
    """Of one material, the third order that makes its closure what `doubled` tells of z = `anchor`; what `_family`
    would have of it, no more than at the anchor; and what it differs by from a fourth order that does."""
    if n <= 0.0 or anchor >= 0.0 or z == 0.0:
        return 0.0, 0.0, 0.0
    m, t = n * anchor, z / anchor
    known, limited = min(max(t, -1.0), 1.0) ** 3, min(max(t, -_MOST_STEPS), _MOST_STEPS) ** 3
    off = _gamma(m, m * anchor * (doubled - 1.0)) - _gamma(m, m * anchor * (ratio - 1.0))
    family = _family(m, m * anchor * (ratio - 1.0))
    return off * limited, family * known, off * t * t * t * (1.0 - t)


@part(forceinline=True)
def _gamma(m: float, f: float) -> float:
    """ln of the generating function of counts of mean m and factorial variance f, both with z: Poisson
    distributions with means of gamma distribution, -(m / r) ln(1 - r), r = f / m."""
    r = min(f / m, _MOST_LOSS if m < 0.0 else _MOST_GAIN) if m != 0.0 else 0.0
    return m if abs(r) < 1e-6 else -m * math.log1p(-r) / r


@part(forceinline=True)
def _family(m: float, f: float) -> float:
    """What `_gamma` differs by from means of inverse Gaussian distribution, (m / r) (1 - sqrt(1 - 2 r)).

    Counts that vary less than Poisson's have no such means, and the root ends where a half of them is lost. So for
    losses with r > 0 it is taken up to the fourth order, m (r² / 6 + 3 r³ / 8).
    """
    r = min(f / m, _MOST_GAIN) if m != 0.0 else 0.0
    if m < 0.0 and r > 0.0:
        return m * r * r * (1.0 / 6.0 + 0.375 * r)
    return 0.0 if abs(r) < 1e-6 else m * (1.0 - math.sqrt(1.0 - 2.0 * r)) / r - _gamma(m, f)


@part(forceinline=True)
def _order(down: float, up: float, of_down: float, of_up: float, cross: float) -> float:
    """Third orders of what absorbs more with what absorbs less, if both had one random mean in common: of means m =
    m⁻ + m⁺ and factorial variance f = θ m² the third order is θ² m³ / 3, of which θ² m⁻ m⁺ m is mixed, and θ m⁻ m⁺
    is `cross`. The two parts, of opposite signs, may be known badly, so that their amounts are added."""
    if down == 0.0 or up == 0.0:
        return 0.0
    return abs(cross) * (abs(of_down / down) + abs(of_up / up))
