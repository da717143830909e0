"""Convolutions over time of all pairs of histograms, as matrix products: every histogram is transformed once.

The discrete Fourier transform of two series of T steps, multiplied with three real products for each complex
one (Karatsuba 1962), is a bilinear algorithm: with real matrices `forward` (R, T) and `inverse`,

    x ∗ y = inverse @ ((forward @ x) · (forward @ y)).

The sum over patches c of x_pc ∗ y_qc, for all points p and q, is a matrix product of the transforms of all x_p with
those of all y_q, for each of the R rows. The transforms are called spectra below.

Source: A. Karatsuba and Yu. Ofman (1962), Multiplication of many-digital numbers by automatic computers.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import over_rows

BLOCK = 16  # the number of points on either side of a product is rounded up to a multiple of this
_MULTIPLICATIONS = 2**22  # for which it is worth to wake a thread
_SHAPES = ((16, 16), (8, 16), (8, 8), (4, 8), (4, 4))  # rows and columns of products, the fastest first


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
    """Write the transforms of the `histograms` (n, T, columns) of n points to `spectra` (R, n, columns).

    Every point has a product of its own, of the same shape for any n: BLAS adds in another order for other shapes.
    """

    def call(first: int, last: int) -> None:
        rows = slice(first, last)
        np.matmul(convolution.forward, histograms[rows], out=spectra[:, rows].transpose(1, 0, 2))

    of_point = convolution.forward.size * histograms.shape[2]
    over_rows(call, len(histograms), least=-(-_MULTIPLICATIONS // of_point))


@cache
def product_shape() -> tuple[int, int]:
    """(rows, columns) of the matrix products of which a product of all points is composed.

    A pair's energy must not depend on which points are beside it. BLAS adds in another order for other shapes, and
    some of its kernels (those for AVX2) also in different places of one product. So the shape is the largest one of
    which all places give the same bits here; of a product of one row and one column that is always so.
    """
    random = np.random.default_rng(0)
    for rows, columns in _SHAPES:
        if all(_is_uniform(rows, columns, length, random) for length in (5, 48, 114, 256)):
            return rows, columns
    return 1, 1


def _is_uniform(rows: int, columns: int, length: int, random: np.random.Generator) -> bool:
    """Whether all places of products of this shape, over `length`, give the same bits, in both uses in
    `accumulate`."""
    row, column = random.random((2, 1, length), np.float32)
    product = np.repeat(row, rows, axis=0) @ np.repeat(column, columns, axis=0).T
    several = random.random((37, length), np.float32)
    transformed = several @ np.repeat(row.T, columns, axis=1)
    return bool(np.all(product == product[0, 0]) and np.all(transformed == transformed[:, :1]))


def multiply(row_spectra: np.ndarray, column_spectra: np.ndarray) -> np.ndarray:
    """Products of all pairs of two spectra, summed over patches.

    `row_spectra` (R, P, patches), `column_spectra` (R, Q, patches); P and Q are multiples of `BLOCK`. Returns
    (R, P / rows, Q / columns, rows, columns), where (rows, columns) is `product_shape`.
    """
    rows, columns = product_shape()
    products, length = len(row_spectra), row_spectra.shape[2]
    left = row_spectra.reshape(products, -1, 1, rows, length)
    right = column_spectra.reshape(products, 1, -1, columns, length).transpose(0, 1, 2, 4, 3)
    return np.asarray(np.matmul(left, right))


def inverse_transform(convolution: Convolution, blocks: np.ndarray) -> np.ndarray:
    """Convolutions (p, rows, q, columns, steps) from the products (R, p, q, rows, columns) of `multiply`."""
    pairs = blocks.transpose(1, 2, 3, 0, 4)  # (p, q, rows, R, columns)
    return np.matmul(convolution.inverse, pairs).transpose(0, 2, 1, 4, 3)


def packed_count(row_points: int, column_points: int) -> int:
    """How many products of so few points with so few others one product of `product_shape` has room for."""
    rows, columns = product_shape()
    return min(rows // row_points, columns // column_points)


def convolve_few(
    convolution: Convolution, row_spectra: np.ndarray, column_spectra: np.ndarray
) -> np.ndarray:
    """(p, q, steps): what `accumulate` adds, of few points: spectra (R, p, patches) and (R, q, patches).

    A product of one shape is mostly padding then. So several of the R are put into one, beside each other, and
    of what comes out those of one of the R with itself are taken: the same bits, since place does not matter.
    """
    rows, columns = product_shape()
    products, p, _ = row_spectra.shape
    q, several = column_spectra.shape[1], packed_count(p, column_spectra.shape[1])
    left, right = _packed(row_spectra, several, rows), _packed(column_spectra, several, columns)
    blocks = np.matmul(left, right.transpose(0, 2, 1))[:, : several * p, : several * q]
    of_each = np.einsum("gkpkq->pgkq", blocks.reshape(len(blocks), several, p, several, q))
    pairs = np.zeros((p, len(blocks) * several, columns), np.float32)
    pairs[:, :, :q] = of_each.reshape(p, -1, q)
    steps = np.matmul(convolution.inverse, pairs[:, :products])
    return np.asarray(steps[:, :, :q].transpose(0, 2, 1))


def _packed(spectra: np.ndarray, several: int, size: int) -> np.ndarray:
    """(R / several, size, patches) of spectra (R, n, patches): several R beside each other, then zeros."""
    products, points, patches = spectra.shape
    count = -(-products // several)
    out = np.zeros((count, size, patches), np.float32)
    for k in range(several):
        of_k = spectra[k::several]
        out[: len(of_k), k * points : (k + 1) * points] = of_k
    return out


def accumulate(
    convolution: Convolution,
    row_spectra: np.ndarray,
    column_spectra: np.ndarray,
    scratch: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add the convolutions of all pairs of histograms, summed over patches, to `out` (p, q, steps).

    `row_spectra` (R, P, patches), `column_spectra` (R, Q, patches): transforms. P and Q are multiples of `BLOCK`;
    rows beyond those of `out` are padding and left out. `scratch` (R, at least P Q).
    """
    points = out.shape[0], out.shape[1]
    if packed_count(*points) > 1:
        out += convolve_few(convolution, row_spectra[:, : points[0]], column_spectra[:, : points[1]])
        return
    products, p, q = len(row_spectra), row_spectra.shape[1], column_spectra.shape[1]
    rows, columns = product_shape()
    blocks = scratch[:, : p * q].reshape(products, p // rows, q // columns, rows, columns)

    # One product after the other for all blocks, so that both factors stay in the cache.
    def call(first: int, last: int) -> None:
        blocks[first:last] = multiply(row_spectra[first:last], column_spectra[first:last])

    def transform_rows(first: int, last: int) -> None:
        of_block = out[first * rows : last * rows]
        used = len(of_block) if last - first == 1 else rows  # padding is not transformed
        steps = inverse_transform(convolution, blocks[:, first:last, :, :used])
        steps = steps.reshape((last - first) * used, q, out.shape[2])
        of_block += steps[: len(of_block), : out.shape[1]]

    over_rows(call, products, least=-(-_MULTIPLICATIONS // (p * q * row_spectra.shape[2])))
    of_block = rows * q * convolution.inverse.size
    over_rows(transform_rows, p // rows, least=-(-_MULTIPLICATIONS // of_block))


def padded(count: int) -> int:
    """A number of points, rounded up to whole blocks."""
    return -(-count // BLOCK) * BLOCK
