"""Windows of time, of several bins each, in which error bars and counts of reflections are kept."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class WindowLayout(NamedTuple):
    """Windows of `width` s up to `early` s, and then `late` of them up to the end."""

    early: float
    width: float
    late: int


# A line is fitted to the first 10 dB in a few of these: half-samples do not know noise within a window.
ERROR_BARS = WindowLayout(0.3, 0.025, 8)
COUNTS = WindowLayout(0.25, 0.01, 10)  # bins of 10 ms differ in what they have met


def time_windows(edges: np.ndarray, layout: WindowLayout) -> np.ndarray:
    """(bins,) window that a bin between `edges`, s, belongs to."""
    window = np.searchsorted(window_edges(edges, layout)[:-1], edges[:-1] + 1e-9, "right") - 1
    return np.unique(window, return_inverse=True)[1]  # none is empty


def window_edges(edges: np.ndarray, layout: WindowLayout) -> np.ndarray:
    """Where windows begin, and the last one ends, s; bins between `edges`, s, need not end there."""
    end = float(edges[-1])
    early = layout.width * np.arange(np.ceil(min(layout.early, end) / layout.width - 1e-6))
    if end <= layout.early:
        return np.append(early, end)
    return np.concatenate([early, np.linspace(layout.early, end, layout.late + 1)])
