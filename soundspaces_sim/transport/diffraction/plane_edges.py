"""Which specular planes end at which edges, found by rays beside the edges."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, negate
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray
from soundspaces_sim.transport.check_cached import like, within
from soundspaces_sim.transport.diffraction.mutual_visibility import (
    MutualVisibility,
    on_faces,
    wedge_of_row,
)
from soundspaces_sim.transport.diffraction.paths import offset_length
from soundspaces_sim.transport.diffraction.plane_pieces import plane_pieces
from soundspaces_sim.transport.diffraction.wedges import Wedges, edge_point

_ACROSS = 0.03  # m, from an edge, at which it is tried whether its plane goes on
_ACROSS_STRIP = 0.001  # m, the same where the plane is narrower than that
_ABOVE = 0.05  # m, from a plane, at which these rays start
_IN_LINE = math.cos(math.radians(1.0))  # between edges
_TRIED = np.array([1.0 / 6.0, 0.5, 5.0 / 6.0])  # shares of the edge's length


class PlaneEdges(NamedTuple):
    """The specular planes that end at each edge: of its first face, and of its second."""

    plane: np.ndarray  # (E, 2), -1 for none
    triangle: np.ndarray  # (E, 2) of that face
    strip: np.ndarray  # (E, 2) whether that face ends at another, parallel edge
    piece: np.ndarray  # (E, 2) of the plane, that the face is of; -1 for none
    of_triangle: np.ndarray  # (F,) the piece of each triangle: `plane_pieces`
    line: np.ndarray  # (E, 2) of the edges of a piece that are in line; -1 where there is no other


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


def _find_strips(wedges: Wedges, mutual: MutualVisibility, rows: np.ndarray) -> np.ndarray:
    """(E, 2) `PlaneEdges.strip`, of `strip_rows`."""
    strip = np.zeros((len(wedges.length), 2), np.bool_)
    e = wedge_of_row(mutual)
    row, face = np.nonzero(on_faces(wedges, mutual) & rows[:, None])
    strip[e[row], face] = True
    return strip


def _find_lines(wedges: Wedges, piece: np.ndarray, line: np.ndarray) -> None:
    """Fill `PlaneEdges.line`."""
    rows = np.flatnonzero(piece.ravel() >= 0)
    order = rows[np.argsort(piece.ravel()[rows], kind="stable")]
    found = 0
    for group in np.split(order, np.flatnonzero(np.diff(piece.ravel()[order])) + 1):
        e = group // 2
        along, middle = (
            wedges.along[e],
            wedges.start[e] + 0.5 * wedges.length[e][:, None] * wedges.along[e],
        )
        for n in range(len(group)):
            if line.flat[group[n]] >= 0:
                continue
            to = middle - middle[n]
            off = np.linalg.norm(to - (to @ along[n])[:, None] * along[n], axis=1)
            same = (np.abs(along @ along[n]) > _IN_LINE) & (off < _ACROSS_STRIP)
            if same.sum() > 1:
                line.flat[group[same]] = found
                found += 1


def find_plane_edges(
    geometry: Geometry,
    corners: np.ndarray,
    wedges: Wedges,
    mutual: MutualVisibility,
    strips: np.ndarray,
) -> PlaneEdges:
    """Which specular planes of a scene end at which of its edges. `corners` (F, 3, 3), m, as of `geometry`;
    `strips` (n,), of `strip_rows`."""
    shape = len(wedges.length), 2
    plane, triangle, piece = np.empty((3, *shape), np.int64)
    pieces, line = plane_pieces(geometry, corners), np.full(shape, -1)
    edges = PlaneEdges(plane, triangle, _find_strips(wedges, mutual, strips), piece, pieces, line)
    over_rows(_find_plane_edges, shape[0], geometry, wedges, edges)
    piece[:] = np.where(triangle >= 0, pieces[triangle], -1)
    _find_lines(wedges, piece, line)
    return edges


def fits(edges: PlaneEdges, count: int, faces: int, planes: int) -> bool:
    """Whether edges from the disk are of a scene with so many edges, faces and planes."""
    shapes = {"plane": "i8 E 2", "triangle": "i8 E 2", "strip": "b1 E 2", "piece": "i8 E 2"}
    shapes |= {"of_triangle": "i8 F", "line": "i8 E 2"}
    return (
        like(edges, shapes, {"E": count, "F": faces})
        and within(edges.plane, -1, planes - 1)
        and all(within(x, -1, faces - 1) for x in (edges.triangle, edges.piece, edges.of_triangle))
        and within(edges.line, -1, 2 * count - 1)
    )
