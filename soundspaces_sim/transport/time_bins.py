"""Bins of time of echograms."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.core.config import SimulationConfig


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
