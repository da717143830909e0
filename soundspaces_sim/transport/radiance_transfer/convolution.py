"""Convolution over time as matrix products: what many pairs share is transformed once.

The discrete Fourier transform of two series of T steps, multiplied with three real products for each complex
one (Karatsuba 1962), is a bilinear algorithm: with matrices `forward` and `back`,

    convolution of x and y = back @ ((forward @ x) * (forward @ y)).

Sums over a third index (patches) come between, as matrix products of all x with all y.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import over_rows

BLOCK = 16  # points that either side of a product is filled up to a multiple of
_SHAPES = ((16, 16), (8, 16), (8, 8), (4, 8), (4, 4))  # rows and columns of products, the fastest first


class Convolution(NamedTuple):
    """R products."""

    forward: np.ndarray  # (R, T) float32
    back: np.ndarray  # (T - first, R) float32: steps `first` to T of the convolution


def _size(steps: int, first: int) -> int:
    """Circular, as long as what wraps round falls on steps that are not wanted."""
    size = max(2 * steps - 1 - first, steps)
    return size + size % 2


def product_count(steps: int, first: int) -> int:
    """R of `make_convolution`."""
    return 3 * (_size(steps, first) // 2) - 1


def make_convolution(steps: int, first: int) -> Convolution:
    """For series of `steps`, of whose convolution the steps from `first` to `steps` are wanted."""
    size = _size(steps, first)
    half = size // 2
    angle = 2.0 * np.pi * np.arange(half + 1)[:, None] / size
    inner = slice(1, half)
    time = np.arange(steps)
    real, imaginary = np.cos(angle * time), -np.sin(angle * time)
    forward = [real[:1], real[half:], real[inner], imaginary[inner], real[inner] + imaginary[inner]]
    time = np.arange(first, steps)
    cos, sin = 2.0 * np.cos(angle * time)[inner], 2.0 * np.sin(angle * time)[inner]
    back = [np.ones((1, len(time))), np.cos(np.pi * time)[None], cos + sin, sin - cos, -sin]
    return Convolution(
        np.ascontiguousarray(np.concatenate(forward), np.float32),
        np.ascontiguousarray(np.concatenate(back).T / size, np.float32),
    )


def transform(convolution: Convolution, tables: np.ndarray, out: np.ndarray) -> None:
    """Transforms of the series of many points, `tables` (n, T, columns), to `out` (R, n, columns).

    A product for every point, so that it has the same shape for any number of them: BLAS adds in another order for
    other shapes.
    """

    def call(first: int, last: int) -> None:
        rows = slice(first, last)
        np.matmul(convolution.forward, tables[rows], out=out[:, rows].transpose(1, 0, 2))

    over_rows(call, len(tables))


@cache
def product_shape() -> tuple[int, int]:
    """(rows, columns) of the matrix products that points are put together in.

    A pair's energy must not depend on which points are beside it. BLAS adds in another order for other shapes, and
    some of its kernels (those for AVX2) also in different places of one product. So the shape is the largest one of
    which all places give the same bits here; of a product of one row and one column that is always so.
    """
    random = np.random.default_rng(0)
    for rows, columns in _SHAPES:
        if all(_is_even(rows, columns, length, random) for length in (5, 48, 114, 256)):
            return rows, columns
    return 1, 1


def _is_even(rows: int, columns: int, length: int, random: np.random.Generator) -> bool:
    """Whether places of products of this shape, over `length`, give the same bits, in both uses in `meet`."""
    one, other = random.random((2, 1, length), np.float32)
    met = np.repeat(one, rows, axis=0) @ np.repeat(other, columns, axis=0).T
    several = random.random((37, length), np.float32)
    back = several @ np.repeat(one.T, columns, axis=1)
    return bool(np.all(met == met[0, 0]) and np.all(back == back[:, :1]))


def multiply(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(R, P, Q) products of all rows of `left` (R, P, columns) and `right` (R, Q, columns), P and Q multiples of
    `BLOCK`, as (R, P / rows, Q / columns, rows, columns) of `product_shape`."""
    rows, columns = product_shape()
    products, length = len(left), left.shape[2]
    of_left = left.reshape(products, -1, 1, rows, length)
    of_right = right.reshape(products, 1, -1, columns, length).transpose(0, 1, 2, 4, 3)
    return np.asarray(np.matmul(of_left, of_right))


def turn_back(convolution: Convolution, blocks: np.ndarray) -> np.ndarray:
    """(p, rows, q, columns, steps) of what `multiply` gives (R, p, q, rows, columns), summed over products."""
    pairs = blocks.transpose(1, 2, 3, 0, 4)  # (p, q, rows, R, columns)
    return np.matmul(convolution.back, pairs).transpose(0, 2, 1, 4, 3)


def meet(
    convolution: Convolution, one: np.ndarray, other: np.ndarray, met: np.ndarray, out: np.ndarray
) -> None:
    """Add the convolutions of all rows of two transforms, `one` (R, P, columns) and `other` (R, Q, columns), summed
    over columns, to `out` (p, q, steps).

    P and Q are multiples of BLOCK: of the last block, what `out` has no rows for is left out. `met`
    (R, P Q) is scratch.
    """
    products, p, q = len(one), one.shape[1], other.shape[1]
    rows, columns = product_shape()
    blocks = met[:, : p * q].reshape(products, p // rows, q // columns, rows, columns)

    # One product after the other for all blocks, so that both factors stay in the cache.
    def call(first: int, last: int) -> None:
        blocks[first:last] = multiply(one[first:last], other[first:last])

    def back(first: int, last: int) -> None:
        steps = turn_back(convolution, blocks[:, first:last])
        of_block = out[first * rows : last * rows]
        of_block += steps.reshape((last - first) * rows, q, -1)[: len(of_block), : out.shape[1]]

    over_rows(call, products)
    over_rows(back, p // rows)


def padded(count: int) -> int:
    """A number of points, rounded up to whole blocks."""
    return -(-count // BLOCK) * BLOCK
