"""How often sound has been reflected by each group of materials, and what it becomes with other absorption.

A path that group m reflects n_m times carries Π ρ_m^n_m of its energy, ρ = 1 - α - τ. With other absorption it
carries Π (1 + z_m)^n_m times as much, z_m = ρ'_m / ρ_m - 1, and a bin the mean of that: the generating function of
its counts, of which mean and covariance are known (docs/theory.md, section 11). Windows W, groups M, bands b.

Counts are whole numbers: of a carpet that some paths meet once and others never. So the closure is that of Poisson
distributions whose mean is itself random, in cumulants of z, not of ln(1 + z).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part

MOST_DISPERSION = 40.0
_MOST_LOSS, _MOST_GAIN = 0.95, 0.5  # of r in `_closures`, which end at 1 and 1/2
_OPEN = (
    0.1  # share of what counts differ by from Poisson ones that may be off: their shape and correlations
)


def row_count(groups: int) -> int:
    """Entries of the lower triangle of a covariance."""
    return groups * (groups + 1) // 2


@dataclass(frozen=True)
class MaterialGroups:
    """Materials whose reflections are counted, and how they were when they were."""

    names: tuple[str, ...]  # (M,)
    share: np.ndarray  # (M,) of all reflections of diffuse sound in the scene
    absorption: np.ndarray  # (M, b)
    transmission: np.ndarray  # (M, b)


@dataclass(frozen=True)
class ReflectionCounts:
    """Counts of reflections, weighted by energy, of what the bins of echograms hold. Leading axes: those of pairs,
    none for one pair. `row_count(M)` = C."""

    groups: MaterialGroups
    correlation: np.ndarray  # (C, b) lower triangle of the correlations of n_m and n_k, of the scene
    time: np.ndarray  # (…, W, b) s, mean arrival within each window
    mean: np.ndarray  # (…, W, M, b)
    dispersion: np.ndarray  # (…, W, M, b) variances over means

    def _with(self, arrays: dict[str, np.ndarray]) -> ReflectionCounts:
        return replace(self, **arrays)  # type: ignore[arg-type]

    def pairs(self, *index: object) -> ReflectionCounts:
        """Those of some pairs: every array of pairs indexed alike."""
        return self._with({name: getattr(self, name)[index] for name in OF_PAIRS})

    def of_shape(self, shape: tuple[int, ...]) -> ReflectionCounts:
        """Room for those of more pairs."""
        empty = {
            name: np.zeros((*shape, *getattr(self, name).shape[2:]), np.float32) for name in OF_PAIRS
        }
        return self._with(empty)

    def put(self, index: tuple[slice, slice], part: ReflectionCounts) -> None:
        """Copy those of some pairs, in place."""
        for name in OF_PAIRS:
            getattr(self, name)[index] = getattr(part, name)

    def reversed(self) -> ReflectionCounts:
        """Those of a table of pairs from its listeners to its sources: the same."""
        turned = {name: np.ascontiguousarray(getattr(self, name).swapaxes(0, 1)) for name in OF_PAIRS}
        return self._with(turned)


OF_PAIRS = ("time", "mean", "dispersion")


@dataclass(frozen=True)
class Change:
    """What other absorption does to the bins of one echogram: nepers of energy at (W, b) times, s, and by how many
    they may be off."""

    time: np.ndarray  # (W, b)
    nepers: np.ndarray  # (W, b) ln E'/E
    error: np.ndarray  # (W, b) nepers

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, b) nepers and errors at (n,) s: between windows on a line, beyond them as at the next."""
        columns = [
            [np.interp(times, time, values) for time, values in zip(self.time.T, of.T, strict=True)]
            for of in (self.nepers, self.error)
        ]
        return np.stack(columns[0], axis=1), np.stack(columns[1], axis=1)


def dispersion(mean: np.ndarray, halved: np.ndarray) -> np.ndarray:
    """Variances over means of counts with these `mean`s, such that halving every reflection takes `halved` of the
    energy, by the closure of `_closures`: 1 - 2 r where -ln(1 - r) / r = -2 ln(1 - halved) / n̄."""
    r = np.concatenate([-np.geomspace(0.5 * MOST_DISPERSION, 1e-3, 400), np.linspace(0.0, 0.5, 101)])
    small = np.abs(r) < 1e-9
    course = np.where(small, 1.0, -np.log1p(-r) / np.where(small, 1.0, r))
    left = np.maximum(1.0 - halved, 1e-30)
    wanted = np.divide(-2.0 * np.log(left), mean, out=np.ones_like(mean), where=mean > 0.0)
    return 1.0 - 2.0 * np.interp(wanted, course, r)


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
