"""How often sound has been reflected by each group of materials, and what it becomes with other absorption.

A path that group m reflects n_m times carries Π ρ_m^n_m of its energy, ρ = 1 - α - τ. With other absorption it
carries Π (1 + z_m)^n_m times as much, z_m = ρ'_m / ρ_m - 1, and a bin the mean of that: the generating function of
its counts, of which mean and covariance are known (docs/theory.md, section 11; `echogram.closure`). Windows W,
groups M, bands b.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from soundspaces_sim.echogram.time_windows import COUNTS, WindowLayout

MOST_DISPERSION = 40.0
HALF, TWICE = -0.5, 1.0  # z of `anchors`
MOST_RATIO = 0.95  # of r in `dispersion`, whose closure ends at 1


def row_count(groups: int) -> int:
    """Pairs of different groups: entries of the lower triangle of a matrix without its diagonal."""
    return groups * (groups - 1) // 2


@dataclass(frozen=True)
class MaterialGroups:
    """Materials whose reflections are counted, and how they were when they were."""

    names: tuple[str, ...]  # (M,)
    share: np.ndarray  # (M,) of all reflections of diffuse sound in the scene
    absorption: np.ndarray  # (M, b)
    transmission: np.ndarray  # (M, b)
    anchor: np.ndarray  # (M, b) z of `anchored`: `anchors`, in shards of version 7 others
    # In which reflections are counted; without counts, those of error bars.
    windows: WindowLayout = COUNTS


@dataclass(frozen=True)
class ReflectionCounts:
    """Counts of reflections, weighted by energy, of what the bins of echograms hold. Leading axes: those of pairs,
    none for one pair. `row_count(M)` = C."""

    groups: MaterialGroups
    time: np.ndarray  # (…, W, b) s, mean arrival within each window
    mean: np.ndarray  # (…, W, M, b)
    dispersion: np.ndarray  # (…, W, M, b) variances over means
    anchored: np.ndarray  # (…, W, M, b) the same from what the anchor of a group takes
    correlation: np.ndarray  # (…, W, C, b) of n_m and n_k, k < m

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


OF_PAIRS = ("time", "mean", "dispersion", "anchored", "correlation")


class Change(NamedTuple):
    """What other absorption does to the bins of one echogram: nepers of energy at (W, b) times, s, by how many they
    may be off, and the variance of what paths change by, relative to its mean's square."""

    time: np.ndarray  # (W, b)
    nepers: np.ndarray  # (W, b) ln E'/E
    error: np.ndarray  # (W, b) nepers
    variance: np.ndarray  # (W, b)

    def at(self, times: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n, b) nepers, errors and variances at (n,) s: between windows on a line, beyond them as at the next. A
        window of less `strength` (W, b) than a later one counts for less there (docs/theory.md, (T63))."""
        before, after, u = between_windows(self.time, times, strength)
        one, two, three = (
            (1.0 - u) * np.take_along_axis(of, before, 0) + u * np.take_along_axis(of, after, 0)
            for of in (self.nepers, self.error, self.variance)
        )
        return one, two, three


def between_windows(
    time: np.ndarray, times: np.ndarray, strength: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, b) window before (n,) s, window after, and share of the latter, as `Change.at` has them; `time`,
    `strength` (W, b)."""
    shape = len(times), time.shape[1]
    first, second, share = np.empty(shape, np.int64), np.empty(shape, np.int64), np.empty(shape)
    last = max(len(time) - 2, 0)
    for b, (t, s) in enumerate(zip(time.T, strength.T, strict=True)):
        before = np.clip(np.searchsorted(t, times) - 1, 0, last)
        after = np.minimum(before + 1, len(t) - 1)
        gap = t[after] - t[before]
        u = np.clip(
            np.where(gap > 0.0, (times - t[before]) / np.where(gap > 0.0, gap, 1.0), 0.0), 0.0, 1.0
        )
        one, two = (1.0 - u) * s[before], u * s[after]
        u = np.divide(two, one + two, out=u, where=one + two > 0.0)
        first[:, b], second[:, b], share[:, b] = before, after, u
    return first, second, share


def anchors(absorption: np.ndarray, transmission: np.ndarray) -> np.ndarray:
    """z = ρ'/ρ - 1 of the change for which a group's closure is made exact: its reflections keep half as much, or
    twice as much where it reflects at most half of what it does not transmit. So the anchor lies on the side of
    larger changes, and the energy with it can be told from as many paths as n̄ tells. Nothing is taken where
    nothing is reflected."""
    reflected = 1.0 - absorption - transmission
    hard = reflected > 0.5 * (1.0 - transmission)
    return np.where(reflected > 0.0, np.where(hard, HALF, TWICE), 0.0)


def dispersion(mean: np.ndarray, taken: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Variances over means of counts with these `mean`s (…, M, b), such that z (M, b) takes `taken` of the energy,
    less than nothing with z > 0, by the closure of `echogram.closure`: 1 + r / z where -ln(1 - r) / r = ln(1 -
    taken) / (z n̄)."""
    least = 1.0 - MOST_DISPERSION
    r = np.concatenate([np.geomspace(least, -1e-6, 600), [0.0], np.geomspace(1e-6, MOST_RATIO, 600)])
    small = np.abs(r) < 1e-9
    course = np.where(small, 1.0, -np.log1p(-r) / np.where(small, 1.0, r))
    left, known = np.log(np.maximum(1.0 - taken, 1e-30)), (mean > 0.0) & (z != 0.0)
    wanted = np.divide(left, mean * z, out=np.ones_like(mean), where=known)
    ratio = np.divide(np.interp(wanted, course, r), z, out=np.zeros_like(mean), where=known)
    return np.clip(1.0 + ratio, 0.0, MOST_DISPERSION)
