"""Convolution over time as matrix products: what many pairs share is transformed once.

The discrete Fourier transform of two series of T steps, multiplied with three real products for each complex
one (Karatsuba 1962), is a bilinear algorithm: with matrices `forward` and `back`,

    convolution of x and y = back @ ((forward @ x) * (forward @ y)).

Sums over a third index (patches) come between, as matrix products of all x with all y.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Convolution(NamedTuple):
    """R products."""

    forward: np.ndarray  # (R, T) float32
    back: np.ndarray  # (T - first, R) float32: steps `first` to T of the convolution


def make_convolution(steps: int, first: int) -> Convolution:
    """For series of `steps`, of whose convolution the steps from `first` to `steps` are wanted."""
    # Circular, as long as what wraps round falls on steps that are not wanted.
    size = max(2 * steps - 1 - first, steps)
    size += size % 2
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
