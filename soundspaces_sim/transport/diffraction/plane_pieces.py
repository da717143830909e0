"""The pieces that a plane has: surfaces of it that hang together, found by rays across the triangles' borders.

`specular_planes` groups whatever has one plane equation: the tops of all tables of a room are one plane, as mirrors
need it. A reflector of finite size is one of its pieces.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import (
    Vec3,
    along,
    cross,
    dot,
    negate,
    normalize,
    row,
    subtract,
)
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray

_ACROSS = 0.001  # m, across a border, at which the plane is looked for: gaps that are narrower are none
_OFF = 0.002  # m, from a plane, at which rays start
_TRIED = np.array([0.5, 1.0 / 6.0, 5.0 / 6.0])  # shares of a border's length
_LEAST_ROWS = 256  # triangles for which it is worth to start a thread


@part
def triangle_at(geometry: Geometry, place: Vec3, normal: Vec3, plane: int) -> int:
    """The triangle of a plane at a place of it, met from either side; -1 if there is none."""
    for n in (normal, negate(normal)):
        _, triangle = cast_ray(geometry, along(place, _OFF, n), negate(n), 2.0 * _OFF)
        if triangle >= 0 and geometry.plane[triangle] == plane:
            return triangle
    return -1


@kernel
def _find_neighbours(
    first: int, last: int, geometry: Geometry, corners: np.ndarray, beside: np.ndarray
) -> None:
    """Rows of `beside` (F, 3): across each border of a triangle, one of the same plane, or -1."""
    for t in range(first, last):
        beside[t, :] = -1
        plane, n = geometry.plane[t], row(geometry.normal, t)
        if plane < 0:
            continue
        for k in range(3):
            a, b = row(corners[t], k), row(corners[t], (k + 1) % 3)
            edge = subtract(b, a)
            out = normalize(cross(edge, n))
            if dot(out, subtract(row(corners[t], (k + 2) % 3), a)) > 0.0:
                out = negate(out)
            for share in _TRIED:
                at = along(along(a, share, edge), _ACROSS, out)
                beside[t, k] = triangle_at(geometry, at, n, plane)
                if beside[t, k] >= 0:
                    break


def plane_pieces(geometry: Geometry, corners: np.ndarray) -> np.ndarray:
    """(F,) the piece that each triangle is of, -1 without a plane. `corners` (F, 3, 3), m, as of `geometry`."""
    count = len(corners)
    beside = np.empty((count, 3), np.int64)
    over_rows(_find_neighbours, count, geometry, corners, beside, least=_LEAST_ROWS)
    triangle, border = np.nonzero(beside >= 0)
    linked = coo_array(
        (np.ones(len(triangle), np.int8), (triangle, beside[triangle, border])), shape=(count, count)
    )
    label = connected_components(linked, directed=False)[1].astype(np.int64)
    return np.where(geometry.plane >= 0, label, -1)
