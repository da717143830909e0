"""Counts of reflections of smoothed energies.

Smoothing moves energy between windows along a decay f (`echogram.denoise`): of E_v in window v the share q_wv
comes into w as q_wv E_v f_w / f_v. With other absorption energies are moved along another decay f'. Both are
log-linear between centres of wide windows and have the energies of these windows. So to first order ln f'/f changes
by the mean counts n_f on lines between them, and paths that are moved from v to w count so many more:

    n̄_w = Σ_v p_wv (n̄_v + n_f(w) − n_f(v)),

p_wv the share of v in the energy of w. Dispersions, correlations and the loss by anchors per count go with the
paths.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.echogram.denoise_plan import DenoisePlan
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.reflection_counts.of_tile import CountMoments, mean_times

_OWN = 1.0 - 1e-6  # share of a window in itself from which on nothing is moved


class _Axes(NamedTuple):
    """What windows and groups of materials stand for."""

    wide: np.ndarray  # (W,) number of the wide window in which each window lies
    anchor: np.ndarray  # (M, b) `MaterialGroups.anchor`


class _Work(NamedTuple):
    """What one band of a pair is worked on in: W windows, M groups, R rows."""

    rows: np.ndarray  # (W, R) before
    before: np.ndarray  # (W, M) n_f at the mean times of windows before smoothing, …
    after: np.ndarray  # (W, M) … and after it
    loss: np.ndarray  # (W, M) -ln of what the anchor leaves, per count
    count: np.ndarray  # (M,) mean counts of paths that have been moved, …
    scale: np.ndarray  # (M,) … and their standard deviations over those before
    knots: np.ndarray  # (3, W) energies, mean times, mean counts of wide windows


def smoothed_moments(
    model: Model, moments: CountMoments, energy: np.ndarray, moved: np.ndarray, plan: DenoisePlan
) -> CountMoments:
    """Moments of the smoothed `energy` (A, B, bins, b), in the place of those before; `moved` (A, B, W, W, b) is
    what `smooth_late` has moved."""
    time, rows = mean_times(model, energy)[0], moments.rows
    wide = _wide_windows(model.world.window_of_bin, plan)
    windows, groups = rows.shape[2], len(model.prepared.groups.names)

    def make_work() -> _Work:
        of_windows = np.empty((3, windows, groups))
        return _Work(
            np.empty((windows, rows.shape[3])),
            *of_windows,
            *np.empty((2, groups)),
            np.empty((3, windows)),
        )

    pairs = rows.shape[0] * rows.shape[1]
    arguments = moments, time, moved, _Axes(wide, model.prepared.groups.anchor), rows
    over_rows(_move, pairs, *arguments, scratch=make_work)
    return CountMoments(time, rows)


def _wide_windows(window: np.ndarray, plan: DenoisePlan) -> np.ndarray:
    """(W,) number of the wide window in which the centre of each window lies; those of early bins on their own.
    `window` (bins,) of each bin."""
    starts = np.append(np.unique(window, return_index=True)[1], len(window))
    middle = 0.5 * (starts[1:] + starts[:-1]) - plan.first
    own = np.arange(len(middle))
    return np.where(middle < 0.0, own, len(own) + np.searchsorted(plan.windows, middle, "right"))


@kernel
def _move(
    first: int,
    last: int,
    moments: CountMoments,
    time: np.ndarray,
    moved: np.ndarray,
    axes: _Axes,
    rows: np.ndarray,
    work: _Work,
) -> None:
    """Fill `rows` (A, B, W, R, b) of the pairs `first` to `last`, counted row by row."""
    columns, windows = rows.shape[1], rows.shape[2]
    for n in range(first, last):
        i, j = n // columns, n % columns
        for b in range(rows.shape[4]):
            for w in range(windows):
                for r in range(rows.shape[3]):
                    work.rows[w, r] = moments.rows[i, j, w, r, b]
            for m in range(len(work.count)):
                knots = _find_knots(moments.time[i, j], moved[i, j], axes.wide, b, m, work)
                for w in range(windows):
                    work.before[w, m] = _on_line(work.knots, knots, moments.time[i, j, w, b])
                    work.after[w, m] = _on_line(work.knots, knots, time[i, j, w, b])
                    n_m, left = work.rows[w, m], 1.0 - work.rows[w, len(work.count) + m]
                    work.loss[w, m] = (
                        -math.log(max(left, 1e-30)) / n_m if n_m > 0.0 else -axes.anchor[m, b]
                    )
            for w in range(windows):
                total = 0.0
                for v in range(windows):
                    total += moved[i, j, w, v, b]
                if total > 0.0 and moved[i, j, w, w, b] < _OWN * total:
                    _mix(moved[i, j, w], total, w, b, work, rows[i, j, w])


@part
def _find_knots(
    time: np.ndarray, moved: np.ndarray, wide: np.ndarray, b: int, m: int, work: _Work
) -> int:
    """Energies, mean times and mean counts of group `m` in wide windows that hold energy, to `work.knots`; their
    number."""
    knots, count, last = work.knots, 0, -1
    for v in range(len(wide)):
        energy = 0.0
        for w in range(len(wide)):
            energy += moved[w, v, b]
        if energy <= 0.0:
            continue
        if wide[v] != last:
            count, last = count + 1, wide[v]
            knots[0, count - 1], knots[1, count - 1], knots[2, count - 1] = 0.0, 0.0, 0.0
        knots[0, count - 1] += energy
        knots[1, count - 1] += energy * time[v, b]
        knots[2, count - 1] += energy * work.rows[v, m]
    for k in range(count):
        knots[1, k] /= knots[0, k]
        knots[2, k] /= knots[0, k]
    return count


@part(forceinline=True)
def _on_line(knots: np.ndarray, count: int, time: float) -> float:
    """The mean count at `time` on lines between so many knots; through the origin with one."""
    if count == 0:
        return 0.0
    if count == 1:
        return knots[2, 0] * time / knots[1, 0]
    k = 0
    while k < count - 2 and time > knots[1, k + 1]:
        k += 1
    slope = (knots[2, k + 1] - knots[2, k]) / (knots[1, k + 1] - knots[1, k])
    return knots[2, k] + slope * (time - knots[1, k])


@part
def _mix(moved: np.ndarray, total: float, w: int, b: int, work: _Work, rows: np.ndarray) -> None:
    """The moments of paths that come from all windows to window `w`, of `total` energy, to `rows` (R, b)."""
    groups = len(work.count)
    for r in range(len(rows)):
        rows[r, b] = 0.0
    for v in range(len(moved)):
        share = moved[v, b] / total
        if share <= 0.0:
            continue
        for m in range(groups):
            before = work.rows[v, m]
            work.count[m] = max(before + work.after[w, m] - work.before[v, m], 0.0)
            work.scale[m] = math.sqrt(work.count[m] / before) if before > 0.0 else 0.0
            rows[m, b] += share * work.count[m]
            rows[groups + m, b] += share * -math.expm1(-work.loss[v, m] * work.count[m])
        r = 2 * groups
        for m in range(groups):
            for k in range(m + 1):
                covariance = work.rows[v, r] - work.rows[v, m] * work.rows[v, k]
                if k == m:
                    covariance = max(covariance, 0.0)
                both = work.count[m] * work.count[k]
                rows[r, b] += share * (covariance * work.scale[m] * work.scale[k] + both)
                r += 1
            if work.rows[v, m] <= 0.0:
                rows[r - 1, b] += share * work.count[m]  # as of a Poisson distribution
