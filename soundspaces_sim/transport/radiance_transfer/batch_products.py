"""Products of histograms by batch of all pairs of points (`batch_variance`), summed over groups of patches.

An end counts twice in a pair, once by its outgoing and once by its incident histograms. Both directions are

    ⟨V_a, F_b⟩ + ⟨V_b, F_a⟩,

one product of vectors of twice the length, (V_a, F_a) with (F_b, V_b). So histograms of both kinds lie side by
side.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import at_once, thread_count
from soundspaces_sim.transport.radiance_transfer.batch_moments import BatchProducts, Crossed
from soundspaces_sim.transport.radiance_transfer.batch_variance import WindowSteps, moment_rows
from soundspaces_sim.transport.radiance_transfer.convolution import (
    PLAIN,
    Kind,
    accumulate,
    least_rows,
    transform,
)
from soundspaces_sim.transport.radiance_transfer.time_steps import Stretch
from soundspaces_sim.transport.tables import BATCHES

_TOGETHER = 2**21  # products of points of as many batches are made at once, …
_TASKS = 4  # … unless a thread would have fewer tasks


class ByBatch(NamedTuple):
    """Histograms by batch of N points, on the G groups of a chunk."""

    # (b, N, moment rows, steps, 2 G): outgoing, then incident, of `patch_histograms.Histograms`
    both: np.ndarray
    within: np.ndarray  # (b, N, 2, steps, 2 G), of the same

    @property
    def halves(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of `both` and `within`, each: V, F."""
        return [_halves(table) for table in self]


def no_products(
    windows: WindowSteps, groups: int, shape: tuple[int, int, int], same: bool
) -> BatchProducts:
    """Zeros, for (bands, A, B). Of points with themselves (`same`) `of_b` is `of_a`, `back` is `there`, and what is
    symmetric, `raised` and `within`, is there for the pairs of points i and j >= i."""
    (bands, a, b), below, steps = shape, moment_rows(groups) - BATCHES, windows.total

    def one_way(p: int, q: int) -> tuple[np.ndarray, Crossed]:
        taken = np.zeros((bands, groups, p, q, steps), np.float32)
        counts = np.zeros((bands, groups, groups, p, q, steps), np.float32)
        return np.zeros((bands, below, p, q, steps), np.float32), Crossed(taken, counts)

    raised = np.zeros((bands, BATCHES, a, b, steps), np.float32)
    within = np.zeros((bands, 2, a, b, steps), np.float32)
    of_a, there = one_way(a, b)
    of_b, back = (of_a, there) if same else one_way(b, a)
    return BatchProducts(raised, within, of_a, of_b, there, back)


def add_all_products(windows: WindowSteps, a: ByBatch, b: ByBatch, out: BatchProducts) -> None:
    """Add the products by way of a chunk of patches; `a is b` for points with themselves."""
    same, points, bands = a is b, len(a.both[0]) * len(b.both[0]), len(a.both)
    one = points * max(len(s.convolution.forward) for s in windows.stretches)
    of_thread = bands * BATCHES // (_TASKS * thread_count())
    together = max(min(_TOGETHER // one, of_thread, BATCHES), 1)

    def counts(band: int) -> None:
        _add_counts(windows, a, b, band, out.of_a[band], out.there)
        if not same:
            _add_counts(windows, b, a, band, out.of_b[band], out.back)

    def within(band: int) -> None:
        of_a = _variance_and_unlike(a, band)
        of_b = of_a if same else _variance_and_unlike(b, band)
        add_both_ways(windows, of_a, of_b, out.within[band])

    def batches(band: int, first: int) -> None:
        some = slice(first, min(first + together, BATCHES))
        of_a = a.both[band, :, some]
        of_b = of_a if same else b.both[band, :, some]
        add_both_ways(windows, of_a, of_b, out.raised[band, some])

    tasks = [partial(counts, band) for band in range(bands) if out.of_a.shape[1]]
    tasks += [partial(within, band) for band in range(bands)]
    tasks += [partial(batches, band, k) for band in range(bands) for k in range(0, BATCHES, together)]
    at_once(*tasks, least=least_rows(one * together * a.both.shape[-1]), alone=True)


def _variance_and_unlike(ends: ByBatch, band: int) -> np.ndarray:
    """(N, 2, steps, 2 G): the variance of V with how patches differ for F, and the other way round."""
    (variance_v, unlike_v), (variance_f, unlike_f) = (
        half[band].swapaxes(0, 1) for half in ends.halves[1]
    )
    pairs = (variance_v, unlike_f), (variance_f, unlike_v)
    return np.stack([np.concatenate(pair, axis=-1) for pair in pairs], axis=1)


def _add_counts(
    windows: WindowSteps, of: ByBatch, to: ByBatch, band: int, below: np.ndarray, crossed: Crossed
) -> None:
    """Rows below the batches: each with all of the other end, and those of one end with those of the other."""
    whole = to.both[band, :, :BATCHES].mean(axis=1)
    turned = np.concatenate(_halves(whole)[::-1], axis=-1)
    add_products(windows, of.both[band, :, BATCHES:], turned, below)
    outgoing, incident = of.halves[0][0][band], to.halves[0][1][band]
    groups = crossed.taken.shape[1]
    counted = outgoing[:, BATCHES : BATCHES + groups]
    for m in range(groups):
        taken = BATCHES + groups + m
        add_products(
            windows, outgoing[:, taken : taken + 1], incident[:, taken], crossed.taken[band, m : m + 1]
        )
        add_products(windows, counted, incident[:, BATCHES + m], crossed.counts[band, m])


def add_products(windows: WindowSteps, own: np.ndarray, other: np.ndarray, out: np.ndarray) -> None:
    """Add to `out` (K, P, Q, T) the convolutions of each of K of `own` (P, K, steps, columns) with `other`
    (Q, steps, columns), summed over columns.

    They are without decay compensation; so is `out`, of which only ratios between batches are used.
    """
    for stretch in windows.stretches:
        columns = _spectra(stretch, other[:, None])
        for k in range(len(out)):
            rows = _spectra(stretch, own[:, k : k + 1])
            _accumulate(stretch, rows, columns, out[k : k + 1], PLAIN)


def add_both_ways(windows: WindowSteps, a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    """Add to `out` (K, P, Q, T) convolutions of `a` (P, K, steps, columns) with the same of K of `b` (Q, K, steps,
    columns): of the first half of the columns of either with the second half of the other.

    To the bit the same with a and b exchanged. Where `a is b`, pairs of a point with an earlier one are left out.
    """
    for stretch in windows.stretches:
        rows = _spectra(stretch, a)
        columns = rows if a is b else _spectra(stretch, b)
        _accumulate(stretch, rows, columns, out, Kind(crossed=True, symmetric=a is b))


def _accumulate(
    stretch: Stretch, rows: np.ndarray, columns: np.ndarray, out: np.ndarray, kind: Kind
) -> None:
    scratch = np.empty(len(rows) * out[..., 0].size, np.float32)
    accumulate(stretch.convolution, rows, columns, scratch, out, (slice(None), stretch.bins), kind)


def _halves(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    half = columns.shape[-1] // 2
    return columns[..., :half], columns[..., half:]


def _spectra(stretch: Stretch, histograms: np.ndarray) -> np.ndarray:
    """(R, K, N, columns) transforms of histograms (N, K, steps, columns)."""
    count, tables, _, columns = histograms.shape
    spectra = np.empty((len(stretch.convolution.forward), tables, count, columns), np.float32)
    transform(stretch.convolution, histograms[:, :, stretch.rows], spectra)
    return spectra
