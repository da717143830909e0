"""Convolutions over time of all pairs of histograms, as matrix products: every histogram is transformed once.

The discrete Fourier transform of two series of T steps, multiplied with three real products for each complex
one (Karatsuba 1962), is a bilinear algorithm: with real matrices `forward` (R, T) and `inverse`,

    x ∗ y = inverse @ ((forward @ x) · (forward @ y)).

The sum over patches c of x_pc ∗ y_qc, for all points p and q, is a matrix product of the transforms of all x_p with
those of all y_q, for each of the R rows. The transforms are called spectra below.

Source: A. Karatsuba and Yu. Ofman (1962), Multiplication of many-digital numbers by automatic computers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part

_MULTIPLICATIONS = 2**22  # for which it is worth to wake a thread
_SLAB = 256  # pairs of points that are transformed back together
_FEW = 8  # columns: fewer are not worth to be turned
_WIDE = 16  # columns that a processor takes at once, of a few instructions


def least_rows(multiplications: int) -> int:
    """`least` of `over_rows`, of rows with so many multiplications each."""
    return -(-_MULTIPLICATIONS // multiplications)


class Convolution(NamedTuple):
    """The matrices of the convolution of two series of T steps, by R real products."""

    forward: np.ndarray  # (R, T) float32
    inverse: np.ndarray  # (T - first, R) float32: steps `first` to T of the convolution


def _size(steps: int, first: int) -> int:
    """Length of the circular convolution: what wraps round falls on steps that are not wanted."""
    size = max(2 * steps - 1 - first, steps)
    return size + size % 2


def product_count(steps: int, first: int) -> int:
    """R of `make_convolution`: three products per complex frequency, one for the mean and for Nyquist."""
    return 3 * (_size(steps, first) // 2) - 1


def make_convolution(steps: int, first: int) -> Convolution:
    """The matrices for series of `steps`, of whose convolution the steps from `first` to `steps` are wanted."""
    size = _size(steps, first)
    half = size // 2
    angle = 2.0 * np.pi * np.arange(half + 1)[:, None] / size
    inner = slice(1, half)
    time = np.arange(steps)
    real, imaginary = np.cos(angle * time), -np.sin(angle * time)
    forward = [real[:1], real[half:], real[inner], imaginary[inner], real[inner] + imaginary[inner]]
    time = np.arange(first, steps)
    cos, sin = 2.0 * np.cos(angle * time)[inner], 2.0 * np.sin(angle * time)[inner]
    inverse = [np.ones((1, len(time))), np.cos(np.pi * time)[None], cos + sin, sin - cos, -sin]
    return Convolution(
        np.ascontiguousarray(np.concatenate(forward), np.float32),
        np.ascontiguousarray(np.concatenate(inverse).T / size, np.float32),
    )


def transform(convolution: Convolution, histograms: np.ndarray, spectra: np.ndarray) -> None:
    """Write the transforms of `histograms` (N, K, T, columns), K of each of N points, to `spectra` (R, K, N,
    columns).

    Every histogram has a product of its own, of the same shape for any N: BLAS adds in another order for other
    shapes.
    """

    def call(first: int, last: int) -> None:
        out = spectra[:, :, first:last].transpose(2, 1, 0, 3)
        np.matmul(convolution.forward, histograms[first:last], out=out)

    of_point = convolution.forward.size * histograms.shape[1] * histograms.shape[3]
    over_rows(call, len(histograms), least=least_rows(of_point))


class Kind(NamedTuple):
    """Which products `accumulate` makes."""

    crossed: bool = (
        False  # the first half of the columns of either side with the second half of the other
    )
    symmetric: bool = False  # of points with themselves: pairs i, j < i may be left out


PLAIN = Kind()


def accumulate(
    convolution: Convolution,
    rows: np.ndarray,
    columns: np.ndarray,
    scratch: np.ndarray,
    out: np.ndarray,
    some: tuple[slice, slice] = (slice(None), slice(None)),
    kind: Kind = PLAIN,
) -> None:
    """Add the convolutions of all pairs of histograms, summed over patches, to `some` points and steps of `out`
    (K, P, Q, steps): of each of K tables of points with the same one.

    `rows` (R, K, P, patches) and `columns` (R, K, Q, patches) are transforms; `scratch` (at least R K P times
    points of Q,). The bits of a pair depend on no other pair; crossed, they are those with rows and columns
    exchanged. BLAS adds in another order for other shapes and places, `_add_product` does not.
    """
    (products, tables, p, length), (q, steps) = rows.shape, out.shape[2:]
    (start, stop, _), at = some[0].indices(q), some[1].indices(steps)[0]
    spectra = scratch[: products * tables * p * (stop - start)].reshape(
        products * tables, p, stop - start
    )
    wide = -(-(stop - start) // _WIDE) * _WIDE
    left, right = (side.reshape(len(spectra), -1, length) for side in (rows, columns))
    of_half = length // 2 if kind.crossed else length

    def make_scratch() -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((of_half, wide), np.float32), np.empty((4, wide), np.float32)

    over_rows(
        _multiply, len(spectra), left, right, start, kind, spectra,
        scratch=make_scratch, least=least_rows(p * (stop - start) * length),
    )  # fmt: skip
    of_point = (stop - start) * convolution.inverse.size
    back = spectra.reshape(products, -1)
    over_rows(
        _transform_back, tables * p, convolution.inverse, back, (start, stop, at), kind, out,
        scratch=lambda: np.empty((len(convolution.inverse) + 3, _SLAB), np.float32),
        least=least_rows(of_point),
    )  # fmt: skip


@kernel
def _multiply(
    first: int,
    last: int,
    rows: np.ndarray,
    columns: np.ndarray,
    start: int,
    kind: Kind,
    out: np.ndarray,
    scratch: tuple[np.ndarray, np.ndarray],
) -> None:
    """Fill `out` (R, P, points) with sums over patches of `rows` (R, P, patches) times `columns` (R, Q, patches)
    from point `start` of Q on, of the R `first` to `last`."""
    turned, sums = scratch
    points, end, length = out.shape[1], out.shape[2], len(turned)
    for r in range(first, last):
        for half in range(2 if kind.crossed else 1):
            of_row = half * length
            of_column = length - of_row if kind.crossed else 0
            if end >= _FEW:
                _turn(columns[r], start, end, of_column, turned)
            for i in range(0, points, 4):
                begin = i // _WIDE * _WIDE if kind.symmetric else 0
                sums[:, begin:] = 0.0
                if end >= _FEW:
                    _add_product(rows[r], i, of_row, turned, begin, turned.shape[1], sums, 0, 0)
                else:
                    _add_few(rows[r], i, of_row, columns[r], start, of_column, end, length, sums)
                for n in range(min(4, points - i)):
                    for j in range(begin, end):
                        out[r, i + n, j] = sums[n, j] if half == 0 else out[r, i + n, j] + sums[n, j]


@kernel
def _transform_back(
    first: int,
    last: int,
    inverse: np.ndarray,
    spectra: np.ndarray,
    place: tuple[int, int, int],
    kind: Kind,
    out: np.ndarray,
    steps: np.ndarray,
) -> None:
    """Add to rows `first` to `last` of all tables of `out` (K, P, Q, steps) what `inverse` (steps, R) makes of
    `spectra` (R, K P points); `place`: first and last of these points in Q, and the first step. `steps` (steps + 3,
    slab) is scratch."""
    points, count = out.shape[1], len(inverse)
    start, stop, step = place
    for row in range(first, last):
        k, i = row // points, row % points
        for begin in range(i if kind.symmetric else 0, stop - start, steps.shape[1]):
            end = min(begin + steps.shape[1], stop - start)
            steps[:] = 0.0
            at = row * (stop - start) + begin
            for t in range(0, count, 4):
                _add_product(inverse, t, 0, spectra, at, at + end - begin, steps, t, at)
            for j in range(begin, end):
                for t in range(count):
                    out[k, i, start + j, step + t] += steps[t, j - begin]


@part(fastmath={"contract"})
def _add_few(
    left: np.ndarray,
    i: int,
    of_left: int,
    right: np.ndarray,
    start: int,
    of_right: int,
    count: int,
    length: int,
    sums: np.ndarray,
) -> None:
    """To `sums` (4, ·) the products of at most four rows from `i` on of `left` (P, ·) with `count` rows from
    `start` on of `right` (Q, ·), over `length` columns from `of_left` and `of_right` on, as `_add_product` has
    them: four sums at a time, each of which waits for its last product."""
    last = start + count - 1
    for n in range(min(4, len(left) - i)):
        for j in range(start, start + count, 4):
            k, l, m = min(j + 1, last), min(j + 2, last), min(j + 3, last)
            s0, s1, s2, s3 = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for c in range(length):
                a, at = left[i + n, of_left + c], of_right + c
                s0 += a * right[j, at]
                s1 += a * right[k, at]
                s2 += a * right[l, at]
                s3 += a * right[m, at]
            sums[n, m - start], sums[n, l - start], sums[n, k - start] = s3, s2, s1
            sums[n, j - start] = s0


@part
def _turn(columns: np.ndarray, start: int, count: int, first: int, turned: np.ndarray) -> None:
    """`turned` (patches, ·): `count` rows of `columns` (Q, ·) from `start` on, of which patches are those from
    `first` on; some rows at a time, so that whole cache lines are written."""
    for low in range(0, count, 16):
        for c in range(len(turned)):
            for j in range(low, min(low + 16, count)):
                turned[c, j] = columns[start + j, first + c]


@part(fastmath={"contract"})
def _add_product(
    left: np.ndarray,
    i: int,
    of_left: int,
    right: np.ndarray,
    low: int,
    high: int,
    out: np.ndarray,
    into: int,
    before: int,
) -> None:
    """Add four rows from `i` on of `left` (P, ·), from column `of_left` on, times columns `low` to `high` of
    `right` (K, ·), to the rows from `into` on of `out`, whose columns begin at number `before`. Beyond the last
    row of `left` it is that one again.

    Every sum is over K in order, whatever else is made beside it. Columns are counted without a sign: Numba looks
    at those that have one, and then does not take eight at a time.
    """
    length, last = len(right), len(left) - 1
    j, k, l = min(i + 1, last), min(i + 2, last), min(i + 3, last)
    begin, end, offset = np.uint64(low), np.uint64(high), np.uint64(before)
    for c in range(0, length - 3, 4):  # sixteen numbers of `left` stay in registers
        x = of_left + c
        a0, a1, a2, a3 = left[i, x], left[i, x + 1], left[i, x + 2], left[i, x + 3]
        b0, b1, b2, b3 = left[j, x], left[j, x + 1], left[j, x + 2], left[j, x + 3]
        c0, c1, c2, c3 = left[k, x], left[k, x + 1], left[k, x + 2], left[k, x + 3]
        d0, d1, d2, d3 = left[l, x], left[l, x + 1], left[l, x + 2], left[l, x + 3]
        for n in range(begin, end):
            m = n - offset
            x0, x1, x2, x3 = right[c, n], right[c + 1, n], right[c + 2, n], right[c + 3, n]
            out[into, m] = (((out[into, m] + a0 * x0) + a1 * x1) + a2 * x2) + a3 * x3
            out[into + 1, m] = (((out[into + 1, m] + b0 * x0) + b1 * x1) + b2 * x2) + b3 * x3
            out[into + 2, m] = (((out[into + 2, m] + c0 * x0) + c1 * x1) + c2 * x2) + c3 * x3
            out[into + 3, m] = (((out[into + 3, m] + d0 * x0) + d1 * x1) + d2 * x2) + d3 * x3
    for c in range(length - length % 4, length):
        x = of_left + c
        a0, b0, c0, d0 = left[i, x], left[j, x], left[k, x], left[l, x]
        for n in range(begin, end):
            m, x0 = n - offset, right[c, n]
            out[into, m] += a0 * x0
            out[into + 1, m] += b0 * x0
            out[into + 2, m] += c0 * x0
            out[into + 3, m] += d0 * x0
