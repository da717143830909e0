"""Products of each batch of one end with all of the other (`batch_variance`), of all pairs of points.

An end counts twice in a pair, once by its outgoing and once by its incident histograms. What batch k of end a
contributes is

    ⟨V_a,k, F_b⟩ + ⟨V_b, F_a,k⟩,

one product of vectors of twice the length, (V_a,k, F_a,k) with (F_b, V_b). So histograms of both kinds lie side by
side. Rows below the batches (counts of reflections, lengths) are the same products.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import over_rows, rows_of_thread
from soundspaces_sim.transport.radiance_transfer.batch_variance import WindowSteps, moment_rows
from soundspaces_sim.transport.radiance_transfer.convolution import (
    inverse_transform,
    multiply,
    padded,
)
from soundspaces_sim.transport.radiance_transfer.time_steps import Stretch
from soundspaces_sim.transport.tables import BATCHES

_ROWS = 64  # of one end, at least, that are multiplied with the other as one
_MULTIPLICATIONS = 2**24  # for which it is worth to wake a thread


class ByBatch(NamedTuple):
    """Histograms by batch of N points, on the G groups of a chunk."""

    both: np.ndarray  # (b, N, moment rows, steps, 2 G): outgoing, then incident
    within: np.ndarray  # (b, N, 2, steps, 2 G), of the same: `patch_histograms.Histograms`

    @property
    def halves(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of `both` and `within`, each: V, F."""
        half = self.both.shape[-1] // 2
        return [(table[..., :half], table[..., half:]) for table in self]

    @property
    def outgoing(self) -> np.ndarray:
        """V."""
        return self.halves[0][0]

    @property
    def incident(self) -> np.ndarray:
        """F."""
        return self.halves[0][1]

    @property
    def turned_within(self) -> np.ndarray:
        """(b, N, steps, 2 G): by how much patches differ, F, then V."""
        outgoing, incident = (part[:, :, 1] for part in self.halves[1])
        return np.concatenate([incident, outgoing], axis=-1)

    @property
    def whole(self) -> np.ndarray:
        """(b, N, steps, 2 G): F, then V, summed over batches."""
        half = self.both.shape[-1] // 2
        out = np.empty((*self.both.shape[:2], *self.both.shape[3:]), np.float32)

        def call(first: int, last: int) -> None:
            batches = self.both[:, first:last, :BATCHES]
            batches[..., half:].sum(axis=2, out=out[:, first:last, :, :half])
            batches[..., :half].sum(axis=2, out=out[:, first:last, :, half:])

        over_rows(call, out.shape[1], least=rows_of_thread(self.both.swapaxes(0, 1)))
        return out


class Crossed(NamedTuple):
    """In one direction, of P outgoing and Q incident points, of counts by M groups of materials at both ends."""

    taken: np.ndarray  # (b, M, P, 1, Q, T) what anchors take of V, with the same of F
    counts: np.ndarray  # (b, M, P, M, Q, T) ⟨V^m, F^k⟩, k on the first of these axes


class ProductsByBatch(NamedTuple):
    """Between A and B points; `of_b` is `of_a`, and `back` is `there`, of points with themselves."""

    of_a: np.ndarray  # (b, A, moment rows, B, T) of each row of a with all of b
    of_b: np.ndarray  # (b, B, moment rows, A, T)
    within_a: (
        np.ndarray
    )  # (b, A, 1, B, T) variance that groups of patches hide, of a's events; `within_b` likewise
    within_b: np.ndarray  # (b, B, 1, A, T)
    there: Crossed
    back: Crossed


def no_products(
    windows: WindowSteps, groups: int, shape: tuple[int, int, int], same: bool
) -> ProductsByBatch:
    """Zeros, for (bands, A, B)."""
    (bands, a, b), rows, steps = shape, moment_rows(groups), windows.total

    def crossed(p: int, q: int) -> Crossed:
        return Crossed(
            np.zeros((bands, groups, p, 1, q, steps), np.float32),
            np.zeros((bands, groups, p, groups, q, steps), np.float32),
        )

    of_a, there = np.zeros((bands, a, rows, b, steps), np.float32), crossed(a, b)
    within_a = np.zeros((bands, a, 1, b, steps), np.float32)
    if same:
        return ProductsByBatch(of_a, of_a, within_a, within_a, there, there)
    of_b = np.zeros((bands, b, rows, a, steps), np.float32)
    within_b = np.zeros((bands, b, 1, a, steps), np.float32)
    return ProductsByBatch(of_a, of_b, within_a, within_b, there, crossed(b, a))


def add_all_products(windows: WindowSteps, a: ByBatch, b: ByBatch, out: ProductsByBatch) -> None:
    """Add the products by way of a chunk of patches; `a is b` for points with themselves."""
    add_products(windows, a.both, b.whole, out.of_a)
    add_products(windows, a.within[:, :, :1], b.turned_within, out.within_a)
    if a is not b:
        add_products(windows, b.both, a.whole, out.of_b)
        add_products(windows, b.within[:, :, :1], a.turned_within, out.within_b)
    directions = [(a, b, out.there)] if a is b else [(a, b, out.there), (b, a, out.back)]
    for of, to, into in directions:
        number = into.taken.shape[1]
        middle = BATCHES + number
        for m in range(number):
            of_m, to_m = of.outgoing[:, :, middle + m, None], to.incident[:, :, middle + m]
            add_products(windows, of_m, to_m, into.taken[:, m])
            counted = of.outgoing[:, :, BATCHES:middle], to.incident[:, :, BATCHES + m]
            add_products(windows, *counted, into.counts[:, m])


def add_products(windows: WindowSteps, own: np.ndarray, other: np.ndarray, out: np.ndarray) -> None:
    """Add to `out` (b, P, rows, Q, T) the convolutions of `own` (b, P, rows, steps, columns) with `other`
    (b, Q, steps, columns), summed over columns.

    They are without decay compensation; so is `out`, of which only ratios between batches are used.
    """
    bands, points, rows = own.shape[:3]
    spectra = [_transformed(stretch, other) for stretch in windows.stretches]
    together = max(_ROWS // rows, 1)
    blocks = -(-points // together)

    def call(first: int, last: int) -> None:
        for n in range(first, last):
            band, block = divmod(n, blocks)
            some = slice(block * together, (block + 1) * together)
            for stretch, of_other in zip(windows.stretches, spectra, strict=True):
                into = out[band, some, :, :, stretch.bins]
                into += _products(stretch, own[band, some], of_other[band], out.shape[3])

    of_block = sum(spectrum[0].size for spectrum in spectra) * padded(together * rows)
    over_rows(call, bands * blocks, chunk=1, least=-(-_MULTIPLICATIONS // max(of_block, 1)))


def _transformed(stretch: Stretch, histograms: np.ndarray) -> np.ndarray:
    """(b, R, Q', columns) transforms of histograms (b, Q, steps, columns), with empty ones up to whole blocks."""
    bands, points, _, columns = histograms.shape
    forward = stretch.convolution.forward
    spectra = np.zeros((bands, len(forward), padded(points), columns), np.float32)

    def call(first: int, last: int) -> None:
        of_points = histograms[:, first:last, stretch.rows]
        np.matmul(forward, of_points, out=spectra[:, :, first:last].transpose(0, 2, 1, 3))

    over_rows(call, points, least=-(-_MULTIPLICATIONS // (bands * forward.size * columns)))
    return spectra


def _products(stretch: Stretch, own: np.ndarray, other: np.ndarray, columns: int) -> np.ndarray:
    """(p, rows, Q, bins) of the histograms `own` (p, rows, steps, columns), and transforms (R, Q', columns) of
    Q points."""
    points, rows, _, length = own.shape
    forward = stretch.convolution.forward
    number = points * rows
    spectra = np.zeros((len(forward), padded(number), length), np.float32)
    of_rows = own[:, :, stretch.rows].reshape(number, -1, length)
    np.matmul(forward, of_rows, out=spectra[:, :number].transpose(1, 0, 2))
    steps = inverse_transform(stretch.convolution, multiply(spectra, other))
    steps = steps.reshape(spectra.shape[1], other.shape[1], -1)[:number, :columns]
    return np.asarray(steps.reshape(points, rows, columns, -1))
