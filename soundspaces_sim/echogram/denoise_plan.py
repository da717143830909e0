"""Which late bins `echogram.denoise` smooths together, and whose sums it keeps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part

_FROM_S = 0.05  # earlier bins stay as they are
_WINDOWS_S = (0.1, 0.2, 0.35)  # energies between these times stay what they were, …
_LATER_S = 0.15  # … and after them every so long
WIDEST_S = 0.08  # scale of the coarsest details but those against the decay


class DenoisePlan(NamedTuple):
    """Which bins are smoothed together: numbers of bins, counted from the first late one."""

    first: int  # of the late bins, among all
    stretches: np.ndarray  # (K + 1,) ends of stretches of equal bins
    levels: np.ndarray  # (K,) scales
    blurred: np.ndarray  # (K,) of them, those at which detectors blur
    windows: np.ndarray  # (M + 1,) ends of windows, of which those of stretches are some
    edges: np.ndarray  # (late bins + 1,) times, s


def first_late(time_edges: np.ndarray, connection_window: float) -> int:
    """Number of the first bin that may be smoothed; that of bins if there is none."""
    first = int(np.searchsorted(time_edges, max(_FROM_S, connection_window) - 1e-9))
    return min(first, len(time_edges) - 1)


def equal_bins(widths: np.ndarray) -> np.ndarray:
    """(K + 1,) ends of the K stretches of bins of one width."""
    changes = np.flatnonzero(np.abs(np.diff(widths)) > 1e-6 * widths[:-1]) + 1
    return np.unique(np.concatenate([[0], changes, [len(widths)]]))


def make_denoise_plan(time_edges: np.ndarray, connection_window: float, blur: float) -> DenoisePlan:
    """What to do with bins between `time_edges` (bins + 1,), s; `blur`: time of sound through a detector, s."""
    first = first_late(time_edges, connection_window)
    edges = time_edges[first:]
    widths = np.diff(edges)
    stretches = equal_bins(widths)
    own = widths[stretches[:-1]]
    most = np.minimum(WIDEST_S / own, 0.5 * np.diff(stretches))
    levels = np.floor(np.log2(np.maximum(most, 1.0)) + 1e-9)
    blurred = np.clip(np.ceil(np.log2(np.maximum(blur / own, 1.0)) - 1e-9), 0.0, levels)
    later = np.arange(_WINDOWS_S[-1] + _LATER_S, edges[-1] - 0.5 * _LATER_S, _LATER_S)
    cuts = np.searchsorted(edges, np.concatenate([_WINDOWS_S, later]) - 1e-9)
    windows = np.unique(np.concatenate([stretches, np.minimum(cuts, len(widths))]))
    return DenoisePlan(
        first, stretches, levels.astype(np.int64), blurred.astype(np.int64), windows, edges.copy()
    )


class PairWindows(NamedTuple):
    """Windows of a pair, M at most, and what is in them."""

    ends: np.ndarray  # (M + 1,) of windows whose energies stay
    wide: np.ndarray  # (M + 1,) of those among them to which curves are fitted
    energy: np.ndarray  # (M, b) J/m² between `ends` before a pair is smoothed
    sums: np.ndarray  # (M, 10 b) between `wide`: of all channels, and of D
    noise: np.ndarray  # (M, b) their variance


@part
def cut_windows(plan: DenoisePlan, low: int, split: int, windows: PairWindows) -> tuple[int, int]:
    """Windows of a pair from the late bin `low` on: (number of those whose energies stay, number of those to
    which curves are fitted).

    Sums over less than half of the coarsest scale are mostly noise, so such a window shares a knot with another.
    """
    ends, wide, count, fitted, k = windows.ends, windows.wide, 0, 0, 0
    ends[0], wide[0] = low, low
    for w in range(1, len(plan.windows)):
        for end in (min(split, plan.windows[w]), plan.windows[w]):
            if end <= ends[count]:
                continue
            count += 1
            ends[count] = end
            while plan.stretches[k + 1] < end:
                k += 1
            if 2 * (end - wide[fitted]) >= 2 ** plan.levels[k]:
                fitted += 1
            if fitted > 0:
                wide[fitted] = end
    if fitted == 0:
        fitted, wide[1] = 1, ends[count]
    if fitted == 1 and wide[1] > low + 1:  # a slope takes two
        fitted, wide[2], wide[1] = 2, wide[1], (low + wide[1]) // 2
    return count, fitted
