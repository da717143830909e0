"""Rises that few lucky subpaths make in a decay are spread over the time in which they might have come.

A window's energy E_w has the variance N_w, the sum of D² (`denoise`) over its bins. Late sound decays, unless there
is an echo that many subpaths tell of. So a group G of windows is pooled with the one before, and with what lies
between, while the curve that has the sums of groups (`decay_curves`) is higher at its centre than at that of the
group before, and

    N_G > _KNOWN² E_G²,        sums over the windows of G,

as isotonic regression does (pool adjacent violators, Barlow et al. 1972). A group's energy, moments and noise are
then spread over its windows as that curve is. Groups lie beyond early sound: sums of early and of late sound stay,
so neither has a bias. A decay that is known stays, whatever its slopes.

Source: R. E. Barlow, D. J. Bartholomew, J. M. Bremner and H. D. Brunk (1972), Statistical inference under order
restrictions.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.echogram.decay_curves import CurveScratch, fit_curve
from soundspaces_sim.echogram.denoise_plan import PairWindows

_KNOWN = 0.25  # relative standard error: 1 dB, the least difference of level that is heard


class Groups(NamedTuple):
    """Groups of at most M windows."""

    begin: np.ndarray  # (M + 1,) number of the first window of each
    ends: np.ndarray  # (M + 1,) bins between them
    energy: np.ndarray  # (M,) J/m²


def make_groups(windows: int) -> Groups:
    """For at most so many windows."""
    begin, ends = np.empty((2, windows + 1), np.int64)
    return Groups(begin, ends, np.empty(windows))


@part
def _is_known(windows: PairWindows, begin: int, end: int, b: int) -> bool:
    energy, noise = 0.0, 0.0
    for w in range(begin, end):
        energy += windows.sums[w, b]
        noise += windows.noise[w, b]
    return noise <= (_KNOWN * energy) ** 2


@part
def _fit(
    windows: PairWindows, edges: np.ndarray, groups: Groups, count: int, b: int, curves: CurveScratch
) -> int:
    """Fit a curve to groups; returns how many have energy, which are its knots."""
    found = 0
    for g in range(count):
        groups.ends[g], groups.energy[g] = windows.wide[groups.begin[g]], 0.0
        for w in range(groups.begin[g], groups.begin[g + 1]):
            groups.energy[g] += windows.sums[w, b]
        found += groups.energy[g] > 0.0
    groups.ends[count] = windows.wide[groups.begin[count]]
    fit_curve(groups.ends[: count + 1], groups.energy[:count], edges, True, curves)
    return found


@part
def _pool(
    windows: PairWindows,
    edges: np.ndarray,
    fitted: int,
    first: int,
    b: int,
    groups: Groups,
    curves: CurveScratch,
) -> int:
    """Fill `groups` with those of band `b`, each window before `first` one of its own, and `curves.curve` with
    their curve if one has several windows; returns how many they are."""
    begin, knots, count, known = groups.begin, curves.knots, fitted, 0
    for w in range(fitted + 1):
        begin[w] = w
    for w in range(first, fitted):
        known += _is_known(windows, w, w + 1, b)
    if known == fitted - first:
        return fitted
    while True:
        found, lucky = _fit(windows, edges, groups, count, b, curves), 0
        for k in range(2, found + 1):
            before, own = knots.window[k - 1], knots.window[k]
            rises = not knots.level[k] <= knots.level[k - 1]
            if (
                rises
                and begin[before] >= first
                and not _is_known(windows, begin[own], begin[own + 1], b)
            ):
                lucky = k
                break
        if lucky == 0:
            return count
        before, own = knots.window[lucky - 1], knots.window[lucky]
        for g in range(own + 1, count + 1):
            begin[before + g - own] = begin[g]
        count -= own - before


@part
def _spread(
    windows: PairWindows, groups: Groups, g: int, count: int, b: int, curves: CurveScratch
) -> None:
    """Spread group `g` over its windows as the curve of its band `b` is; `count`: of `windows.ends`."""
    begin, end = groups.begin[g], groups.begin[g + 1]
    low, high, bands = groups.ends[g], groups.ends[g + 1], windows.energy.shape[1]
    total = 0.0
    for t in range(low, high):
        total += curves.base[t] * curves.curve[t]
    for k in range(b, windows.sums.shape[1], bands):
        for w in range(begin + 1, end):
            windows.sums[begin, k] += windows.sums[w, k]
    for w in range(end - 1, begin - 1, -1):  # the first, which holds the sums, at last
        share = 0.0
        for t in range(windows.wide[w], windows.wide[w + 1]):
            share += curves.base[t] * curves.curve[t] / total
        for k in range(b, windows.sums.shape[1], bands):
            windows.sums[w, k] = share * windows.sums[begin, k]
    for v in range(count):
        if low <= windows.ends[v] < high:
            energy = 0.0
            for t in range(windows.ends[v], windows.ends[v + 1]):
                energy += curves.base[t] * curves.curve[t] / total
            windows.energy[v, b] = energy * groups.energy[g]


@part
def pool_windows(
    windows: PairWindows,
    edges: np.ndarray,
    split: int,
    count: int,
    fitted: int,
    groups: Groups,
    curves: CurveScratch,
) -> None:
    """Spread what rises in a pair's windows without being known, from bin `split` on. `count`, `fitted`: as
    `cut_windows` has them; `edges` (bins + 1,) s, whose differences are the base of `curves`."""
    first = 0
    while first < fitted and windows.wide[first] < split:
        first += 1
    for b in range(windows.energy.shape[1]):
        found = _pool(windows, edges, fitted, first, b, groups, curves)
        for g in range(found):
            if groups.begin[g + 1] > groups.begin[g] + 1:
                _spread(windows, groups, g, count, b, curves)
