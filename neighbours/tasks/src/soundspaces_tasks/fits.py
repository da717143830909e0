"""Fits that need no PyTorch: weighted means and ridge regressions of several outputs."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from soundspaces_sim.parts import install_hint

PENALTY = 1.0  # of ridge regressions, in units of one example


def torch_missing() -> str | None:
    """None if PyTorch is there, else what a report says of networks that were not trained."""
    if find_spec("torch") is not None:
        return None
    return f"Networks were not trained: PyTorch is not installed ({install_hint('torch')})."


def weighted_mean(y: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(k,) of (n, k) values; those of weight 0 may be NaN."""
    return np.asarray((np.nan_to_num(y) * weights).sum(axis=0) / weights.sum(axis=0))


def ridge(x: np.ndarray, y: np.ndarray, weights: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """A function from features (n, f) to outputs (n, k), fitted to (n, k) `y` of `weights` by least squares with a
    penalty on standardised features; the mean is free."""
    centre, scale = x.mean(axis=0), x.std(axis=0) + 1e-9
    columns = _with_one((x - centre) / scale)
    penalty = PENALTY * np.eye(columns.shape[1])
    penalty[-1, -1] = 0.0
    solved = []
    for value, weight in zip(np.nan_to_num(y).T, weights.T, strict=True):
        share = weight / weight.mean()
        normal = (columns * share[:, None]).T @ columns + penalty
        solved.append(np.linalg.solve(normal, (columns * share[:, None]).T @ value))
    slopes = np.stack(solved, axis=1)
    return lambda to: np.asarray(_with_one((to - centre) / scale) @ slopes)


def _with_one(x: np.ndarray) -> np.ndarray:
    return np.concatenate([x, np.ones((len(x), 1))], axis=1)
