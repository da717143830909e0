"""Triangles by themselves: areas, normals, and which of them hang together.

Conventions: `corners` (F, 3, 3) m; `faces` (F, 3) rows of vertices.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.rows import taken, unique_numbers, unique_rows
from soundspaces_sim.core.numerics.vec3 import add, cross, divide, dot, length, put, row, subtract

_LEAST = 2**14  # triangles that are worth a thread


@kernel
def _cross(first: int, last: int, corners: np.ndarray, out: np.ndarray) -> None:
    for i in range(first, last):
        a = row(corners[i], 0)
        put(out, i, cross(subtract(row(corners[i], 1), a), subtract(row(corners[i], 2), a)))


def cross_products(corners: np.ndarray) -> np.ndarray:
    """(F, 3) normals as long as twice each triangle's area, m²; right-handed in the order of corners."""
    return _filled(_cross, corners, np.empty((len(corners), 3)))


@kernel
def _areas(first: int, last: int, corners: np.ndarray, out: np.ndarray) -> None:
    for i in range(first, last):
        a = row(corners[i], 0)
        out[i] = 0.5 * length(cross(subtract(row(corners[i], 1), a), subtract(row(corners[i], 2), a)))


def areas(corners: np.ndarray) -> np.ndarray:
    """(F,) m²."""
    return _filled(_areas, corners, np.empty(len(corners)))


def _filled(fill: Any, corners: np.ndarray, out: np.ndarray) -> np.ndarray:
    over_rows(fill, len(corners), np.ascontiguousarray(corners, float), out, least=_LEAST)
    return out


@kernel
def _middles(first: int, last: int, corners: np.ndarray, out: np.ndarray) -> None:
    for i in range(first, last):
        total = add(add(row(corners[i], 0), row(corners[i], 1)), row(corners[i], 2))
        put(out, i, divide(total, 3.0))


def middles(corners: np.ndarray) -> np.ndarray:
    """(F, 3) m, means of each triangle's corners."""
    return _filled(_middles, corners, np.empty((len(corners), 3)))


def points_on(corners: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(N, 3) m, one on each of the triangles (N, 3, 3), spread evenly where `u` and `v` (N,) are, from 0 to 1."""
    root, v = np.sqrt(u)[:, None], v[:, None]
    a, b, c = corners.transpose(1, 0, 2)
    return np.asarray((1.0 - root) * a + (root * (1.0 - v)) * b + (root * v) * c)


def check_mesh(vertices: np.ndarray, faces: np.ndarray, name: str, remedy: str = "") -> None:
    """Raise `SceneError`, which names the mesh, unless `faces` (F, 3) are rows of `vertices` (V, 3)."""
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise SceneError(f"{name}: vertices need shape (V, 3), got {vertices.shape}")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise SceneError(
            f"{name}: faces need shape (F, 3) and integers, got {faces.shape} {faces.dtype}"
        )
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise SceneError(
            f"{name}: face indices reach {faces.min()}..{faces.max()}, but there are {len(vertices)} "
            f"vertices{remedy}"
        )


def corners_of(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3, 3) `vertices[faces]`, in a third of its time."""
    return taken(vertices, faces.ravel()).reshape(*faces.shape, 3)


def used_rows(faces: np.ndarray, points: int) -> np.ndarray:
    """The rows, of so many points, that faces have, ascending."""
    used = np.zeros(points, bool)
    used[faces.ravel()] = True
    return np.flatnonzero(used)


@kernel
def _boxes(first: int, last: int, corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    for i in range(first, last):
        for k in range(3):
            a, b, c = corners[i, 0, k], corners[i, 1, k], corners[i, 2, k]
            low[i, k] = np.minimum(np.minimum(a, b), c) + 0.0  # -0 is 0
            high[i, k] = np.maximum(np.maximum(a, b), c) + 0.0


def boxes(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F, 3) least and greatest coordinates of each triangle, m."""
    low, high = np.empty((2, len(corners), 3))
    over_rows(_boxes, len(corners), np.ascontiguousarray(corners, float), low, high, least=_LEAST)
    return low, high


@kernel
def _longest_edges(first: int, last: int, corners: np.ndarray, out: np.ndarray) -> None:
    for i in range(first, last):
        a, b, c = row(corners[i], 0), row(corners[i], 1), row(corners[i], 2)
        ab, bc, ca = subtract(a, b), subtract(b, c), subtract(c, a)
        out[i] = np.maximum(np.maximum(dot(ab, ab), dot(bc, bc)), dot(ca, ca))


def longest_edges(corners: np.ndarray) -> np.ndarray:
    """(F,) squared length of each triangle's longest edge, m²."""
    return _filled(_longest_edges, corners, np.empty(len(corners)))


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


def welded_faces(
    vertices: np.ndarray, faces: np.ndarray, decimals: int
) -> tuple[np.ndarray, np.ndarray]:
    """`welded(vertices[faces], decimals)`: of a mesh whose faces share vertices in a fraction of the time."""
    used = used_rows(faces, len(vertices))
    points, row = weld(vertices[used], decimals)
    of_vertex = np.empty(len(vertices), np.int64)
    of_vertex[used] = row
    return points, of_vertex[faces]


def side_numbers(faces: np.ndarray) -> np.ndarray:
    """(F, 3) number of the side from each corner to the next: sides between the same two points are one."""
    start, end = faces, faces[:, [1, 2, 0]]
    low, high = np.minimum(start, end), np.maximum(start, end)
    if len(faces) == 0 or int(high.max()) ** 2 >= 2**62:
        pairs = np.stack([low, high], axis=2).reshape(-1, 2)
        return unique_rows(pairs)[1].reshape(-1, 3)
    return unique_numbers((low * (high.max() + 1) + high).ravel())[1].reshape(-1, 3)


@kernel
def _sort_sides(faces: np.ndarray, first: np.ndarray, sides: np.ndarray) -> None:
    """Sides 3 f + k of faces by the lesser of their points into `sides` (3 F,): those of point v from row
    `first[v]` to `first[v + 1]`; `first` (V + 2,) is zero before."""
    for f in range(len(faces)):
        for k in range(3):
            first[min(faces[f, k], faces[f, (k + 1) % 3]) + 2] += 1
    for v in range(2, len(first)):
        first[v] += first[v - 1]
    for f in range(len(faces)):
        for k in range(3):
            v = min(faces[f, k], faces[f, (k + 1) % 3]) + 1
            sides[first[v]] = 3 * f + k
            first[v] += 1


def _sides_by_point(faces: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """`first` and `sides` of `_sort_sides`."""
    first, sides = np.zeros(points + 2, np.int32), np.empty(faces.size, np.int32)
    _sort_sides(faces, first, sides)
    return first, sides


@kernel
def _find_lone(
    faces: np.ndarray, first: np.ndarray, sides: np.ndarray, seen: np.ndarray, out: np.ndarray
) -> None:
    """Set `out` (F, 3), see `lone_sides`, that is False before; `seen` (V, 2) holds -1."""
    for v in range(len(seen)):
        for i in range(first[v], first[v + 1]):
            s = sides[i]
            f, k = s // 3, s % 3
            a, b, c = faces[f, k], faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            if a == b or b == c or c == a:
                continue
            far = max(a, b)
            if seen[far, 0] != v:
                seen[far, 0], seen[far, 1] = v, s
                out[f, k] = True
            else:
                out[seen[far, 1] // 3, seen[far, 1] % 3] = False


def lone_sides(faces: np.ndarray, points: int) -> np.ndarray:
    """(F, 3) whether no other face, of (F, 3) rows of so many points, has the side from each corner to the next;
    faces with two equal corners have no sides."""
    out = np.zeros(faces.shape, np.bool_)
    _find_lone(faces, *_sides_by_point(faces, points), np.full((points, 2), -1, np.int32), out)
    return out


@kernel
def _find_beyond(
    faces: np.ndarray, first: np.ndarray, sides: np.ndarray, seen: np.ndarray, out: np.ndarray
) -> None:
    """Fill `out` (F, 3), see `beyond_sides`, that holds -1; `seen` (V, 3) holds -1."""
    for v in range(len(seen)):
        for i in range(first[v], first[v + 1]):
            s = sides[i]
            f, k = s // 3, s % 3
            far = max(faces[f, k], faces[f, (k + 1) % 3])
            one = seen[far, 1]
            if seen[far, 0] != v:
                seen[far, 0], seen[far, 1], seen[far, 2] = v, s, -1
            elif seen[far, 2] < 0:
                seen[far, 2] = s
                out[s // 3, s % 3], out[one // 3, one % 3] = one // 3, s // 3
            else:
                other = seen[far, 2]
                out[one // 3, one % 3] = out[other // 3, other % 3] = -1


def beyond_sides(faces: np.ndarray, points: int) -> np.ndarray:
    """(F, 3) the face, of (F, 3) rows of so many points, beyond the side from each corner to the next: -1 where
    there is none, or more than one."""
    out = np.full(faces.shape, -1, np.int32)
    _find_beyond(faces, *_sides_by_point(faces, points), np.full((points, 3), -1, np.int32), out)
    return out


def pieces_of(faces: np.ndarray, points: int) -> np.ndarray:
    """(F,) number of the connected piece of each face: faces that share a corner are of one piece."""
    ends = np.concatenate([faces[:, :2], faces[:, 1:]])
    matrix = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(points, points))
    label = connected_components(matrix, directed=False)[1][faces[:, 0]]
    return np.asarray(np.unique(label, return_inverse=True)[1])
