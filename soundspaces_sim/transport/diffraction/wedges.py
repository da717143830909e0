"""Edges that bend sound: the convex creases and the free borders of a mesh, found once per scene.

A piece of a triangle's side that lies on a common straight line with others is taken together with them, whatever
triangles it belongs to: so a wall may be tessellated in any way, and the two walls of a corner in different ones.
Along a line the faces that meet there leave sectors open between them; sound goes round a line whose widest
sector is more than 180 degrees plus a threshold (a border: 360). What is flat, what is short, and what another
surface closes (the foot of a partition, the back of a cupboard at a wall) is left out.

Host code (numpy), but for the rays that find out what is closed.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.scene.rays.geometry import visible
from soundspaces_sim.scene.scene import Scene

LEAST_TURN = np.deg2rad(20.0)  # between two faces: less is flat
LEAST_LENGTH = 0.3  # m
_WELD = 4  # decimals of a metre
_COLLINEAR = 0.002  # m, how far pieces of one edge stray from its line
_SLIVER = _COLLINEAR  # m; a narrower triangle has no direction, and a thinner plate is one face
_ALIKE = np.deg2rad(5.0)  # between faces that are one
_STEP = 0.05  # m, along an edge and away from it, at which it is tried whether it is open
_GENERIC = np.array([0.62348980, 0.78183148, 0.43388374])  # no edge is likely to be normal to it


class Edges(NamedTuple):
    """E straight edges, their coordinates relative to the scene's centre.

    A point's coordinates about an edge: z along it from its start; the angle from its first face, counted
    through the open sector, 0 to `wedge` * pi at the second face.
    """

    start: np.ndarray  # (E, 3) m
    along: np.ndarray  # (E, 3) unit
    length: np.ndarray  # (E,) m
    face: np.ndarray  # (E, 3) unit, in the first face, away from the edge
    turn: np.ndarray  # (E, 3) unit, 90 degrees from `face` towards the open sector
    wedge: np.ndarray  # (E,) open sector / pi, 1 to 2
    lift: np.ndarray  # (E, 3) m, from the edge to where rays just clear it


def no_edges() -> Edges:
    """None."""
    v, s = np.empty((0, 3)), np.empty(0)
    return Edges(v, v, s, v, v, s, v)


def find_edges(scene: Scene) -> Edges:
    """The edges of a scene, by length."""
    pieces = _pieces(scene.vertices - scene.center, scene.faces)
    rows = [row for line in _lines(pieces) for row in _edges_of_line(pieces, line)]
    if not rows:
        return no_edges()
    margin = np.array([r[-1] for r in rows])
    start, along, face, turn = (np.array([r[k] for r in rows]) for k in (0, 1, 3, 4))
    length, wedge = np.array([r[2] for r in rows]), np.array([r[5] for r in rows])
    half = 0.5 * np.pi * wedge[:, None]
    bisector = np.cos(half) * face + np.sin(half) * turn
    lift = (scene.geometry.epsilon + margin + 10.0**-_WELD)[:, None] * bisector
    edges = _open_parts(scene, Edges(start, along, length, face, turn, wedge, lift))
    order = np.lexsort((*edges.start.T, -edges.length))
    return Edges(*(np.ascontiguousarray(column[order]) for column in edges))


class Links(NamedTuple):
    """Edges that see each other: rows start[e]:start[e + 1] are those of edge e, and each pair of edges has two."""

    start: np.ndarray  # (E + 1,)
    edge: np.ndarray  # (n,) the other one, ascending
    there: np.ndarray  # (n, 2) angles about e of the other one's two ends, the smaller first
    twin: np.ndarray  # (n,) the pair's other row


_BLOCK = 64  # edges that look at all others at a time
_PLACES = np.array([[0.5, 0.5], [0.25, 0.25], [0.75, 0.75], [0.25, 0.75], [0.75, 0.25]])


def find_links(scene: Scene, edges: Edges) -> Links:
    """Which edges see each other, at some place of each."""
    count = len(edges.length)
    rows, found, angles = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty((0, 2))]
    for begin in range(0, count if count > 1 else 0, _BLOCK):
        n = min(_BLOCK, count - begin)
        seen, angle = np.zeros((n, count), np.bool_), np.empty((n, count, 2))
        over_rows(_link, n, scene.geometry, edges, begin, seen, angle)
        i, f = np.nonzero(seen)
        rows.append(begin + i)
        found.append(f)
        angles.append(angle[i, f])
    edge, other = np.concatenate(rows), np.concatenate(found)
    start = np.searchsorted(edge, np.arange(count + 1))
    # rows are by (edge, other), and every pair is there twice: by (other, edge) they are each other's twins
    return Links(start, other, np.concatenate(angles), np.lexsort((edge, other)))


@part
def _angle(edges, e, point):
    """Angle of a point about edge e, from its first face; just behind that face, a little below zero."""
    s, f, t = edges.start[e], edges.face[e], edges.turn[e]
    vx, vy, vz = point[0] - s[0], point[1] - s[1], point[2] - s[2]
    angle = math.atan2(vx * t[0] + vy * t[1] + vz * t[2], vx * f[0] + vy * f[1] + vz * f[2])
    return angle if angle > -_ALIKE else angle + 2.0 * math.pi


@part
def _sector(edges, e, f):
    """(Smaller, larger) angle about edge e of the ends of edge f."""
    s, a, z = edges.start[f], edges.along[f], edges.length[f]
    one = _angle(edges, e, (s[0], s[1], s[2]))
    other = _angle(edges, e, (s[0] + z * a[0], s[1] + z * a[1], s[2] + z * a[2]))
    return min(one, other), max(one, other)


@kernel
def _link(first, last, geometry, edges, begin, seen, angle):
    """Flags `seen` (n, E) of edges from `begin` on; `angle` (n, E, 2): see `Links`. Rays go from the edge of the
    smaller number, so that both rows of a pair find the same."""
    for i in range(first, last):
        e = begin + i
        for f in range(len(edges.length)):
            if e == f:
                continue
            there, back = _sector(edges, e, f), _sector(edges, f, e)
            if (
                there[0] > math.pi * edges.wedge[e] + _ALIKE
                or back[0] > math.pi * edges.wedge[f] + _ALIKE
            ):
                continue
            # to bend into the shadow at both, each must be far round from some face of the other
            if max(there[1], math.pi * edges.wedge[e] - there[0]) <= math.pi:
                continue
            if max(back[1], math.pi * edges.wedge[f] - back[0]) <= math.pi:
                continue
            angle[i, f, 0], angle[i, f, 1] = there
            one, two = min(e, f), max(e, f)
            s, a, m = edges.start[one], edges.along[one], edges.lift[one]
            t, b, n = edges.start[two], edges.along[two], edges.lift[two]
            for k in range(len(_PLACES)):
                u, v = _PLACES[k, 0] * edges.length[one], _PLACES[k, 1] * edges.length[two]
                if visible(
                    geometry, s[0] + u * a[0] + m[0], s[1] + u * a[1] + m[1], s[2] + u * a[2] + m[2],
                    t[0] + v * b[0] + n[0], t[1] + v * b[1] + n[1], t[2] + v * b[2] + n[2],
                ):  # fmt: skip
                    seen[i, f] = True
                    break


class _Pieces(NamedTuple):
    """Sides of triangles that are no part of a flat wall."""

    a: np.ndarray  # (n, 3) m
    b: np.ndarray  # (n, 3)
    inward: np.ndarray  # (n, 3) unit, in the triangle, normal to the side


def _pieces(vertices: np.ndarray, faces: np.ndarray) -> _Pieces:
    used, faces = np.unique(faces, return_inverse=True)
    rounded = np.round(vertices[used], _WELD)
    first, row = unique_rows(rounded)
    points, faces = rounded[first], row[faces.reshape(-1, 3)]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    ends = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    third = np.concatenate([faces[:, (k + 2) % 3] for k in range(3)])
    ends = np.sort(ends, axis=1)
    a, b = points[ends[:, 0]], points[ends[:, 1]]
    inward = points[third] - a
    inward -= ((inward * (b - a)).sum(axis=1) / ((b - a) ** 2).sum(axis=1))[:, None] * (b - a)
    width = np.linalg.norm(inward, axis=1)
    inward /= np.maximum(width, 1e-300)[:, None]
    number = ends[:, 0] * len(points) + ends[:, 1]
    _, side, count = np.unique(number, return_inverse=True, return_counts=True)
    total = np.stack([np.bincount(side, w, len(count)) for w in inward.T], axis=1)
    # Two unit vectors that turn by x from opposite ones have a sum of length 2 sin(x / 2).
    flat = (count == 2) & (np.linalg.norm(total, axis=1) < 2.0 * np.sin(0.5 * LEAST_TURN))
    flat[side[width < _SLIVER]] = False
    keep = ~flat[side] & (width >= _SLIVER)
    return _Pieces(a[keep], b[keep], inward[keep])


def _lines(pieces: _Pieces) -> list[np.ndarray]:
    """Rows of the pieces on each line that is long enough."""
    if len(pieces.a) == 0:
        return []
    d = pieces.b - pieces.a
    d /= np.linalg.norm(d, axis=1)[:, None]
    d *= np.where(d @ _GENERIC < 0.0, -1.0, 1.0)[:, None]
    middle = 0.5 * (pieces.a + pieces.b)
    foot = middle - (middle * d).sum(axis=1)[:, None] * d
    reach = np.linalg.norm(middle, axis=1).max() + 1.0
    key = np.round(np.concatenate([d * reach, foot], axis=1), 5)
    first, row = unique_rows(key)
    key = key[first]
    near = cKDTree(key).query_pairs(_COLLINEAR, output_type="ndarray")
    links = coo_array((np.ones(len(near), np.int8), near.T), shape=(len(key), len(key)))
    line = connected_components(links, directed=False)[1][row]
    order = np.argsort(line, kind="stable")
    start = np.searchsorted(line[order], np.arange(line.max() + 2))
    along = d[order[start[:-1]]][line]
    at = np.stack([(p * along).sum(axis=1) for p in (pieces.a, pieces.b)])
    low = np.minimum.reduceat(at.min(axis=0)[order], start[:-1])
    high = np.maximum.reduceat(at.max(axis=0)[order], start[:-1])
    return [order[start[i] : start[i + 1]] for i in np.flatnonzero(high - low >= LEAST_LENGTH)]


_Row = tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray, float, float]


def _edges_of_line(pieces: _Pieces, rows: np.ndarray) -> list[_Row]:
    """(start, along, length, face, turn, wedge, margin) of the edges on one line."""
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
    spans = list(zip(np.minimum(*z)[near].tolist(), np.maximum(*z)[near].tolist(), angle, strict=True))
    at = sorted(end for span in spans for end in span[:2])
    at = at[:1] + [high for low, high in pairwise(at) if high - low > 1e-3]
    runs: list[list[float]] = []  # from, to, first face, open angle
    for z0, z1 in pairwise(at):
        middle = 0.5 * (z0 + z1)
        face, sector = _widest([x for low, high, x in spans if low < middle < high])
        if sector < np.pi + LEAST_TURN:
            continue
        if runs and runs[-1][1] == z0 and _same(runs[-1], face, sector):
            runs[-1][1] = z1
        else:
            runs.append([z0, z1, face, sector])
    out: list[_Row] = []
    for z0, z1, face, sector in runs:
        if z1 - z0 >= LEAST_LENGTH - 1e-9:
            towards = np.cos(face) * e1 + np.sin(face) * e2
            turn = np.cos(face) * e2 - np.sin(face) * e1
            out.append(
                (first + z0 * along, along, z1 - z0, towards, turn, round(sector / np.pi, 9), margin)
            )
    return out


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
    return face, widest if 2.0 * np.pi - widest > _ALIKE else 2.0 * np.pi


def _same(run: list[float], face: float, sector: float) -> bool:
    turned = (face - run[2] + np.pi) % (2.0 * np.pi) - np.pi
    return abs(turned) < _ALIKE and abs(sector - run[3]) < _ALIKE


@kernel
def _try_open(first, last, geometry, at, face, turn, wedge, lift, open_):
    """Flag (n,) places `at` (n, 3) on edges where one gets from either face to the bisector, `_STEP` away."""
    for i in range(first, last):
        half = 0.5 * np.pi * wedge[i]
        open_[i] = True
        for angle in (np.pi / 6.0, 2.0 * half - np.pi / 6.0):
            x, y = _STEP * np.cos(angle), _STEP * np.sin(angle)
            u, v = _STEP * np.cos(half), _STEP * np.sin(half)
            f, t, s, m = face[i], turn[i], at[i], lift[i]
            if not visible(
                geometry,
                s[0] + m[0] + x * f[0] + y * t[0],
                s[1] + m[1] + x * f[1] + y * t[1],
                s[2] + m[2] + x * f[2] + y * t[2],
                s[0] + m[0] + u * f[0] + v * t[0],
                s[1] + m[1] + u * f[1] + v * t[1],
                s[2] + m[2] + u * f[2] + v * t[2],
            ):
                open_[i] = False


def _open_parts(scene: Scene, edges: Edges) -> Edges:
    """The parts of edges that no other surface closes, if they are long enough."""
    count = np.maximum(np.ceil(edges.length / _STEP).astype(int), 1)
    edge = np.repeat(np.arange(len(count)), count)
    begin = np.cumsum(count) - count
    z = (np.arange(len(edge)) - begin[edge] + 0.5) * (edges.length / count)[edge]
    at = edges.start[edge] + z[:, None] * edges.along[edge]
    open_ = np.zeros(len(edge), np.bool_)
    over_rows(
        _try_open, len(edge), scene.geometry, at, edges.face[edge], edges.turn[edge], edges.wedge[edge],
        edges.lift[edge], open_,
    )  # fmt: skip
    kept, z0, z1 = [], [], []
    for e in range(len(count)):
        flags = open_[begin[e] : begin[e] + count[e]]
        change = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
        for low, high in change.reshape(-1, 2):
            kept.append(e)
            z0.append(edges.length[e] * low / count[e])
            z1.append(edges.length[e] * high / count[e])
    low_z, high_z = np.array(z0), np.array(z1)
    rows = np.array(kept, np.int64)
    start = edges.start[rows] + low_z[:, None] * edges.along[rows] if len(rows) else edges.start[:0]
    cut = Edges(*(column[rows] for column in edges))._replace(start=start, length=high_z - low_z)
    return Edges(*(column[cut.length >= LEAST_LENGTH - 1e-9] for column in cut))
