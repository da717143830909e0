"""Bins of time of echograms, and the windows of time in which error bars are kept."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.core.config import SimulationConfig

_EARLY_WINDOWS_S = 0.1  # up to which windows of error bars are …
_WINDOW_S = 1.0 / 60.0  # … so wide, …
_LATE_WINDOWS = 12  # … and then so many


def time_bins(config: SimulationConfig, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Edges (bins + 1,) that cover `duration`, and the bin of each step of the first width."""
    first = config.time_grid[0][1]
    edges = [0.0]
    for k, (_, width) in enumerate(config.time_grid):
        last = config.time_grid[k + 1][0] if k + 1 < len(config.time_grid) else np.inf
        while edges[-1] < min(last, duration) - 1e-9:
            edges.append(round((edges[-1] + width) / first) * first)
    array = np.array(edges)
    steps = np.rint(np.diff(array) / first).astype(np.int64)
    return array, np.repeat(np.arange(len(steps)), steps)


def error_windows(edges: np.ndarray) -> np.ndarray:
    """(bins,) window of error bars that a bin between `edges` belongs to."""
    early = np.arange(0.0, min(_EARLY_WINDOWS_S, edges[-1]) + 1e-9, _WINDOW_S)
    late = np.linspace(_EARLY_WINDOWS_S, max(edges[-1], _EARLY_WINDOWS_S), _LATE_WINDOWS + 1)
    starts = np.unique(np.concatenate([early, late]))
    window = np.searchsorted(starts, edges[:-1] + 1e-9, "right") - 1
    return np.unique(window, return_inverse=True)[1]  # none is empty
