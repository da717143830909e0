"""Scattering by finite size: what flat surfaces that end scatter by diffraction, whatever they are made of.

A wave that a flat piece of surface reflects spreads beyond the geometric beam, the more the smaller the piece is
against the Fresnel zone. Along one direction of the piece, with its ends at distances x1 and x2 from the point of
incidence, the energy of a specular reflection is multiplied by (Kirchhoff's approximation; Rindel 1986, Attenuation
of sound reflections due to diffraction, Nordic Acoustical Meeting)

    K = |F(v1) + F(v2)|² / 2,   v = x sqrt(2 / (lambda a)),   a = d1 d2 / (d1 + d2),

F Fresnel's integral, d1 and d2 the legs before and after, and x as seen along the sound: in the plane of incidence
times the cosine of the angle. The two directions are those of the piece's outline. Fresnel diffraction conserves
energy: what K lacks, over all points of a piece, is found outside the beam,

    I(t) = |F(u + t) - F(t)|² / 2   at t beyond either end of a beam u wide.

K has fringes and exceeds one here and there. So what a point at t from an end loses is taken to be I(t), what
that end sends to the mirrored point outside (a quarter at the end itself), and what goes farther than u is lost
by all points alike: the same mean over the piece, and never less than nothing. Christensen & Rindel (2005, A new
scattering method that combines roughness and diffraction effects, Forum Acusticum) use limits of the same
formula: K = f / f_w below f_w = c a / (w cos)², and a loss near edges that falls with the distance.

K depends on the legs; the weights of path techniques and reciprocity need a scattering that is a property of the
point. So it is averaged, once per scene, over diffuse incidence on the piece: points evenly on it, directions of
random incidence, legs as long as rays find them to be. A path then takes a piece's mean instead of its own K.

Only free ends count: where another surface stands on this one, what is missing comes as the reflection off both (in
a corner of 90 degrees exactly), as if the piece went on as its mirror image. A fold of less than 20 degrees is no
end; 30 degrees in all are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import fresnel

from soundspaces_sim.core.numerics.bands import log_edges
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rows import in_order, unique_rows
from soundspaces_sim.core.numerics.vec3 import (
    Vec3,
    along,
    cross,
    distance,
    dot,
    negate,
    normalize,
    reflect,
    row,
    scale,
)
from soundspaces_sim.scene.rays.directions import sample_cosine_hemisphere
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray, surface_point
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import longest_edges, middles, side_numbers, welded_faces
from soundspaces_sim.transport.arrivals.find_wedges import MIN_ANGLE

_CELL = 0.8  # m: smaller triangles are taken together, cell by cell
_LEAST, _MOST, _PER_AREA = 32, 256, 8.0  # hits on either side of a piece; 1/m²
_FEW = 0.25  # of these: a side with fewer of them between surfaces is left out
_LIFT = 0.02  # m: a lower step is none
# m: steps along a surface grow with the distance, as the weight of its end falls.
_FIRST, _GROWTH = 0.04, 1.5
_FINE = 0.01  # m to which an end is found
_FARTHEST = 10.0  # m
_STEPS = 96  # at most, on uneven ground
_SLOPE = float(np.cos(MIN_ANGLE))
_SLOPE_IN_ALL = float(np.cos(np.deg2rad(30.0)))
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
_ENDLESS, _WIDE = 1e6, 20.0  # in units of v: as good as no end; where less than 0.0004 goes farther
_AT_A_TIME = 16384  # hits, whose numbers stay in a cache
_LEVELS = 64  # to which shares are rounded, so that few kinds of surface need to be told apart
# Additive recurrence in five dimensions (Roberts 2018).
_SHIFTS = (0.8567, 0.7339, 0.6287, 0.5386, 0.4614)


def size_scattering(scene: Scene, edges: Sequence[float], c: float) -> np.ndarray:
    """(F, B) share of what a face reflects that its ends scatter, in bands of these `edges`, Hz; `c` in m/s.

    Of the sides that sound reaches: the mean of two that are alike, else the larger one (the inside of a body has
    no ends).
    """
    piece = _pieces(scene)
    count = int(piece.max()) + 1
    of, hits = _hits(scene, piece)
    share = np.zeros((2, count, len(edges) - 1))
    for side in range(2):
        rows = np.full((len(of), 5), np.nan)
        over_rows(_measure, len(of), scene.geometry, hits, 1.0 if side == 0 else -1.0, rows)
        valid = np.isfinite(rows[:, 4])
        lost = 1.0 - kept_in_beam(rows[valid], edges, c)
        valid_hits = np.bincount(of[valid], minlength=count)
        enough = valid_hits >= _FEW * np.bincount(of, minlength=count)
        for band in range(lost.shape[1]):
            mean = np.bincount(of[valid], lost[:, band], count) / np.maximum(valid_hits, 1)
            share[side, :, band] = np.where(enough, mean, 0.0)
    larger, smaller = share.max(axis=0), share.min(axis=0)
    alike = (smaller.sum(axis=1) > 0.5 * larger.sum(axis=1))[:, None]
    both = np.where(alike, share.mean(axis=0), larger)
    rounded = np.round(np.clip(both, 0.0, 1.0) * _LEVELS) / _LEVELS
    return np.asarray(rounded[piece])


def kept_in_beam(rows: np.ndarray, edges: Sequence[float], c: float) -> np.ndarray:
    """(n, B) energy that a hit keeps in the beam, means over log frequency.

    `rows` (n, 5), m: distances to two ends in one direction, as sound sees them, infinite where there is none; to
    those in the other direction; and a.
    """
    low, high = np.log(log_edges(edges))[:-1], np.log(log_edges(edges))[1:]
    frequency = np.exp(0.5 * (low + high)[:, None] + 0.5 * (high - low)[:, None] * _NODES)
    out = np.zeros((len(rows), len(low)))
    over_rows(_keep, len(rows), rows, frequency, c, out, chunk=_AT_A_TIME)
    return out


def _keep(
    first: int, last: int, rows: np.ndarray, frequency: np.ndarray, c: float, out: np.ndarray
) -> None:
    """Fill rows `first` to `last` of `out` (n, B): see `kept_in_beam`; `frequency` (B, nodes) in Hz."""
    rows, out = rows[first:last], out[first:last]
    ends = [np.flatnonzero(np.isfinite(rows[:, k : k + 2]).any(axis=1)) for k in (0, 2)]
    endless = _kept(np.array([np.inf]), np.array([np.inf]))
    for band, node in np.ndindex(frequency.shape):
        weight = 0.5 * _WEIGHTS[node]
        scale = np.sqrt(2.0 * frequency[band, node] / (c * rows[:, 4]))
        kept = np.tile(endless, (2, len(rows)))
        for k, some in enumerate(ends):
            v = rows[some, 2 * k : 2 * k + 2] * scale[some, None]
            kept[k, some] = _kept(v[:, 0], v[:, 1])
        out[:, band] += weight * kept[0] * kept[1]


def _outside(u: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Energy at t beyond the end of a beam u wide, over that within an endless one."""
    (s0, c0), (s1, c1) = fresnel(t), fresnel(u + t)
    return np.asarray(0.5 * ((c1 - c0) ** 2 + (s1 - s0) ** 2))


def _kept(v1: np.ndarray, v2: np.ndarray) -> np.ndarray:
    """Energy that a hit keeps, with the ends of the piece at v1 and v2."""
    one, two = np.minimum(v1, _ENDLESS), np.minimum(v2, _ENDLESS)
    u = one + two
    widths, farther = _farther()
    shared = np.where(u < widths[-1], np.interp(np.log(u), np.log(widths), farther), 0.0)
    return np.asarray(1.0 - _outside(u, one) - _outside(u, two) - shared)


@cache
def _farther() -> tuple[np.ndarray, np.ndarray]:
    """Widths u of a beam, and the part of its energy that goes farther than u beyond its ends."""
    widths = np.geomspace(1e-4, _WIDE, 400)
    x, weight = np.polynomial.legendre.leggauss(400)
    at = 0.5 * widths[:, None] * (1.0 + x)
    s, c = fresnel(at)
    s2, c2 = fresnel(widths[:, None] - at)
    within = 0.5 * ((c + c2) ** 2 + (s + s2) ** 2) + 2.0 * _outside(widths[:, None], at)
    return widths, np.maximum(1.0 - 0.5 * within @ weight, 0.0)


def _pieces(scene: Scene) -> np.ndarray:
    """(F,) number of the piece of each face: large ones by themselves, small ones by cell and main direction."""
    corners = scene.corners - scene.center
    axis = np.abs(scene.normals).argmax(axis=1)
    rows = np.arange(len(axis))
    lattice = np.floor(middles(corners) / _CELL + 0.381966).astype(np.int64)
    small = longest_edges(corners) < _CELL**2
    own = np.where(small, -1, rows)
    lattice[~small] = 0
    key = np.column_stack([own, axis, scene.normals[rows, axis] > 0.0, lattice])
    key[~small, 1:3] = 0
    return unique_rows(key)[1]


def outlines(scene: Scene) -> np.ndarray:
    """(F, 3) unit vectors in the faces along the outline of the flat surface that each is of, or normal to it."""
    points, faces = welded_faces(scene.vertices - scene.center, scene.faces, 4)
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    face = np.repeat(np.arange(len(faces)), 3)
    side = side_numbers(faces).ravel()
    count, order = np.bincount(side), in_order(side)[1]
    pair = order[(np.cumsum(count) - count)[count == 2][:, None] + [0, 1]]
    one, other = face[pair].T
    flat = np.abs((scene.normals[one] * scene.normals[other]).sum(axis=1)) > _SLOPE
    one, other, inner = one[flat], other[flat], pair[flat]
    adjacency = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(len(faces), len(faces)))
    surface = connected_components(adjacency, directed=False)[1]
    first = np.unique(surface, return_index=True)[1]
    normal = scene.normals[first]
    u = _tangents(normal)
    v = np.cross(normal, u)
    outer = np.ones(len(ends), bool)
    outer[inner.ravel()] = False
    along = points[ends[outer, 1]] - points[ends[outer, 0]]
    own = surface[face[outer]]
    length = np.linalg.norm(along, axis=1)
    angle = np.arctan2((along * v[own]).sum(axis=1), (along * u[own]).sum(axis=1))
    oriented = [np.bincount(own, length * f(4.0 * angle), len(first)) for f in (np.cos, np.sin)]
    mean = 0.25 * np.arctan2(oriented[1], oriented[0])[:, None]  # four directions count as one
    axis = (np.cos(mean) * u + np.sin(mean) * v)[surface]
    axis -= (axis * scene.normals).sum(axis=1)[:, None] * scene.normals
    size = np.linalg.norm(axis, axis=1)[:, None]
    some = size > 0.5  # else the surface is round, and has no outline to speak of
    return np.where(some, axis / np.where(some, size, 1.0), _tangents(scene.normals))


def _tangents(normals: np.ndarray) -> np.ndarray:
    """(n, 3) some unit vector at a right angle to each."""
    u = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    return np.asarray(u / np.linalg.norm(u, axis=1)[:, None])


def _hits(scene: Scene, piece: np.ndarray) -> tuple[np.ndarray, _Hits]:
    """Points evenly on every piece: (n,) their pieces, and they."""
    area = np.bincount(piece, scene.areas)
    count = np.clip(np.ceil(_PER_AREA * area), _LEAST, _MOST).astype(np.int64)
    of = np.repeat(np.arange(len(count)), count)
    index = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
    u = (index[:, None] + 0.5) * np.array(_SHIFTS) + of[:, None] * np.sqrt(2.0) * np.arange(1, 6)
    u -= np.floor(u)
    order = in_order(piece)[1]
    upto = np.cumsum(scene.areas[order])
    before = np.concatenate([[0.0], np.cumsum(area)])
    wanted = before[of] + (index + u[:, 0]) / count[of] * area[of]
    nearest = np.minimum(np.searchsorted(upto, wanted), len(order) - 1)
    first = np.searchsorted(piece[order], of)
    last = np.searchsorted(piece[order], of, "right") - 1
    face = order[np.clip(nearest, first, last)]
    root = np.sqrt(u[:, 1:2])
    a, b, c = (scene.corners[face] - scene.center).transpose(1, 0, 2)
    at = (1.0 - root) * a + root * (1.0 - u[:, 2:3]) * b + root * u[:, 2:3] * c
    columns = at, face, outlines(scene)[face], u[:, 3:]
    return of, _Hits(*(np.ascontiguousarray(column) for column in columns))


class _Hits(NamedTuple):
    """n points of pieces, and the outline's direction and numbers for a direction of incidence there."""

    at: np.ndarray  # (n, 3) m
    face: np.ndarray  # (n,)
    axis: np.ndarray  # (n, 3) unit, in the face
    numbers: np.ndarray  # (n, 2) uniform in [0, 1)


@kernel
def _measure(
    first: int, last: int, geometry: Geometry, hits: _Hits, side: float, rows: np.ndarray
) -> None:
    """Fill rows (n, 5), see `kept_in_beam`, of hits on one side (1 or -1); NaN where sound comes from, or goes,
    nowhere."""
    for i in range(first, last):
        normal = scale(side, row(geometry.normal, hits.face[i]))
        at = row(hits.at, i)
        d = sample_cosine_hemisphere(normal, hits.numbers[i, 0], hits.numbers[i, 1])
        origin = along(at, geometry.epsilon, normal)
        d1, _ = cast_ray(geometry, origin, d, np.inf)
        d2, _ = cast_ray(geometry, origin, reflect(negate(d), normal), np.inf)
        if not (0.0 < d1 < np.inf and 0.0 < d2 < np.inf):  # zero: it is on another face's edge
            continue
        u = row(hits.axis, i)
        v = cross(normal, u)
        rows[i, 0], rows[i, 1] = _ends(geometry, at, normal, u, dot(u, d))
        rows[i, 2], rows[i, 3] = _ends(geometry, at, normal, v, dot(v, d))
        rows[i, 4] = d1 * d2 / (d1 + d2)


@part
def _ends(
    geometry: Geometry, at: Vec3, normal: Vec3, direction: Vec3, cos: float
) -> tuple[float, float]:
    """Distances to the ends ahead and behind, as sound that comes at this cosine to them sees them, m; a piece goes
    on as its mirror image where another one stands on it."""
    x, free_x = _follow(geometry, at, normal, direction)
    y, free_y = _follow(geometry, at, normal, negate(direction))
    across = math.sqrt(max(1.0 - cos * cos, 0.0))
    if free_x and free_y:
        return x * across, y * across
    if free_x:
        return x * across, (x + 2.0 * y) * across
    if free_y:
        return (y + 2.0 * x) * across, y * across
    return np.inf, np.inf


@part
def _follow(geometry: Geometry, start: Vec3, up: Vec3, direction: Vec3) -> tuple[float, bool]:
    """How far a surface goes on, m, and whether it ends there in the open; infinite beyond `_FARTHEST`."""
    at, normal, ahead = start, up, direction
    gone, step, growth = 0.0, _FIRST, _GROWTH
    for _ in range(_STEPS):
        if gone >= _FARTHEST:
            break
        lifted, towards = along(at, _LIFT, normal), ahead
        t, triangle = cast_ray(geometry, lifted, ahead, step)
        rising = triangle >= 0
        if not rising:
            lifted, towards = along(lifted, step, ahead), negate(normal)
            t, triangle = cast_ray(geometry, lifted, towards, 2.0 * _LIFT)
        if triangle >= 0:
            x, n = surface_point(geometry, triangle, lifted, towards, t)
            if dot(n, normal) > _SLOPE and dot(n, up) > _SLOPE_IN_ALL:  # it goes on
                gone, step = gone + distance(x, at), step * growth
                at, normal = x, n
                k = dot(ahead, n)
                ahead = normalize((ahead[0] - k * n[0], ahead[1] - k * n[1], ahead[2] - k * n[2]))
                continue
            if rising or dot(n, direction) < 0.0:  # something stands on it
                return gone + (t if rising else step), False
        if step <= _FINE:
            return gone + 0.5 * step, True
        step, growth = 0.5 * step, 1.0
    return np.inf, False
