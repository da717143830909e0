"""Which specular planes end at which edges, found by rays beside the edges."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, negate
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray
from soundspaces_sim.transport.diffraction.mutual_visibility import MutualVisibility
from soundspaces_sim.transport.diffraction.paths import offset_length
from soundspaces_sim.transport.diffraction.wedges import Wedges, edge_point

_ACROSS = 0.03  # m, from an edge, at which it is tried whether its plane goes on
_ACROSS_STRIP = 0.001  # m, the same where the plane is narrower than that
_ABOVE = 0.05  # m, from a plane, at which these rays start
_ON_FACE = 0.01  # rad: an edge so near to a face is on it
_PARALLEL = 0.999  # cosine between edges
_TRIED = np.array([1.0 / 6.0, 0.5, 5.0 / 6.0])  # shares of the edge's length


class PlaneEdges(NamedTuple):
    """The specular planes that end at each edge: of its first face, and of its second."""

    plane: np.ndarray  # (E, 2), -1 for none
    triangle: np.ndarray  # (E, 2) of that face
    strip: np.ndarray  # (E, 2) whether that face ends at another, parallel edge


@part(forceinline=True)
def face_of(edges: PlaneEdges, e: int, plane: int) -> int:
    """Which of the faces of edge e, 0 or 1, lies in a plane that ends there."""
    return 0 if edges.plane[e, 0] == plane else 1


@part(forceinline=True)
def _across(at: Vec3, n: Vec3, u: Vec3, step: float) -> Vec3:
    """The point `_ABOVE` a place on an edge by the face's normal n, and `step` from it along u, in the face."""
    x = (at[0] + _ABOVE * n[0], at[1] + _ABOVE * n[1], at[2] + _ABOVE * n[2])
    return x[0] + step * u[0], x[1] + step * u[1], x[2] + step * u[2]


@part(forceinline=True)
def face_directions(wedges: Wedges, e: int, face: int) -> tuple[Vec3, Vec3]:
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
def _find_plane_edges(
    first: int, last: int, geometry: Geometry, wedges: Wedges, edges: PlaneEdges
) -> None:
    """Fill rows of `PlaneEdges`: the plane of a face at most places near the edge, unless it goes on beyond. Where
    the face is narrower than the step across, a smaller step meets it."""
    plane, triangle = edges.plane, edges.triangle
    for e in range(first, last):
        reach = _ABOVE + 0.5 * _ABOVE + offset_length(wedges, e)
        for face in range(2):
            plane[e, face] = triangle[e, face] = -1
            u, n = face_directions(wedges, e, face)
            votes = 0
            for k in range(len(_TRIED)):
                at = edge_point(wedges, e, _TRIED[k] * wedges.length[e])
                on = _meets(geometry, at, n, u, _ACROSS, reach)
                if on < 0 or geometry.plane[on] < 0:
                    on = _meets(geometry, at, n, u, _ACROSS_STRIP + offset_length(wedges, e), reach)
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


def _find_strips(wedges: Wedges, mutual: MutualVisibility) -> np.ndarray:
    """(E, 2) `PlaneEdges.strip`."""
    strip = np.zeros((len(wedges.length), 2), np.bool_)
    e = np.repeat(np.arange(len(strip)), np.diff(mutual.start))
    cosine = (wedges.along[e] * wedges.along[mutual.wedge]).sum(axis=1)
    parallel = np.abs(cosine) > _PARALLEL
    on_first = (np.abs(mutual.phi) < _ON_FACE).all(axis=1)
    on_second = (np.abs(mutual.phi - np.pi * wedges.n[e][:, None]) < _ON_FACE).all(axis=1)
    strip[e[parallel & on_first], 0] = True
    strip[e[parallel & on_second], 1] = True
    return strip


def find_plane_edges(geometry: Geometry, wedges: Wedges, mutual: MutualVisibility) -> PlaneEdges:
    """Which specular planes of a scene end at which of its edges."""
    shape = len(wedges.length), 2
    strips = _find_strips(wedges, mutual)
    edges = PlaneEdges(np.empty(shape, np.int64), np.empty(shape, np.int64), strips)
    over_rows(_find_plane_edges, shape[0], geometry, wedges, edges)
    return edges
