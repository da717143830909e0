"""Triangles by themselves: areas, normals, and which of them hang together.

Conventions: `corners` (F, 3, 3) m; `faces` (F, 3) rows of vertices.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.core.numerics.rows import unique_rows


def cross_products(corners: np.ndarray) -> np.ndarray:
    """(F, 3) normals as long as twice each triangle's area, m²; right-handed in the order of corners."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def areas(corners: np.ndarray) -> np.ndarray:
    """(F,) m²."""
    return np.asarray(0.5 * np.linalg.norm(cross_products(corners), axis=1))


def used_rows(faces: np.ndarray, points: int) -> np.ndarray:
    """The rows, of so many points, that faces have, ascending."""
    used = np.zeros(points, bool)
    used[faces.ravel()] = True
    return np.flatnonzero(used)


def lowest(corners: np.ndarray) -> np.ndarray:
    """(F, 3) least coordinates of each triangle, m."""
    # A reduction over an axis of three takes ten times as long.
    return np.minimum(np.minimum(corners[:, 0], corners[:, 1]), corners[:, 2])


def highest(corners: np.ndarray) -> np.ndarray:
    """(F, 3) greatest coordinates of each triangle, m."""
    return np.maximum(np.maximum(corners[:, 0], corners[:, 1]), corners[:, 2])


def longest_edges(corners: np.ndarray) -> np.ndarray:
    """(F,) squared length of each triangle's longest edge, m²."""
    return np.asarray(((corners - corners[:, [1, 2, 0]]) ** 2).sum(axis=2).max(axis=1))


def weld(points: np.ndarray, decimals: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) that agree when rounded are one: (V, 3) rounded points, and (n,) rows of them."""
    scale = 10.0**decimals
    if not np.abs(points).max(initial=0.0) * scale < 2**62:
        rounded = np.round(points, decimals)
        first, row = unique_rows(rounded)
        return rounded[first], row
    whole = np.rint(points * scale).astype(np.int64)
    first, row = unique_rows(whole)
    return whole[first] / scale, row


def welded(corners: np.ndarray, decimals: int) -> tuple[np.ndarray, np.ndarray]:
    """The same of corners: (V, 3) rounded points, and (F, 3) rows of them."""
    points, row = weld(corners.reshape(-1, 3), decimals)
    return points, row.reshape(-1, 3)


def pieces_of(faces: np.ndarray, points: int) -> np.ndarray:
    """(F,) number of the connected piece of each face: faces that share a corner are of one piece."""
    ends = np.concatenate([faces[:, :2], faces[:, 1:]])
    matrix = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(points, points))
    label = connected_components(matrix, directed=False)[1][faces[:, 0]]
    return np.asarray(np.unique(label, return_inverse=True)[1])
