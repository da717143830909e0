"""Where a level plane cuts a mesh: the lines of a floor plan."""

from __future__ import annotations

import numpy as np


def section(corners: np.ndarray, height: float) -> np.ndarray:
    """(n, 4) segments in which triangles (F, 3, 3) cross the plane z = height."""
    z = corners[:, :, 2] - height
    z = np.where(z == 0.0, 1e-9, z)
    below = z < 0.0
    crossing = below.any(axis=1) & ~below.all(axis=1)
    c, z, below = corners[crossing], z[crossing], below[crossing]
    lone = np.where(below.sum(axis=1) == 1, below.argmax(axis=1), (~below).argmax(axis=1))
    rows = np.arange(len(c))
    ends = []
    for step in (1, 2):
        other = (lone + step) % 3
        t = z[rows, lone] / (z[rows, lone] - z[rows, other])
        ends.append(c[rows, lone, :2] + t[:, None] * (c[rows, other, :2] - c[rows, lone, :2]))
    return np.concatenate(ends, axis=1)
