"""Which specular planes end at which edges, and what they are made of, found by rays beside the edges."""

from __future__ import annotations

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, negate
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray
from soundspaces_sim.transport.arrivals.wedges import Wedges, edge_point

_ACROSS = 0.03  # m, from an edge, at which it is tried whether its plane goes on
_ACROSS_STRIP = 0.001  # m, the same where the plane is narrower than that
_ABOVE = 0.05  # m, from a plane, at which these rays start
_TRIED = np.array([1.0 / 6.0, 0.5, 5.0 / 6.0])  # shares of the edge's length


@part(forceinline=True)
def _across(at: Vec3, n: Vec3, u: Vec3, step: float) -> Vec3:
    """The point `_ABOVE` a place on an edge by the face's normal n, and `step` from it along u, in the face."""
    x = (at[0] + _ABOVE * n[0], at[1] + _ABOVE * n[1], at[2] + _ABOVE * n[2])
    return x[0] + step * u[0], x[1] + step * u[1], x[2] + step * u[2]


@part(forceinline=True)
def _face_directions(wedges: Wedges, e: int, face: int) -> tuple[Vec3, Vec3]:
    """(Direction in a face away from the edge, its normal into the open sector)."""
    f, t = wedges.face[e], wedges.normal[e]
    sector = math.pi * wedges.n[e]
    c, d = (1.0, 0.0) if face == 0 else (math.cos(sector), math.sin(sector))
    u = (c * f[0] + d * t[0], c * f[1] + d * t[1], c * f[2] + d * t[2])
    sign = 1.0 if face == 0 else -1.0
    return u, (sign * (c * t[0] - d * f[0]), sign * (c * t[1] - d * f[1]), sign * (c * t[2] - d * f[2]))


@part
def _meets(geometry: Geometry, at: Vec3, n: Vec3, u: Vec3, step: float, reach: float) -> int:
    """The triangle that a ray from above a face meets, -1 for none."""
    _, triangle = cast_ray(geometry, _across(at, n, u, step), negate(n), reach)
    return triangle


@kernel
def _find_faces(
    first: int, last: int, geometry: Geometry, wedges: Wedges, plane: np.ndarray, triangle: np.ndarray
) -> None:
    """Fill rows of planes and of their triangles, (E, 2): the plane of a face at most places near the edge,
    unless it goes on beyond. Where the face is narrower than the step across, a smaller step meets it."""
    for e in range(first, last):
        offset = wedges.offset[e]
        off_edge = math.sqrt(offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
        reach = _ABOVE + 0.5 * _ABOVE + off_edge
        for face in range(2):
            plane[e, face] = triangle[e, face] = -1
            u, n = _face_directions(wedges, e, face)
            votes = 0
            for k in range(len(_TRIED)):
                at = edge_point(wedges, e, _TRIED[k] * wedges.length[e])
                on = _meets(geometry, at, n, u, _ACROSS, reach)
                if on < 0 or geometry.plane[on] < 0:
                    on = _meets(geometry, at, n, u, _ACROSS_STRIP + off_edge, reach)
                if on < 0 or geometry.plane[on] < 0:
                    continue
                _, off = cast_ray(geometry, _across(at, n, u, -_ACROSS), negate(n), reach)
                if off >= 0 and geometry.plane[off] == geometry.plane[on]:
                    votes -= 1
                elif plane[e, face] < 0 or plane[e, face] == geometry.plane[on]:
                    plane[e, face], triangle[e, face] = geometry.plane[on], on
                    votes += 1
            if votes <= 0:
                plane[e, face] = triangle[e, face] = -1


def find_faces(geometry: Geometry, wedges: Wedges) -> tuple[np.ndarray, np.ndarray]:
    """((E, 2) planes that end at the edges, -1 for none; (E, 2) rows of Surfaces of what they are made of)."""
    plane, triangle = np.empty((2, len(wedges.length), 2), np.int64)
    over_rows(_find_faces, len(plane), geometry, wedges, plane, triangle)
    sector = np.pi * wedges.n[:, None]
    second = np.sin(sector) * wedges.face - np.cos(sector) * wedges.normal
    normals = np.stack([wedges.normal, second], axis=1)
    behind = (geometry.normal[triangle] * normals).sum(axis=2) < 0.0
    return plane, np.asarray(geometry.material[triangle, behind.astype(int)])
