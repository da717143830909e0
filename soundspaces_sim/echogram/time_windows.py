"""Windows of time, of several bins each, in which error bars and counts of reflections are kept."""

from __future__ import annotations

import numpy as np

_EARLY_WINDOWS_S = 0.1  # up to which windows are …
_WINDOW_S = 1.0 / 60.0  # … so wide, …
_LATE_WINDOWS = 12  # … and then so many


def time_windows(edges: np.ndarray) -> np.ndarray:
    """(bins,) window that a bin between `edges` belongs to."""
    early = np.arange(0.0, min(_EARLY_WINDOWS_S, edges[-1]) + 1e-9, _WINDOW_S)
    late = np.linspace(_EARLY_WINDOWS_S, max(edges[-1], _EARLY_WINDOWS_S), _LATE_WINDOWS + 1)
    starts = np.unique(np.concatenate([early, late]))
    window = np.searchsorted(starts, edges[:-1] + 1e-9, "right") - 1
    return np.unique(window, return_inverse=True)[1]  # none is empty
