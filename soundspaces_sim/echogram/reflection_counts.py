"""How often sound has been reflected by each group of materials, and what it becomes with other absorption.

A path that group m reflects n_m times carries Π ρ_m^n_m of its energy, ρ = 1 - α - τ. With other absorption it
carries exp(n·x) times as much, x_m = ln(ρ'_m / ρ_m), and a bin ⟨exp(n·x)⟩: the moment generating function of its
counts, of which mean and covariance are known (docs/theory.md, section 11). Windows of time W, groups M, bands b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
    spread: np.ndarray  # (C, b) lower triangle of cov(n_m, n_k) / sqrt(n̄_m n̄_k), of the scene
    time: np.ndarray  # (…, W, b) s, mean arrival within each window
    mean: np.ndarray  # (…, W, M, b)

    def _with(self, arrays: dict[str, np.ndarray]) -> ReflectionCounts:
        return ReflectionCounts(self.groups, self.spread, arrays["time"], arrays["mean"])

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


OF_PAIRS = ("time", "mean")


@dataclass(frozen=True)
class Change:
    """What other absorption does to the bins of one echogram: nepers of energy at (W, b) times, s, and the size of
    the third-order term, by which they may be off."""

    time: np.ndarray  # (W, b)
    nepers: np.ndarray  # (W, b) ln E'/E
    third: np.ndarray  # (W, b) nepers

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, b) nepers and third-order terms at (n,) s: between windows on a line, beyond them as at the next."""
        columns = [
            [np.interp(times, time, values) for time, values in zip(self.time.T, of.T, strict=True)]
            for of in (self.nepers, self.third)
        ]
        return np.stack(columns[0], axis=1), np.stack(columns[1], axis=1)


def change(counts: ReflectionCounts, x: np.ndarray) -> Change:
    """What x (M, b), ln ρ'/ρ of every group, does to the bins of one echogram.

    Absorbing parts x⁻ as a gamma-distributed loss, K = -(m²/s²) ln(1 - s²/m) with m = n̄·x⁻ < 0 and s² = x⁻ᵀ C x⁻;
    of the others two cumulants: n̄·x⁺ + x⁺ᵀ C x⁺ / 2 + x⁻ᵀ C x⁺.
    """
    time, mean = np.asarray(counts.time, float), np.asarray(counts.mean, float)
    less, more = np.minimum(x, 0.0), np.maximum(x, 0.0)
    m = np.einsum("wmb,mb->wb", mean, less)
    up = np.einsum("wmb,mb->wb", mean, more)
    root = np.sqrt(mean)
    forms = _forms(counts.spread)
    loss = np.maximum(_quadratic(forms, root * less, root * less), 0.0)
    gain = np.maximum(_quadratic(forms, root * more, root * more), 0.0)
    most = np.sqrt(loss * gain)
    cross = np.clip(_quadratic(forms, root * less, root * more), -most, most)
    ratio = np.divide(loss, -m, out=np.zeros_like(m), where=m < 0.0)
    small = ratio < 1e-9
    gamma = np.where(small, m, m * np.log1p(ratio) / np.where(small, 1.0, ratio))
    total = loss + gain + 2.0 * cross
    third = np.divide(total**2, 3.0 * (up - m), out=np.zeros_like(m), where=up - m > 0.0)
    return Change(time, gamma + up + 0.5 * gain + cross, third)


def _forms(spread: np.ndarray) -> np.ndarray:
    """(b, M, M) from `ReflectionCounts.spread` (C, b); no variance is negative."""
    groups = int(np.sqrt(2 * len(spread)))
    row, column = np.tril_indices(groups)
    out = np.empty((spread.shape[1], groups, groups))
    out[:, row, column] = out[:, column, row] = spread.T
    each = np.arange(groups)
    out[:, each, each] = np.maximum(out[:, each, each], 0.0)
    return out


def _quadratic(forms: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(W, b): xᵀ C y of every window and band; x, y (W, M, b)."""
    return np.einsum("wbm,wbm->wb", x.swapaxes(1, 2), np.einsum("bmk,wkb->wbm", forms, y))
