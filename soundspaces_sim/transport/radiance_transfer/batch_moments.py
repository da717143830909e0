"""Energies by batch of a pair, and its counts of reflections, from products by batch (`batch_variance`)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.transport.radiance_transfer.batch_variance import RAISED, WindowSteps
from soundspaces_sim.transport.tables import BATCHES, product_row

_LEAST_LEFT = 1e-6  # of energy; less is rounding


class PairEnergies(NamedTuple):
    """Energies of one band between A and B points."""

    forward: np.ndarray  # (A, B, bins) a -> b, decay-compensated
    backward: np.ndarray  # (B, A, bins) b -> a, decay-compensated
    restore: np.ndarray  # (bins,) factor that undoes the decay compensation


class Crossed(NamedTuple):
    """Of one direction, of P outgoing and Q incident points, of counts by M groups of materials."""

    taken: np.ndarray  # (M, P, Q, T) what anchors take of V, with the same of F
    counts: np.ndarray  # (M, M, P, Q, T) ⟨V^m, F^k⟩, k on the first axis


class BatchProducts(NamedTuple):
    """Of both directions between the A and B points of a tile (`batch_products`), of one band. Of b bands all
    tables have these on an axis before the others."""

    raised: np.ndarray  # (BATCHES, A, B, T) with the weight of a batch raised at both ends
    within: np.ndarray  # (2, A, B, T) variance that groups of patches hide, of V and of F
    of_a: np.ndarray  # (rows below the batches, A, B, T) of counts and lengths of a with all of b
    of_b: np.ndarray  # (rows below the batches, B, A, T)
    there: Crossed
    back: Crossed


class BinSteps(NamedTuple):
    """Where the bins of an echogram lie at coarser resolutions."""

    step: np.ndarray  # (bins,) of the T in which the centre of a bin lies
    window: np.ndarray  # (bins,) window of time in which batches are kept
    length: np.ndarray  # (bins,) m, of paths at the centre of a bin
    variance: np.ndarray  # (T,) m², of lengths that rounding puts into one step


def make_bin_steps(windows: WindowSteps, edges: np.ndarray, window: np.ndarray) -> BinSteps:
    """Of bins between `edges`, m, in windows of batches.

    Both lengths of a path are rounded to whole steps h, each with the variance h² / 12.
    """
    middle = 0.5 * (edges[1:] + edges[:-1])
    step = np.clip(np.searchsorted(windows.edges, middle) - 1, 0, windows.total - 1)
    kept = [s.bins.stop - s.bins.start for s in windows.stretches]
    return BinSteps(step, window, middle, np.repeat(windows.steps.step**2 / 6.0, kept))


@kernel
def add_batches(
    first: int,
    last: int,
    pairs: np.ndarray,
    energies: PairEnergies,
    products: BatchProducts,
    bins: BinSteps,
    batches: np.ndarray,
    share: np.ndarray,
) -> None:
    """Add E_k, (1) of `batch_variance`, of the `pairs` `first` to `last` of (n, 2) to `batches` (A, B, batch rows,
    windows), of one band, and to the rows below E times the means of counts of reflections, what anchors take, and
    products of counts.

    `share` (T, moment rows + 1) is scratch: E_k / E, these means, but covariances for products, the mean length,
    and whether anything arrives in the step. Where no batch has energy in a step, all have the same share.
    """
    groups = len(products.there.taken)
    for n in range(first, last):
        i, j = pairs[n, 0], pairs[n, 1]
        for step in range(len(share)):
            total = 0.0  # of both directions
            for k in range(BATCHES):
                share[step, k] = max(products.raised[k, i, j, step], np.float32(0.0))
                total += share[step, k] / BATCHES
            for k in range(BATCHES):
                change = (share[step, k] / total - 1.0) / RAISED if total > 0.0 else 0.0
                share[step, k] = (1.0 + change) / BATCHES
            if total > 0.0:
                of_v, of_f = products.within[0, i, j, step], products.within[1, i, j, step]
                hidden = max(of_v, np.float32(0.0)) + max(of_f, np.float32(0.0))
                _widen(share[step], hidden / (total * total))
            _find_moments(products, i, j, step, total, share[step])
        for t in range(len(energies.restore)):
            mean = 0.5 * (energies.forward[i, j, t] + energies.backward[j, i, t])
            energy = mean * energies.restore[t]
            for k in range(BATCHES):
                batches[i, j, k, bins.window[t]] += energy * share[bins.step[t], k]
            if groups > 0:
                out = batches[i, j, :, bins.window[t]]
                _add_moments(share, bins.variance, bins.step[t], bins.length[t], energy, groups, out)


@part
def _widen(share: np.ndarray, hidden: float) -> None:
    """Scale how far the shares of batches are from their mean, so that their variance is larger by `hidden`."""
    squares = 0.0
    for k in range(BATCHES):
        squares += (share[k] - 1.0 / BATCHES) ** 2
    if squares <= 0.0:
        return
    scale = math.sqrt(1.0 + hidden * (BATCHES - 1) / (BATCHES * squares))
    for k in range(BATCHES):
        share[k] = 1.0 / BATCHES + scale * (share[k] - 1.0 / BATCHES)


@part
def _find_moments(
    products: BatchProducts, i: int, j: int, step: int, total: float, share: np.ndarray
) -> None:
    """Means of the rows below the batches over both directions of a pair in a step into `share` (moment rows + 1,),
    with covariances for products of counts; its last entry: whether anything arrives. `total`: energy of both.

    Counts and lengths of both ends add. What is left of either multiplies, so that the product of what is taken
    from both is subtracted.
    """
    of_a, of_b, there, back = products.of_a, products.of_b, products.there, products.back
    groups = len(there.taken)
    share[BATCHES:] = 0.0
    if total <= 0.0 or groups == 0:
        return
    share[-1] = 1.0
    for r in range(BATCHES, len(share) - 1):
        share[r] = float(of_a[r - BATCHES, i, j, step]) + float(of_b[r - BATCHES, j, i, step])
    for m in range(groups):
        share[BATCHES + groups + m] -= float(there.taken[m, i, j, step]) + float(
            back.taken[m, j, i, step]
        )
        for k in range(m + 1):
            of_there = float(there.counts[k, m, i, j, step]) + float(there.counts[m, k, i, j, step])
            of_back = float(back.counts[k, m, j, i, step]) + float(back.counts[m, k, j, i, step])
            share[product_row(groups, m, k)] += of_there + of_back
    for r in range(BATCHES, len(share) - 1):
        share[r] /= total
    for m in range(groups):
        for k in range(m + 1):
            share[product_row(groups, m, k)] -= share[BATCHES + m] * share[BATCHES + k]


@part(forceinline=True)
def _next_known(share: np.ndarray, step: int, way: int) -> int:
    """The next step, from `step` on, in which anything arrives; -1 for none."""
    while 0 <= step < len(share):
        if share[step, -1] > 0.0:
            return step
        step += way
    return -1


@part
def _add_moments(
    share: np.ndarray,
    variance: np.ndarray,
    step: int,
    length: float,
    energy: float,
    groups: int,
    out: np.ndarray,
) -> None:
    """Add `energy` times what the rows of counts are at a `length`, on a line between the mean lengths of two
    steps, near `step`, in which anything arrives.

    The paths of a step differ in length, by the `variance` (T,) of rounding. That part of the covariance goes with
    the course of the mean.
    """
    low = _next_known(share, step, -1)
    if low < 0:
        low = _next_known(share, step, 1)
    if low < 0:
        return
    before = _next_known(share, low - 1, -1)
    while before >= 0 and share[low, -2] > length:
        low, before = before, _next_known(share, before - 1, -1)
    high = _next_known(share, low + 1, 1)
    while high >= 0 and share[high, -2] <= length:
        before, low, high = low, high, _next_known(share, high + 1, 1)
    if high < 0:  # beyond the last the line goes on
        low, high = (before, low) if before >= 0 else (low, low)
    gap = share[high, -2] - share[low, -2]
    place = min(max((length - share[low, -2]) / gap, -1.0), 2.0) if gap > 0.0 else 0.0
    rounding = variance[low] + place * (variance[high] - variance[low])
    course = max(rounding, 0.0) / gap**2 if gap > 0.0 else 0.0
    for m in range(groups):
        a, b = share[low, BATCHES + m], share[high, BATCHES + m]
        mean, r = max(a + place * (b - a), 0.0), BATCHES + groups + m
        out[BATCHES + m] += energy * mean
        out[r] += energy * _taken_between(share[low, r], share[high, r], place, course)
        for k in range(m + 1):
            c, d = share[low, BATCHES + k], share[high, BATCHES + k]
            other, r = max(c + place * (d - c), 0.0), product_row(groups, m, k)
            value = share[low, r] + place * (share[high, r] - share[low, r])
            out[r] += energy * max(value - course * (b - a) * (d - c) + mean * other, 0.0)


@part(forceinline=True)
def _taken_between(low: float, high: float, place: float, course: float) -> float:
    """What is taken at a `place` between two steps. ln of what is left is on a line between them, and its mean over
    lengths, whose variance is `course` of the gap's square, is 1 + slope² course / 2 as much."""
    left = max(1.0 - low, _LEAST_LEFT)
    slope = math.log(max(1.0 - high, _LEAST_LEFT) / left)
    return 1.0 - left * math.exp(place * slope) / (1.0 + 0.5 * course * slope * slope)
