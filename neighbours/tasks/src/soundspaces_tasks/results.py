"""What a task returns: rows of scores with intervals, and what a reader has to know to judge them.

Intervals are of a bootstrap that draws homes and seeds, each with replacement and independently (a crossed
bootstrap; Owen, Annals of Applied Statistics 2007: its variance is not below the true one). Its standard error,
multiplied by sqrt(H / (H - 1)) and by Student's quantile of H - 1 degrees of freedom for H homes, gives the ends,
since percentiles are too narrow where homes are few.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import t as student

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import Interval

_DRAWS = 2000
Finish = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Score:
    """A column: its name with unit, and whether higher values are better."""

    name: str
    higher: bool = False
    digits: int = 2


@dataclass(frozen=True)
class Row:
    """Of a method with networks or fits of so many training `homes` (0: of none), an interval per score; None: the
    method has no such score."""

    method: str
    homes: int
    scores: tuple[Interval | None, ...]


@dataclass(frozen=True)
class TaskResult:
    """`about`: task, data, loss, scores and baselines, in Markdown; `facts`: counts of this run."""

    title: str
    about: str
    scores: tuple[Score, ...]
    rows: tuple[Row, ...]
    facts: tuple[str, ...] = ()
    seconds: float = field(default=0.0, compare=False)


def root(values: np.ndarray) -> np.ndarray:
    """Square root of a mean square, 0 of one that is below 0 as the noise of labels was subtracted."""
    return np.asarray(np.sqrt(np.maximum(values, 0.0)))


def interval(
    values: np.ndarray,
    home: np.ndarray,
    weights: np.ndarray | None = None,
    finish: Finish = np.asarray,
    seed: int = 0,
) -> Interval:
    """`finish` of the weighted mean of (S, n) `values` of S seeds and n items, with its 95 % interval.

    `home` (n,): whose items they are. Items that are NaN in every seed are left out; a single home gives a NaN
    interval. Raises `ConfigError` for other values that are not finite, and if no item is left.
    """
    values = np.atleast_2d(np.asarray(values, float))
    kept = ~np.isnan(values).all(axis=0)
    share = np.ones(values.shape[1]) if weights is None else np.asarray(weights, float)
    kept &= share > 0.0
    if not kept.any():
        raise ConfigError("scores: no item has a label; choose more --pairs, or other homes")
    values, share = values[:, kept], share[kept]
    if not (np.isfinite(values).all() and np.isfinite(share).all()):
        raise ConfigError(f"scores: expected finite values, got {values[~np.isfinite(values)][:3]}")
    names, row = np.unique(home[kept], return_inverse=True)
    count = len(names)
    sums = np.stack([np.bincount(row, share * v, count) for v in values])  # (S, H)
    norms = np.bincount(row, share, count)
    mean = float(finish(np.asarray(sums.sum() / (len(values) * norms.sum()))))
    if count < 2:
        return Interval(mean, float("nan"), float("nan"))
    rng = np.random.default_rng(seed)
    homes = rng.multinomial(count, np.full(count, 1.0 / count), _DRAWS)
    seeds = rng.multinomial(len(values), np.full(len(values), 1.0 / len(values)), _DRAWS)
    drawn = np.einsum("ds,sh,dh->d", seeds, sums, homes) / (len(values) * (homes @ norms))
    error = float(np.std(finish(drawn), ddof=1)) * np.sqrt(count / (count - 1))
    reach = float(student.ppf(0.975, count - 1)) * error
    return Interval(mean, mean - reach, mean + reach, error)
