"""Which wedges of a scene see each other, and may both diffract a path on its way; which specular planes end at
which edges, and what they are made of, found by rays beside the edges. Once per scene."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, dot, negate, row, subtract
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray, unoccluded
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.arrivals.wedges import OFF_LINE, ON_FACE, Wedges, clear_point, edge_point

_SAME_DIRECTION = np.deg2rad(5.0)  # a point so little behind the first face is on it
_PARALLEL = 0.999  # cosine between edges
_LEAST_WIDTH = 1e-6  # m
_NEARER = 0.999  # times as far off
_PLACES = 16  # along an edge
_FREE = 1.99  # wedge index of a plate's edge, and more
_BLOCK = 64  # wedges that are tried against all others at a time
#: Shares of both lengths at which rays go from one edge to another.
_TRIED = np.array([[0.5, 0.5], [0.25, 0.25], [0.75, 0.75], [0.25, 0.75], [0.75, 0.25]])


class MutualVisibility(NamedTuple):
    """Pairs of wedges that see each other: rows start[e]:start[e + 1] are those of wedge e, each pair has two."""

    start: np.ndarray  # (E + 1,)
    wedge: np.ndarray  # (n,) the other one, ascending
    phi: np.ndarray  # (n, 2) angles about e of the other edge's two ends, the smaller first, rad
    reverse: np.ndarray  # (n,) the pair's other row


class Links(NamedTuple):
    """Pairs of parallel wedges that a face connects: rows start[e]:start[e + 1] are those of wedge e."""

    start: np.ndarray  # (E + 1,)
    wedge: np.ndarray  # (n,) the other one, ascending
    phi: np.ndarray  # (n, 2) as in `MutualVisibility`
    reverse: np.ndarray  # (n,) the pair's other row
    width: np.ndarray  # (n,) m, between both
    sense: np.ndarray  # (n,) 1 or -1, by which they run alike or opposite
    shift: np.ndarray  # (n,) m: z along e of what is at z_f along f is sense * z_f + shift


class Edges(NamedTuple):
    """A scene's edges."""

    wedges: Wedges
    plane: np.ndarray  # (E, 2) that mirrors early sound, of each face; -1 for none
    material: np.ndarray  # (E, 2) row of Surfaces, of each face
    # (E, 2, b) amplitude that each face reflects, scattered or not, at random incidence; 1 of one in no plane
    reflects: np.ndarray
    lost: np.ndarray  # (E,) most that is missing of that to 1, of both faces and all bands
    mutual: MutualVisibility
    links: Links
    turn: np.ndarray  # (E, 4) cosine and sine of pi / 2n, and of pi n


def find_mutual_visibility(scene: Scene, wedges: Wedges) -> MutualVisibility:
    """Which wedges see each other, at some point of each edge."""
    count = len(wedges.length)
    rows, found, angles = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty((0, 2))]
    for begin in range(0, count if count > 1 else 0, _BLOCK):
        n = min(_BLOCK, count - begin)
        seen, phi = np.zeros((n, count), np.bool_), np.empty((n, count, 2))
        over_rows(_try_pairs, n, scene.geometry, wedges, begin, seen, phi)
        i, f = np.nonzero(seen)
        rows.append(begin + i)
        found.append(f)
        angles.append(phi[i, f])
    wedge, other = np.concatenate(rows), np.concatenate(found)
    start = np.searchsorted(wedge, np.arange(count + 1))
    # Rows are by (wedge, other), and every pair is there twice: by (other, wedge) they are each other's reverse.
    return MutualVisibility(start, other, np.concatenate(angles), np.lexsort((wedge, other)))


def _rows_of_faces(wedges: Wedges, mutual: MutualVisibility) -> tuple[np.ndarray, np.ndarray]:
    """(Rows of two parallel edges that a face connects, m between both): each lies in a face of the other, and no
    other edge at which the face ends is between them, as where tables of one height stand in a row."""
    e = _wedge_of_row(mutual)
    rows = np.flatnonzero(np.abs((wedges.along[e] * wedges.along[mutual.wedge]).sum(axis=1)) > _PARALLEL)
    linked = np.zeros(len(e), bool)
    width = np.zeros(len(e))
    width[rows] = np.maximum(_least_distance(wedges, e[rows], mutual.wedge[rows]), _LEAST_WIDTH)
    faces = _on_faces(wedges, mutual, rows, width[rows])
    linked[rows] = faces.any(axis=1)
    linked &= linked[mutual.reverse]
    second, rows = faces[linked[rows], 1], rows[linked[rows]]
    far, ends = _across_and_along(wedges, e[rows], mutual.wedge[rows])
    face = 2 * e[rows] + second
    order = np.lexsort((far, face))
    for group in np.split(order, np.flatnonzero(np.diff(face[order])) + 1):
        length = wedges.length[e[rows[group]]]
        linked[rows[group[_covered(far[group], ends[group], length) > 0.5]]] = False
    rows = np.flatnonzero(linked & linked[mutual.reverse])
    return rows, width[rows]


def find_links(wedges: Wedges, mutual: MutualVisibility) -> Links:
    """Of the pairs of wedges that see each other those of one face."""
    rows, width = _rows_of_faces(wedges, mutual)
    e, f = _wedge_of_row(mutual)[rows], mutual.wedge[rows]
    sense = np.sign((wedges.along[e] * wedges.along[f]).sum(axis=1))
    shift = ((wedges.start[f] - wedges.start[e]) * wedges.along[e]).sum(axis=1)
    start = np.searchsorted(e, np.arange(len(wedges.length) + 1))
    reverse = np.searchsorted(rows, mutual.reverse[rows])
    return Links(start, f, mutual.phi[rows], reverse, width, sense, shift)


def _least_distance(wedges: Wedges, e: np.ndarray, f: np.ndarray) -> np.ndarray:
    """(n,) m between edges, as segments: of the nearest places on both lines, or of an end."""
    a, b, to = wedges.along[e], wedges.along[f], wedges.start[f] - wedges.start[e]
    ab, ta, tb = (a * b).sum(axis=1), (to * a).sum(axis=1), (to * b).sum(axis=1)
    det = np.maximum(1.0 - ab * ab, 1e-12)
    none, far = np.zeros(len(e)), wedges.length[e]
    on_e = [np.clip((ta - ab * tb) / det, 0.0, far), none, far]
    pairs = [(x, np.clip(ab * x - tb, 0.0, wedges.length[f])) for x in on_e]
    pairs += [(np.clip(ta + ab * y, 0.0, far), y) for y in (none, wedges.length[f])]
    apart = [to + y[:, None] * b - x[:, None] * a for x, y in pairs]
    least = np.min([np.linalg.norm(v, axis=1) for v in apart], axis=0)
    return np.asarray(least)


def _wedge_of_row(mutual: MutualVisibility) -> np.ndarray:
    """(n,) the wedge whose row each is."""
    return np.repeat(np.arange(len(mutual.start) - 1), np.diff(mutual.start))


def _on_faces(
    wedges: Wedges, mutual: MutualVisibility, rows: np.ndarray, width: np.ndarray
) -> np.ndarray:
    """(n, 2) whether the other edge of a row lies in the first face, and in the second, of its own."""
    e = _wedge_of_row(mutual)[rows]
    sector = np.array([0.0, np.pi]) * wedges.n[e][:, None]
    strays = np.linalg.norm(wedges.offset, axis=1)
    near = ON_FACE + OFF_LINE * (strays[e] + strays[mutual.wedge[rows]]) / width
    off = np.abs(mutual.phi[rows, None] - sector[:, :, None])
    return np.asarray((off < near[:, None, None]).all(axis=2))


def _across_and_along(wedges: Wedges, e: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) Distance of the line of edge f from that of e, and (n, 2) where along e it begins and ends, m."""
    along, to_start = wedges.along[e], wedges.start[f] - wedges.start[e]
    to_end = to_start + wedges.along[f] * wedges.length[f][:, None]
    ends = np.stack([(to_start * along).sum(axis=1), (to_end * along).sum(axis=1)], axis=1)
    middle = 0.5 * (to_start + to_end)
    across = middle - (middle * along).sum(axis=1)[:, None] * along
    return np.linalg.norm(across, axis=1), np.sort(ends, axis=1)


def _covered(far: np.ndarray, ends: np.ndarray, length: np.ndarray) -> np.ndarray:
    """(n,) Part of what an edge has beside it of a parallel one that others of the n, nearer to that, are before:
    edges `far` m from one of this `length` (n,), between `ends` (n, 2) along it, in order of `far`. All of two that
    have nothing beside each other."""
    low, high = np.maximum(ends[:, 0], 0.0), np.minimum(ends[:, 1], length)
    at = low[:, None] + (high - low)[:, None] * (np.arange(_PLACES) + 0.5) / _PLACES
    hidden = np.zeros(at.shape, bool)
    for (start, end), first in zip(ends, np.searchsorted(_NEARER * far, far, "right"), strict=True):
        hidden[first:] |= (start <= at[first:]) & (at[first:] <= end)
    return np.where(low < high, hidden.mean(axis=1), 1.0)


@part
def _angle(wedges: Wedges, e: int, point: Vec3) -> float:
    """phi of a point about wedge `e`; just behind the first face, a little below zero."""
    v = subtract(point, row(wedges.start, e))
    phi = math.atan2(dot(v, row(wedges.normal, e)), dot(v, row(wedges.face, e)))
    return phi if phi > -_SAME_DIRECTION else phi + 2.0 * math.pi


@part
def _angles_of_ends(wedges: Wedges, e: int, f: int) -> tuple[float, float]:
    """(Smaller, larger) phi about wedge `e` of the two ends of edge `f`."""
    first = _angle(wedges, e, row(wedges.start, f))
    last = _angle(wedges, e, edge_point(wedges, f, wedges.length[f]))
    return min(first, last), max(first, last)


@part
def _may_shadow(phi: tuple[float, float], n: float) -> bool:
    """Whether an edge whose ends are at these angles lies in the open sector, and somewhere more than pi from a
    face: else no path from it is diffracted into a shadow."""
    sector = math.pi * n
    return not (phi[0] > sector + _SAME_DIRECTION or max(phi[1], sector - phi[0]) <= math.pi)


@part
def is_free(geometry: Geometry, wedges: Wedges, edges: tuple[int, int], at: tuple[Vec3, Vec3]) -> bool:
    """Whether a ray goes between places off two edges. Of two free edges, rays on either side of what may be one
    plate: those in it meet it or not as rounding has it."""
    (a, b), (p, q) = edges, at
    if unoccluded(geometry, p, q):
        return True
    if min(wedges.n[a], wedges.n[b]) <= _FREE:
        return False
    n, off = row(wedges.normal, a), geometry.epsilon
    return unoccluded(geometry, along(p, off, n), along(q, off, n)) or unoccluded(
        geometry, along(p, -off, n), along(q, -off, n)
    )


@part
def _see_each_other(geometry: Geometry, wedges: Wedges, a: int, b: int) -> bool:
    """Whether a ray goes from wedge a to wedge b."""
    for k in range(len(_TRIED)):
        p = clear_point(wedges, a, _TRIED[k, 0] * wedges.length[a])
        q = clear_point(wedges, b, _TRIED[k, 1] * wedges.length[b])
        if is_free(geometry, wedges, (a, b), (p, q)):
            return True
    return False


@kernel
def _try_pairs(
    first: int,
    last: int,
    geometry: Geometry,
    wedges: Wedges,
    begin: int,
    seen: np.ndarray,
    phi: np.ndarray,
) -> None:
    """Flags `seen` (n, E) of wedges from `begin` on; `phi` (n, E, 2) as in `MutualVisibility`. Rays go from the
    wedge of the smaller number, so that both rows of a pair find the same."""
    for i in range(first, last):
        e = begin + i
        for f in range(len(wedges.length)):
            if e == f:
                continue
            own, other = _angles_of_ends(wedges, e, f), _angles_of_ends(wedges, f, e)
            if not (_may_shadow(own, wedges.n[e]) and _may_shadow(other, wedges.n[f])):
                continue
            phi[i, f, 0], phi[i, f, 1] = own
            seen[i, f] = _see_each_other(geometry, wedges, min(e, f), max(e, f))


_ACROSS = 0.03  # m, from an edge, at which it is tried whether its plane goes on
_ACROSS_STRIP = 0.001  # m, the same where the plane is narrower than that
_ABOVE = 0.05  # m, from a plane, at which these rays start
_TRIED_ALONG = np.array([1.0 / 6.0, 0.5, 5.0 / 6.0])  # shares of the edge's length


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
            for k in range(len(_TRIED_ALONG)):
                at = edge_point(wedges, e, _TRIED_ALONG[k] * wedges.length[e])
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
