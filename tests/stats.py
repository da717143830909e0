"""Statistics for tests: z-scores from independent repetitions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import norm


def z_scores(samples: np.ndarray, expected: ArrayLike) -> np.ndarray:
    """z of the mean of independent repetitions (first axis) against an exact expectation."""
    samples = np.asarray(samples, float)
    error = samples.std(axis=0, ddof=1) / np.sqrt(len(samples))
    off = np.asarray(samples.mean(axis=0) - expected)
    exact = np.where(np.abs(off) <= 1e-9 * np.abs(expected), 0.0, np.inf)  # of what no chance decides
    return np.asarray(np.divide(off, error, out=exact, where=error > 1e-12 * np.abs(expected)))


def limit(family: int, single: float = 4.0) -> float:
    """|z| that a family of tests stays below as often as one stays below `single` (Sidak)."""
    p = 1.0 - (1.0 - 2.0 * norm.sf(single)) ** (1.0 / family)
    return float(norm.isf(p / 2.0))


def assert_mean(
    samples: np.ndarray,
    expected: ArrayLike,
    what: str,
    relative: float = 0.02,
    scale: ArrayLike | None = None,
) -> None:
    """Every mean agrees with its expectation, and the comparison is sharp to `relative` of it (of `scale`).

    The second half keeps the test honest: a noisy estimate agrees with anything.
    """
    samples = np.atleast_2d(np.asarray(samples, float).T).T
    expected = np.asarray(expected, float)
    scale = np.abs(expected if scale is None else np.asarray(scale, float))
    z = z_scores(samples, expected)
    error = samples.std(axis=0, ddof=1) / np.sqrt(len(samples)) / scale
    assert np.all(error < relative), f"{what}: standard error {error} is too large to tell anything"
    bound = limit(z.size)
    off = (samples.mean(axis=0) - expected) / scale
    assert np.all(np.abs(z) < bound), f"{what}: z = {z} (limit {bound:.2f}), off by {off}"


def repeat(run: Callable[[int], np.ndarray], seeds: int, first: int = 0) -> np.ndarray:
    """Stack `run(seed)` over independent seeds."""
    return np.stack([np.asarray(run(seed), float) for seed in range(first, first + seeds)])
