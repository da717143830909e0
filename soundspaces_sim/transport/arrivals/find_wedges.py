"""The diffracting wedges of a mesh: its convex creases and free borders, found once per scene.

A piece of a triangle's side that lies on a common straight line with others is taken together with them,
whatever triangles it belongs to: so a wall may be tessellated in any way, and the two walls of a corner in
different ones. Along a line the faces that meet there leave sectors open between them; the widest is the
wedge's open sector, if it is more than 180 degrees plus a threshold (a border: 360). What is flat, what is
short, and what another surface closes (the foot of a partition, the back of a cupboard at a wall) is left out.

Host code (numpy), but for the rays that find out what is closed.
"""

from __future__ import annotations

import logging
import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rows import in_order, unique_rows
from soundspaces_sim.core.numerics.vec3 import Vec3, add, divide, dot, length, put, row, scale, subtract
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray, in_sight, unoccluded
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import beyond_sides, welded_faces
from soundspaces_sim.transport.arrivals.plane_edges import Candidate, plane_edges
from soundspaces_sim.transport.arrivals.specular_planes import OF_THREAD
from soundspaces_sim.transport.arrivals.wedges import (
    Wedges,
    clear_point,
    edge_point,
    met_point,
    no_wedges,
)

_log = logging.getLogger(__name__)
MIN_ANGLE = np.deg2rad(20.0)  # between two faces: less is flat
MIN_LENGTH = 0.3  # m
_WELD = 4  # decimals of a metre
_LEAST = MIN_LENGTH - 10.0**-_WELD  # m: what is as long but for what welding takes
_COLLINEAR = 0.002  # m, how far pieces of one edge stray from its line
_CELLS = 8  # times as wide are the cells in which such pieces are looked for
_WIDE = 16  # rows of a table for each of them, at least
_SLIVER = _COLLINEAR  # m; a narrower triangle has no direction, and a thinner plate is one face
_SAME_FACE = np.deg2rad(5.0)  # between faces that are one
_PLACES = 16  # along a fitted edge, at which it is tried whether it is known
_TWIN = 0.03  # m between edges that are one
_THIN = 0.01  # m: sides of a plate that are nearer are one that is tried both ways
_ALIKE = 0.98  # cosine between their directions
_ROUGH = 0.005  # m: an edge that strays more has places closed by noise
_FITS = 0.7  # of a fitted edge's offset: a face strays less from its plane
_STEP = 0.05  # m, along an edge and away from it, at which it is tried whether it is open
_MOST_STEPS = 20_000_000  # along all edges
_AROUND = np.array([1.0 / 6.0, 0.5, 5.0 / 6.0])  # shares of an open sector
_CLEAR = 0.03  # m, off an edge: sound passes what is in the way of a ray by less
_GENERIC = np.array([0.62348980, 0.78183148, 0.43388374])  # no edge is likely to be normal to it


def find_wedges(scene: Scene) -> Wedges:
    """The wedges of a scene, the longest first; what was found goes to the log."""
    wedges, text = find_and_tell(scene)
    _log.info(f"{scene.name}: {text}")
    return wedges


def find_and_tell(scene: Scene) -> tuple[Wedges, str]:
    """The wedges of a scene, the longest first, and a line that says what was found by what."""
    vertices = scene.vertices - scene.center
    points, welded = welded_faces(vertices, scene.faces, _WELD)
    _put_as_they_are(vertices, scene.faces, welded, points)
    beyond = beyond_sides(welded, len(points))
    pieces, reach = _pieces(points, welded, beyond)
    del points, welded  # of a scan they are large
    lines = _lines(pieces, reach)
    exact = [candidate for line in lines for candidate in _wedges_of_line(pieces, line)]
    ends = np.array([_ends_of_line(pieces, line) for line in lines]).reshape(-1, 2, 3)
    creases, borders, planes = plane_edges(vertices, scene.faces, beyond, MIN_LENGTH)
    wedges = _tried(scene, exact)
    count, sides = len(wedges.n), float(wedges.length.sum())
    fitted = [
        _longest_first(_tried(scene, [candidate for candidate in some if not _seen(candidate, ends)]))
        for some in (creases, borders)
    ]
    wedges = _joined(wedges, _without_twins(_joined(*fitted)))
    over_rows(_try_ends, len(wedges.n), scene.geometry, wedges, wedges.stands)
    wedges = wedges._replace(clear=wedges.offset.copy())
    over_rows(_move_clear, len(wedges.n), scene.geometry, wedges)
    text = (
        f"{len(wedges.n)} edges diffract, {wedges.length.sum():.0f} m: {count} ({sides:.0f} m) by sides of "
        f"triangles on one line, {len(wedges.n) - count} by {planes} planes fitted to the mesh"
    )
    order = np.lexsort((*wedges.start.T, -wedges.length))
    return Wedges(*(np.ascontiguousarray(column[order]) for column in wedges)), text


def _tried(scene: Scene, candidates: list[Candidate]) -> Wedges:
    """The parts of candidates that are open."""
    if not candidates:
        return no_wedges()
    start, along, length, face, normal, n, margin = (
        np.array(column) for column in zip(*candidates, strict=True)
    )
    half = 0.5 * np.pi * n[:, None]
    bisector = np.cos(half) * face + np.sin(half) * normal
    offset = (scene.geometry.epsilon + margin + 10.0**-_WELD)[:, None] * bisector
    stands = np.zeros((len(n), 2), np.bool_)
    return _open_parts(scene, Wedges(start, along, length, face, normal, n, offset, offset, stands))


def _longest_first(wedges: Wedges) -> Wedges:
    order = np.argsort(-wedges.length, kind="stable")
    return Wedges(*(column[order] for column in wedges))


def _joined(one: Wedges, other: Wedges) -> Wedges:
    return Wedges(*(np.concatenate(pair) for pair in zip(one, other, strict=True)))


def _ends_of_line(pieces: _Pieces, rows: np.ndarray) -> np.ndarray:
    """(2, 3) m, of what pieces on one line reach."""
    ends = np.concatenate([pieces.a[rows], pieces.b[rows]])
    at = ends @ (ends[-1] - ends[0] if len(rows) == 1 else pieces.b[rows[0]] - pieces.a[rows[0]])
    return ends[[at.argmin(), at.argmax()]]


def _seen(candidate: Candidate, lines: np.ndarray) -> bool:
    """Whether sides of triangles on one line, which reach from end to end (n, 2, 3), are where a candidate is: then
    they have said already whether it is a wedge."""
    z = (np.arange(_PLACES) + 0.5) / _PLACES * candidate.length
    at = candidate.start + z[:, None] * candidate.along
    return bool(_beside(at, candidate.along, lines[:, 0], lines[:, 1] - lines[:, 0], _TWIN).mean() > 0.5)


def _beside(
    at: np.ndarray, along: np.ndarray, start: np.ndarray, span: np.ndarray, near: float
) -> np.ndarray:
    """(m,) Which places (m, 3) on a line are less than `near` m from any of n parallel ones."""
    length = np.maximum(np.linalg.norm(span, axis=1), 1e-9)
    same = np.abs(span @ along) > _ALIKE * length
    start, span, length = start[same], span[same], length[same]
    towards = span / length[:, None]
    to = at[:, None] - start
    z = (to * towards).sum(axis=2)
    off = np.linalg.norm(to - z[:, :, None] * towards, axis=2)
    return np.asarray(((off < near) & (z > -near) & (z < length + near)).any(axis=1))


def _without_twins(wedges: Wedges) -> Wedges:
    """Of fitted wedges in one place the first. Two of either side of a thin plate are one of the plate, half-way
    between them."""
    span = wedges.length[:, None] * wedges.along
    n, start, offset = wedges.n.copy(), wedges.start.copy(), wedges.offset.copy()
    kept: list[int] = []
    for e in range(len(n)):
        z = (np.arange(_PLACES) + 0.5) / _PLACES
        at = wedges.start[e] + z[:, None] * span[e]

        def is_beside(some: list[int], at: np.ndarray = at, along: np.ndarray = wedges.along[e]) -> bool:
            return bool(_beside(at, along, wedges.start[some], span[some], _TWIN).mean() > 0.5)

        if not is_beside(kept):
            kept.append(e)
            continue
        normal, face = wedges.normal[kept], wedges.face[kept]
        thick = ((wedges.start[kept] - wedges.start[e]) * normal).sum(axis=1)
        plate = (normal @ wedges.normal[e] < -_ALIKE) & (face @ wedges.face[e] > _ALIKE)
        for i in np.flatnonzero(plate & (thick >= _THIN) & (n[kept] < 2.0)):
            k = kept[i]
            if is_beside([k]):
                n[k] = 2.0
                start[k] -= 0.5 * thick[i] * normal[i]
                offset[k] = -np.linalg.norm(offset[k]) * face[i]
    wedges = wedges._replace(n=n, start=start, offset=offset)
    return Wedges(*(column[kept] for column in wedges))


@kernel
def _put_as_they_are(
    vertices: np.ndarray, faces: np.ndarray, welded: np.ndarray, points: np.ndarray
) -> None:
    """Put the vertices in place of rounded points: rounded ends turn short sides out of their line."""
    for f in range(len(faces)):
        for k in range(3):
            put(points, welded[f, k], row(vertices, faces[f, k]))


class _Pieces(NamedTuple):
    """Sides of triangles that are no part of a flat wall."""

    a: np.ndarray  # (n, 3) m
    b: np.ndarray  # (n, 3)
    inward: np.ndarray  # (n, 3) unit, in the triangle, normal to the side


def _pieces(points: np.ndarray, faces: np.ndarray, beyond: np.ndarray) -> tuple[_Pieces, float]:
    """(Those that may be on a line that is long enough; how far any is from the origin, m) of welded faces, which
    have these beyond their sides."""
    a, b, c = faces.T
    whole = (a != b) & (b != c) & (c != a)
    if not whole.all():
        faces = faces[whole]
        beyond = beyond_sides(faces, len(points))
    shown = np.zeros((3, len(faces)), np.bool_)
    over_rows(_find_shown, len(faces), points, faces, beyond, shown, least=OF_THREAD)
    table = np.zeros(_WIDE << int(np.count_nonzero(shown)).bit_length(), np.uint8)
    reach = _drop_alone(points, faces, beyond, table, shown)
    k, face = np.divmod(np.flatnonzero(shown), max(len(faces), 1))
    inward = np.empty((len(k), 3))
    over_rows(_find_inward, len(k), points, faces, face, k, inward, least=OF_THREAD)
    one, other = faces[face, k], faces[face, (k + 1) % 3]
    return _Pieces(points[np.minimum(one, other)], points[np.maximum(one, other)], inward), reach


@part
def _side(faces: np.ndarray, f: int, k: int) -> tuple[int, int]:
    """The rows of the ends of a triangle's side, the lesser first."""
    one, other = faces[f, k], faces[f, (k + 1) % 3]
    return min(one, other), max(one, other)


@part
def _inward(points: np.ndarray, faces: np.ndarray, f: int, k: int) -> tuple[Vec3, float]:
    """(`_Pieces.inward` of a triangle's side; how wide the triangle is there, m)."""
    one, other = _side(faces, f, k)
    a = row(points, one)
    span, off = subtract(row(points, other), a), subtract(row(points, faces[f, (k + 2) % 3]), a)
    off = subtract(off, scale(dot(off, span) / dot(span, span), span))
    width = length(off)
    return divide(off, max(width, 1e-300)), width


@kernel
def _find_shown(
    first: int, last: int, points: np.ndarray, faces: np.ndarray, beyond: np.ndarray, shown: np.ndarray
) -> None:
    """Flag the sides (3, F) of triangles that have a direction where they are no part of a flat wall."""
    for f in range(first, last):
        for k in range(3):
            inward, width = _inward(points, faces, f, k)
            shown[k, f] = width >= _SLIVER
            g = beyond[f, k]
            for j in range(3):
                if width >= _SLIVER and g >= 0 and _side(faces, g, j) == _side(faces, f, k):
                    other, across = _inward(points, faces, g, j)
                    # Two unit vectors, x away from opposite, have a sum of length 2 sin(x / 2).
                    bent = length(add(inward, other)) >= 2.0 * np.sin(0.5 * MIN_ANGLE)
                    shown[k, f] = bent or across < _SLIVER


@kernel
def _find_inward(
    first: int,
    last: int,
    points: np.ndarray,
    faces: np.ndarray,
    face: np.ndarray,
    k: np.ndarray,
    inward: np.ndarray,
) -> None:
    """Fill `_Pieces.inward` (n, 3), of sides (n,) of faces (n,)."""
    for i in range(first, last):
        put(inward, i, _inward(points, faces, face[i], k[i])[0])


@part
def _cells(a: Vec3, b: Vec3, reach: float) -> tuple[float, float, float, float, float, float]:
    """Where the line of a side from a to b is, in cells: sides on one line are less than 1 / `_CELLS` apart in
    each."""
    d = subtract(b, a)
    d = divide(d, length(d))
    middle = scale(0.5, add(a, b))
    wide = 1.0 / (1.01 * _COLLINEAR * _CELLS)  # what is compared is rounded to 0.01 mm
    foot = scale(wide, subtract(middle, scale(dot(middle, d), d)))
    d = scale(math.copysign(wide * reach, dot(d, _GENERIC)), d)
    return d[0], d[1], d[2], foot[0], foot[1], foot[2]


@part
def _place(cell: tuple[float, float, float, float, float, float], near: int, table: np.ndarray) -> int:
    """The row of a table for a cell, or for that next to it along the axes `near`, bit by bit."""
    number = 0
    for axis in range(6):
        whole = math.floor(cell[axis])
        if near >> axis & 1:
            whole += 1 if cell[axis] - whole > 0.5 else -1
        number = (number ^ int(whole)) * 0x1E3779B97F4A7C15
        number ^= number >> 29
    return number & (len(table) - 1)


@kernel
def _drop_alone(
    points: np.ndarray, faces: np.ndarray, beyond: np.ndarray, table: np.ndarray, shown: np.ndarray
) -> float:
    """Take the flags (3, F) from sides that are short, and on whose lines no others are, but for that of the face
    beyond: on a scan few are left. Returns how far any is from the origin, m, and 1; `table` is zero before."""
    reach = 1.0
    for turn in range(3):
        for k in range(3):
            for f in range(len(faces)):
                if not shown[k, f]:
                    continue
                one, other = _side(faces, f, k)
                a, b = row(points, one), row(points, other)
                if turn == 0:
                    reach = max(reach, length(scale(0.5, add(a, b))) + 1.0)
                    continue
                cell = _cells(a, b, reach)
                if turn == 1:
                    place, known = _place(cell, 0, table), False
                    for j in range(3):
                        g = beyond[f, k]
                        known |= 0 <= g < f and shown[j, g] and _side(faces, g, j) == (one, other)
                    table[place] = min(table[place] + (not known), 2)
                    continue
                near = 0
                for axis in range(6):
                    inside = cell[axis] - math.floor(cell[axis])
                    near |= (min(inside, 1.0 - inside) < 1.0 / _CELLS) << axis
                count, some = table[_place(cell, 0, table)], near
                while some > 0:  # all sets of these axes
                    count += table[_place(cell, some, table)]
                    some = (some - 1) & near
                shown[k, f] = count > 1 or length(subtract(b, a)) > 0.9 * _LEAST
    return reach


def _lines(pieces: _Pieces, reach: float) -> list[np.ndarray]:
    """Rows of the pieces on each line that is long enough; no piece is further from the origin, m."""
    if len(pieces.a) == 0:
        return []
    d = pieces.b - pieces.a
    d /= np.linalg.norm(d, axis=1)[:, None]
    d *= np.where(d @ _GENERIC < 0.0, -1.0, 1.0)[:, None]
    foot = 0.5 * (pieces.a + pieces.b)
    foot -= (foot * d).sum(axis=1)[:, None] * d
    whole = np.empty((len(d), 6), np.int64)
    whole[:, :3], whole[:, 3:] = np.rint(d * reach * 1e5), np.rint(foot * 1e5)
    first, row = unique_rows(whole)
    key = whole[first] / 1e5
    near = cKDTree(key).query_pairs(_COLLINEAR, output_type="ndarray")
    collinear = coo_array((np.ones(len(near), np.int8), near.T), shape=(len(key), len(key)))
    line = connected_components(collinear, directed=False)[1][row]
    order = in_order(line)[1]
    start = np.append(0, np.cumsum(np.bincount(line)))
    along = d[order[start[:-1]]][line]
    at = np.stack([(p * along).sum(axis=1) for p in (pieces.a, pieces.b)])
    low = np.minimum.reduceat(at.min(axis=0)[order], start[:-1])
    high = np.maximum.reduceat(at.max(axis=0)[order], start[:-1])
    return [order[start[i] : start[i + 1]] for i in np.flatnonzero(high - low >= _LEAST)]


def _wedges_of_line(pieces: _Pieces, rows: np.ndarray) -> list[Candidate]:
    """The wedges whose edges are on one line, of the pieces `rows`."""
    a, b, inward = (x[rows] for x in pieces)
    ends = np.concatenate([a, b])
    along = b[0] - a[0] if (b[0] - a[0]) @ _GENERIC > 0.0 else a[0] - b[0]
    first, last = ends[(ends @ along).argmin()], ends[(ends @ along).argmax()]
    along = (last - first) / np.linalg.norm(last - first)
    a, b = a - first, b - first
    z = [p @ along for p in (a, b)]
    off = [p - x[:, None] * along for p, x in zip((a, b), z, strict=True)]
    stray = np.sqrt([(v * v).sum(axis=1) for v in off]).max(axis=0)
    near = (stray < 2.0 * _COLLINEAR) & (np.abs(inward @ along) < 0.1)
    if not near.any():
        return []
    inward, margin = inward[near], float(stray[near].max())
    e1 = _cross(along, np.eye(3)[np.abs(along).argmin()])
    e1 /= np.linalg.norm(e1)
    e2 = _cross(along, e1)
    angle = np.round(np.arctan2(inward @ e2, inward @ e1) % (2.0 * np.pi), 11).tolist()
    spans = zip(np.minimum(*z)[near].tolist(), np.maximum(*z)[near].tolist(), angle, strict=True)
    out: list[Candidate] = []
    for run in _runs([_Span(*span) for span in spans]):
        if run.high - run.low >= _LEAST:
            towards = np.cos(run.face) * e1 + np.sin(run.face) * e2
            normal = np.cos(run.face) * e2 - np.sin(run.face) * e1
            at, n = first + run.low * along, round(run.sector / np.pi, 9)
            out.append(Candidate(at, along, run.high - run.low, towards, normal, n, margin))
    return out


class _Span(NamedTuple):
    """From where to where on a line a face meets it, m, and the angle of that face about the line."""

    low: float
    high: float
    angle: float


class _Run(NamedTuple):
    """From where to where on a line there is one wedge, m: the angle of its first face, and the open sector."""

    low: float
    high: float
    face: float
    sector: float


def _runs(spans: list[_Span]) -> list[_Run]:
    """The wedges along a line that faces meet."""
    at = sorted(end for span in spans for end in (span.low, span.high))
    at = at[:1] + [high for low, high in pairwise(at) if high - low > 1e-3]
    runs: list[_Run] = []
    for z0, z1 in pairwise(at):
        middle = 0.5 * (z0 + z1)
        face, sector = _widest([span.angle for span in spans if span.low < middle < span.high])
        if sector < np.pi + MIN_ANGLE:
            continue
        if runs and runs[-1].high == z0 and _same(runs[-1], face, sector):
            runs[-1] = runs[-1]._replace(high=z1)
        else:
            runs.append(_Run(z0, z1, face, sector))
    return runs


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """`np.cross` of two vectors (3,), in a tenth of its time."""
    (a, b, c), (x, y, z) = u.tolist(), v.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def _widest(angles: list[float]) -> tuple[float, float]:
    """(angle at which it starts, its size) of the widest sector between faces at these angles about a line."""
    if not angles:
        return 0.0, 0.0
    angles = sorted(set(angles))
    gaps = [high - low for low, high in pairwise([*angles, angles[0] + 2.0 * np.pi])]
    widest = max(gaps)
    face = angles[gaps.index(widest)]
    return face, widest if 2.0 * np.pi - widest > _SAME_FACE else 2.0 * np.pi


def _same(run: _Run, face: float, sector: float) -> bool:
    apart = (face - run.face + np.pi) % (2.0 * np.pi) - np.pi
    return abs(apart) < _SAME_FACE and abs(sector - run.sector) < _SAME_FACE


@part
def _point_about(wedges: Wedges, e: int, at: Vec3, phi: float) -> Vec3:
    """The point `_STEP` away from a place on an edge, at the angle phi, as far off as rays need."""
    x, y = _STEP * np.cos(phi), _STEP * np.sin(phi)
    f, t, m = wedges.face[e], wedges.normal[e], wedges.offset[e]
    return (
        at[0] + m[0] + x * f[0] + y * t[0],
        at[1] + m[1] + x * f[1] + y * t[1],
        at[2] + m[2] + x * f[2] + y * t[2],
    )


@kernel
def _try_open(
    first: int,
    last: int,
    geometry: Geometry,
    wedges: Wedges,
    wedge: np.ndarray,
    at: np.ndarray,
    is_open: np.ndarray,
) -> None:
    """Flag (m,) places `at` (m, 3) on the edges of `wedge` (m,) where one gets from either face to the bisector,
    `_STEP` away. Nothing may be before a fitted edge's first face, or it is the back of a thin body."""
    for i in range(first, last):
        e = wedge[i]
        half = 0.5 * np.pi * wedges.n[e]
        off, normal = row(wedges.offset, e), row(wedges.normal, e)
        q = _point_about(wedges, e, row(at, i), half)
        is_open[i] = True
        for phi in (np.pi / 6.0, 2.0 * half - np.pi / 6.0):
            if not unoccluded(geometry, _point_about(wedges, e, row(at, i), phi), q):
                is_open[i] = False
        if is_open[i] and length(off) > _ROUGH:
            p = _point_about(wedges, e, row(at, i), np.pi / 6.0)
            near = dot(off, normal) + 0.5 * _STEP - _FITS * length(off)
            is_open[i] = near <= 0.0 or unoccluded(geometry, p, subtract(p, scale(near, normal)))


@kernel
def _try_ends(first: int, last: int, geometry: Geometry, wedges: Wedges, stands: np.ndarray) -> None:
    """Flags (n, 2) of `Wedges.stands`: all about an end, `_STEP` away from the edge, a surface is in the way."""
    for e in range(first, last):
        inset = min(_STEP, 0.25 * wedges.length[e])
        for end in range(2):
            z, sign = (inset, -1.0) if end == 0 else (wedges.length[e] - inset, 1.0)
            outward = scale(sign, row(wedges.along, e))
            stands[e, end] = True
            for share in _AROUND:
                at = _point_about(wedges, e, edge_point(wedges, e, z), share * np.pi * wedges.n[e])
                if cast_ray(geometry, at, outward, inset + _STEP)[1] < 0:
                    stands[e, end] = False


@kernel
def _move_clear(first: int, last: int, geometry: Geometry, wedges: Wedges) -> None:
    """Move `wedges.clear`, which is `offset`, out to `_CLEAR`, where nothing is between: neither at an end, as a
    sloped ceiling, nor along half of the edge."""
    for e in range(first, last):
        off, far_end = row(wedges.offset, e), wedges.length[e]
        far = scale(max(_CLEAR / length(off), 1.0), off)
        out, ends = subtract(far, off), True
        for z in (0.0, far_end):
            at = met_point(wedges, e, z)
            ends &= in_sight(geometry, at, add(at, out))
        count, free = int(np.ceil(far_end / _STEP)), 0
        for k in range(count):
            at = clear_point(wedges, e, (k + 0.5) / count * far_end)
            free += in_sight(geometry, at, add(at, out))
        if ends and 2 * free > count:
            put(wedges.clear, e, far)


def _open_parts(scene: Scene, wedges: Wedges) -> Wedges:
    """The parts of wedges that no other surface closes, if they are long enough."""
    count = np.maximum(np.ceil(wedges.length / _STEP).astype(int), 1)
    if count.sum() > _MOST_STEPS:
        raise SceneError(
            f"{scene.name}: edges round which sound bends are {wedges.length.sum() / 1e3:,.0f} km long in all, "
            f"where {_MOST_STEPS * _STEP / 1e3:,.0f} km is the most; check the unit, or turn diffraction off"
        )
    wedge = np.repeat(np.arange(len(count)), count)
    begin = np.cumsum(count) - count
    z = (np.arange(len(wedge)) - begin[wedge] + 0.5) * (wedges.length / count)[wedge]
    at = wedges.start[wedge] + z[:, None] * wedges.along[wedge]
    is_open = np.zeros(len(wedge), np.bool_)
    over_rows(_try_open, len(wedge), scene.geometry, wedges, wedge, at, is_open)
    kept, z0, z1 = [], [], []
    for e in range(len(count)):
        flags = is_open[begin[e] : begin[e] + count[e]]
        if np.linalg.norm(wedges.offset[e]) > _ROUGH:
            from scipy.ndimage import binary_closing  # drawn meshes do without it

            flags = binary_closing(flags, iterations=2) | flags
        change = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
        for low, high in change.reshape(-1, 2):
            kept.append(e)
            z0.append(wedges.length[e] * low / count[e])
            z1.append(wedges.length[e] * high / count[e])
    low_z, high_z = np.array(z0), np.array(z1)
    rows = np.array(kept, np.int64)
    start = wedges.start[rows] + low_z[:, None] * wedges.along[rows] if len(rows) else wedges.start[:0]
    cut = Wedges(*(column[rows] for column in wedges))._replace(start=start, length=high_z - low_z)
    return Wedges(*(column[cut.length >= _LEAST] for column in cut))
