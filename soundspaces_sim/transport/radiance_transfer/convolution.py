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
from soundspaces_sim.transport.radiance_transfer.product_block import ROWS, WIDTH, set_block

_MULTIPLICATIONS = 2**22  # for which it is worth to wake a thread
_LINE = 16  # numbers of a cache line
_SLAB = 8  # panels of pairs of points that are transformed back together
_FEW = 20  # pairs: fewer are not worth a block


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

    # The first half of the columns of either side with the second half of the other.
    crossed: bool = False
    symmetric: bool = False  # of points with themselves: pairs i, j < i may be left out


PLAIN = Kind()


class Blocks(NamedTuple):
    """What a thread works in."""

    panels: np.ndarray  # (·, length, WIDTH) float32
    sums: np.ndarray  # (·, WIDTH) float32


def _make_blocks(length: int, panels: int, sums: int) -> Blocks:
    """Of so many panels, and rows of sums."""
    panel = np.empty((panels, length, WIDTH), np.float32)
    return Blocks(panel, np.empty((sums + ROWS, WIDTH), np.float32))


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
    exchanged. BLAS adds in another order for other shapes and places, `set_block` does not.
    """
    (products, tables, p, length), (q, steps) = rows.shape, out.shape[2:]
    (start, stop, _), at = some[0].indices(q), some[1].indices(steps)[0]
    spectra = scratch[: products * tables * p * (stop - start)].reshape(
        products * tables, p, stop - start
    )
    left, right = (side.reshape(len(spectra), -1, length) for side in (rows, columns))
    halves, count = 2 if kind.crossed else 1, len(convolution.inverse)
    least = least_rows(p * (stop - start) * length)
    if p * (stop - start) < _FEW:
        over_rows(_multiply_few, len(spectra), left, right, start, kind, spectra, least=least)
    else:
        over_rows(
            _multiply, len(spectra), left, right, start, kind, spectra,
            scratch=lambda: _make_blocks(length // halves, halves, 2 * ROWS), least=least,
        )  # fmt: skip
    back, least = spectra.reshape(products, -1), least_rows((stop - start) * convolution.inverse.size)
    slab = min(_SLAB, -(-(stop - start) // WIDTH))
    over_rows(
        _transform_back, tables * p, convolution.inverse, back, (start, stop, at), kind, out,
        scratch=lambda: _make_blocks(products, slab, count), least=least,
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
    scratch: Blocks,
) -> None:
    """Fill `out` (R, P, points) with sums over patches of `rows` (R, P, patches) times `columns` (R, Q, patches)
    from point `start` of Q on, of the R `first` to `last`."""
    panels, sums = scratch
    points, end, length = out.shape[1], out.shape[2], panels.shape[1]
    for r in range(first, last):
        for low in range(0, end, WIDTH):
            high = min(low + WIDTH, end)
            for half in range(len(panels)):
                other = (len(panels) - 1 - half) * length
                _turn(columns[r], start + low, start + high, other, panels[half])
            for i in range(0, min(points, start + high) if kind.symmetric else points, ROWS):
                for half in range(len(panels)):
                    own = _rows_from(i, points)
                    set_block(sums[half * ROWS :], rows[r], own, half * length, panels[half], length)
                _store_block(sums, kind.crossed, min(ROWS, points - i), out[r], i, low, high)


@part
def _store_block(
    sums: np.ndarray, crossed: bool, count: int, out: np.ndarray, i: int, low: int, high: int
) -> None:
    """A block, or the sum of two, into columns `low` to `high` of `count` rows from `i` on of a table."""
    begin, width = np.uint64(low), np.uint64(high - low)
    for n in range(count):
        for j in range(width):
            out[i + n, begin + j] = sums[n, j] + sums[ROWS + n, j] if crossed else sums[n, j]


@kernel
def _transform_back(
    first: int,
    last: int,
    inverse: np.ndarray,
    spectra: np.ndarray,
    place: tuple[int, int, int],
    kind: Kind,
    out: np.ndarray,
    scratch: Blocks,
) -> None:
    """Add to rows `first` to `last` of all tables of `out` (K, P, Q, steps) what `inverse` (steps, R) makes of
    `spectra` (R, K P points); `place`: first and last of these points in Q, and the first step."""
    (panels, sums), points, (count, length) = scratch, out.shape[1], inverse.shape
    start, stop, step = place
    for row in range(first, last):
        k, i = row // points, row % points
        at = row * (stop - start) - start
        for slab in range(max(start, i) if kind.symmetric else start, stop, len(panels) * WIDTH):
            _fill_panels(spectra, at + slab, at + stop, panels)
            for low in range(slab, min(slab + len(panels) * WIDTH, stop), WIDTH):
                panel = panels[(low - slab) // WIDTH]
                for t in range(0, count, ROWS):
                    set_block(sums[t:], inverse, _rows_from(t, count), 0, panel, length)
                for j in range(low, min(low + WIDTH, stop)):
                    for t in range(count):
                        out[k, i, j, step + t] += sums[t, j - low]


@part
def _fill_panels(spectra: np.ndarray, low: int, high: int, panels: np.ndarray) -> None:
    """Columns `low` to `high`, or as many as there is room for, of `spectra` (R, ·) in `panels` (·, R, WIDTH); zero
    beyond."""
    for c in range(panels.shape[1]):
        for n in range(len(panels)):
            begin, width = (
                np.uint64(low + n * WIDTH),
                np.uint64(max(min(high - low - n * WIDTH, WIDTH), 0)),
            )
            for j in range(width):
                panels[n, c, j] = spectra[c, begin + j]
            for j in range(width, np.uint64(WIDTH)):
                panels[n, c, j] = 0.0


@part(forceinline=True)
def _rows_from(i: int, count: int) -> tuple[int, int, int, int, int, int]:
    """`ROWS` rows from `i` on of so many; beyond the last one it is that one again."""
    last = count - 1
    return i, min(i + 1, last), min(i + 2, last), min(i + 3, last), min(i + 4, last), min(i + 5, last)


@part
def _turn(columns: np.ndarray, low: int, high: int, first: int, panel: np.ndarray) -> None:
    """Rows `low` to `high` of `columns` (Q, patches) side by side in `panel` (patches, WIDTH), of patches from
    `first` on; some rows at a time, so that whole cache lines are written. Zero beyond."""
    begin = np.uint64(low)
    for j in range(0, high - low, _LINE):
        for c in range(len(panel)):
            for n in range(np.uint64(j), np.uint64(min(j + _LINE, high - low))):
                panel[c, n] = columns[begin + n, first + c]
    panel[:, high - low :] = 0.0


@kernel(fastmath={"contract"})
def _multiply_few(
    first: int, last: int, rows: np.ndarray, columns: np.ndarray, start: int, kind: Kind, out: np.ndarray
) -> None:
    """`_multiply` of few pairs, to the bit: four sums at a time, each of which waits for its last product."""
    halves = 2 if kind.crossed else 1
    length, end = rows.shape[2] // halves, start + out.shape[2] - 1
    for r in range(first, last):
        left, right = rows[r], columns[r]
        for i in range(len(left)):
            for half in range(halves):
                own, other = half * length, (halves - 1 - half) * length
                for j in range(start, end + 1, 4):
                    k, l, m = min(j + 1, end), min(j + 2, end), min(j + 3, end)
                    s0, s1, s2, s3 = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
                    for c in range(length):
                        a, at = left[i, own + c], other + c
                        s0 += a * right[j, at]
                        s1 += a * right[k, at]
                        s2 += a * right[l, at]
                        s3 += a * right[m, at]
                    sums = s0, s1, s2, s3
                    for n in range(min(4, end + 1 - j)):
                        before = np.float32(0.0) if half == 0 else out[r, i, j - start + n]
                        out[r, i, j - start + n] = before + sums[n]
