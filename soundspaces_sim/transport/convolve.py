"""Convolution over time as matrix products: what many pairs share is transformed once.

The discrete Fourier transform of two series of T steps, multiplied with three real products for each complex
one (Karatsuba 1962), is a bilinear algorithm: with matrices `forward` and `back`,

    convolution of x and y = back @ ((forward @ x) * (forward @ y)).

Sums over a third index (patches) come between, as matrix products of all x with all y.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.base.kernel import over_rows

BLOCK = 16  # rows on either side of a matrix product


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


def meet(
    convolution: Convolution, one: np.ndarray, other: np.ndarray, met: np.ndarray, out: np.ndarray
) -> None:
    """Add the convolutions of all rows of two transforms, `one` (R, P, columns) and `other` (R, Q, columns), summed
    over columns, to `out` (p, q, steps).

    P and Q are multiples of BLOCK: of the last block, what `out` has no rows for is left out. `met`
    (R, P Q) is scratch.
    """
    products, columns = len(one), one.shape[2]
    p_blocks, q_blocks = one.shape[1] // BLOCK, other.shape[1] // BLOCK
    left = one.reshape(products, p_blocks, 1, BLOCK, columns)
    right = other.reshape(products, 1, q_blocks, BLOCK, columns).transpose(0, 1, 2, 4, 3)
    blocks = met[:, : p_blocks * q_blocks * BLOCK**2]
    blocks = blocks.reshape(products, p_blocks, q_blocks, BLOCK, BLOCK)

    # One product after the other for all blocks, so that both factors stay in the cache.
    def multiply(first: int, last: int) -> None:
        np.matmul(left[first:last], right[first:last], out=blocks[first:last])

    def turn_back(first: int, last: int) -> None:
        for block in range(first, last):
            rows = slice(block * BLOCK, (block + 1) * BLOCK)
            pairs = blocks[:, block].reshape(products, q_blocks, -1).transpose(1, 2, 0)
            steps = pairs @ convolution.back.T
            steps = steps.reshape(q_blocks, BLOCK, BLOCK, -1).transpose(1, 0, 2, 3)
            of_block = out[rows]
            of_block += steps.reshape(BLOCK, q_blocks * BLOCK, -1)[: len(of_block), : out.shape[1]]

    over_rows(multiply, products)
    over_rows(turn_back, p_blocks, chunk=1)


def padded(count: int) -> int:
    """A number of points, rounded up to whole blocks."""
    return -(-count // BLOCK) * BLOCK
