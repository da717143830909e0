"""Nooks: quarters of cells beside furniture where someone could stand but not get to; things are put there.

A place of the half-metre grid stays a place if no box comes within `_STAND` m of it, and is connected to the
next if none comes within `_PASS` m of the way: what the navigation graph sees lies between the two.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.parts import Box

_STAND, _PASS = 0.085, 0.135  # m
_STEP, _HEAD = 0.2, 1.53  # m: what is lower is stepped on, what is higher is walked under
_THINGS = (("basket", 0.4), ("bin", 0.45), ("indoor-plant", 0.7), ("box", 0.35))


def fill_nooks(boxes: Sequence[Box], width: int, depth: int) -> Iterator[Box]:
    """Small things at places of the half-metre grid that cannot be walked to."""
    table = np.array([box[1:] for box in boxes], float)
    table = table[(table[:, 5] > _STEP) & (table[:, 2] < _HEAD)]
    low, high = table[:, :2], table[:, 3:5]
    nx, ny = 2 * width, 2 * depth
    x, y = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    points = np.stack([x.ravel(), y.ravel()], axis=1) * 0.5 + 0.25

    def clear(a: np.ndarray, b: np.ndarray, margin: float) -> np.ndarray:
        """Whether no box comes within `margin` of the rectangles spanned by places a and b (n, 2)."""
        least, most = np.minimum(a, b)[:, None] - margin, np.maximum(a, b)[:, None] + margin
        return ~((least < high) & (most > low)).all(axis=2).any(axis=1)

    stand = clear(points, points, _STAND)
    number = np.arange(nx * ny).reshape(nx, ny)
    pairs = np.concatenate(
        [
            np.stack([number[:-1].ravel(), number[1:].ravel()], axis=1),
            np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1),
        ]
    )
    pairs = pairs[stand[pairs].all(axis=1) & clear(points[pairs[:, 0]], points[pairs[:, 1]], _PASS)]
    ones = np.ones(len(pairs))
    matrix = coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(nx * ny, nx * ny))
    piece = connected_components(matrix, directed=False)[1]
    largest = np.bincount(piece[stand]).argmax()
    for k, n in enumerate(np.flatnonzero(stand & (piece != largest))):
        label, top = _THINGS[k % len(_THINGS)]
        px, py = points[n]
        yield label, px - 0.09, py - 0.09, 0.0, px + 0.09, py + 0.09, top
