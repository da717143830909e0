"""Scattering by size: what surfaces that end scatter by diffraction, whatever they are made of.

A wave that a flat piece of surface reflects spreads beyond the geometric beam, the more the smaller the piece is
against the Fresnel zone. Along one direction of the piece, with the ends at distances x1 and x2 from the hit, the
energy of a mirror reflection is multiplied by (Kirchhoff's approximation; Rindel 1986)

    K = |F(v1) + F(v2)|² / 2,   v = x sqrt(2 / (lambda a)),   a = d1 d2 / (d1 + d2),

F Fresnel's integral, d1 and d2 the legs before and after, and x as seen along the sound: in the plane of
incidence times the cosine of the angle. The two directions are those of the piece's outline. Fresnel diffraction
conserves energy: what K lacks, over all hits on a piece, is found outside the beam, I(t) = |F(u + t) - F(t)|² / 2
at t beyond either end of a beam u wide. K has fringes and exceeds one here and there. So what a hit at t from an
end loses is taken to be I(t), what that end sends to the mirror place outside (a quarter at the end itself), and
what goes farther than u is lost by all hits alike: the same mean over the piece, and never less than nothing.
Christensen & Rindel (2005) use limits of the same formula: K = f / f_w below f_w = c a / (w cos)², and a loss
near edges that falls with the distance.

K hangs on the legs; the weights of path techniques and reciprocity want a scattering that is a property of the
place. So it is averaged, once per scene, as diffuse sound meets the piece: places evenly on it, directions at
random incidence, legs as long as rays find them to be. A path then takes a piece's mean instead of its own K.

Only free ends count: where another surface stands on this one, what is missing comes as the reflection off both
(in a corner of 90 degrees exactly), as if the piece went on as its mirror image. A bend of less than 20 degrees is
no end; 30 degrees in all are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import fresnel

from soundspaces_sim.core.numerics.bands import log_edges
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.scene.rays.directions import reflect, sample_cosine
from soundspaces_sim.scene.rays.geometry import cast, hit_point
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import longest_edges, welded
from soundspaces_sim.transport.diffraction.find_wedges import MIN_ANGLE

_CELL = 0.8  # m: smaller triangles are looked at together, cell by cell
_LEAST, _MOST, _PER_AREA = 32, 256, 8.0  # hits on either side of a piece; 1/m²
_FEW = 0.25  # of these: with fewer between surfaces a side does not count
_LIFT = 0.02  # m: a lower step is none
_FIRST, _GROWTH = (
    0.04,
    1.5,
)  # m: steps along a surface grow with the distance, as the weight of its end falls
_FINE = 0.01  # m to which an end is found
_FARTHEST = 10.0  # m
_STEPS = 96  # at most, on uneven ground
_SLOPE = float(np.cos(MIN_ANGLE))
_TURN = float(np.cos(np.deg2rad(30.0)))
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
_ENDLESS, _WIDE = 1e6, 20.0  # in units of v: as good as no end; where less than 0.0004 goes farther
_AT_A_TIME = 16384  # hits, whose numbers stay in a cache
_LEVELS = 64  # to which shares are rounded, so that few kinds of surface need to be told apart
_SHIFTS = (
    0.8567,
    0.7339,
    0.6287,
    0.5386,
    0.4614,
)  # additive recurrence in five dimensions (Roberts 2018)


def size_scattering(scene: Scene, edges: Sequence[float], c: float) -> np.ndarray:
    """(F, B) share of what a face reflects that its ends scatter, in bands of these `edges`, Hz; `c` in m/s.

    Of the sides off which sound comes back: the mean of two that are alike, else the larger one (the inside of a
    body has no ends).
    """
    piece = _pieces(scene)
    count = int(piece.max()) + 1
    of, face, place, numbers = _hits(scene, piece)
    axis = np.ascontiguousarray(outlines(scene)[face])
    share = np.zeros((2, count, len(edges) - 1))
    for side in range(2):
        rows = np.full((len(of), 5), np.nan)
        over_rows(
            _look, len(of), scene.geometry, place, face, axis, numbers, 1.0 if side == 0 else -1.0, rows
        )
        valid = np.isfinite(rows[:, 4])
        lost = 1.0 - kept_in_beam(rows[valid], edges, c)
        hits, all_ = np.bincount(of[valid], minlength=count), np.bincount(of, minlength=count)
        for band in range(lost.shape[1]):
            mean = np.bincount(of[valid], lost[:, band], count) / np.maximum(hits, 1)
            share[side, :, band] = np.where(hits >= _FEW * all_, mean, 0.0)
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
    lattice = np.floor(corners.mean(axis=1) / _CELL + 0.381966).astype(np.int64)
    small = longest_edges(corners) < _CELL**2
    own = np.where(small, -1, rows)
    lattice[~small] = 0
    key = np.column_stack([own, axis, scene.normals[rows, axis] > 0.0, lattice])
    key[~small, 1:3] = 0
    return unique_rows(key)[1]


def outlines(scene: Scene) -> np.ndarray:
    """(F, 3) unit vectors in the faces along the outline of the flat surface that each is of, or normal to it."""
    points, faces = welded(scene.corners - scene.center, 4)
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    face = np.repeat(np.arange(len(faces)), 3)
    low, high = np.sort(ends, axis=1).T
    _, side, count = np.unique(low * len(points) + high, return_inverse=True, return_counts=True)
    order = np.argsort(side, kind="stable")
    pair = order[(np.cumsum(count) - count)[count == 2][:, None] + [0, 1]]
    one, other = face[pair].T
    flat = np.abs((scene.normals[one] * scene.normals[other]).sum(axis=1)) > _SLOPE
    one, other, inner = one[flat], other[flat], pair[flat]
    links = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(len(faces), len(faces)))
    surface = connected_components(links, directed=False)[1]
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
    turned = [np.bincount(own, length * f(4.0 * angle), len(first)) for f in (np.cos, np.sin)]
    mean = 0.25 * np.arctan2(turned[1], turned[0])[:, None]  # four directions count as one
    axis = (np.cos(mean) * u + np.sin(mean) * v)[surface]
    axis -= (axis * scene.normals).sum(axis=1)[:, None] * scene.normals
    size = np.linalg.norm(axis, axis=1)[:, None]
    some = size > 0.5  # else the surface is round, and has no outline to speak of
    return np.where(some, axis / np.where(some, size, 1.0), _tangents(scene.normals))


def _tangents(normals: np.ndarray) -> np.ndarray:
    """(n, 3) some unit vector at a right angle to each."""
    u = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    return np.asarray(u / np.linalg.norm(u, axis=1)[:, None])


def _hits(scene: Scene, piece: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Places evenly on every piece: (n,) piece, (n,) face, (n, 3) m, and (n, 2) numbers for a direction."""
    area = np.bincount(piece, scene.areas)
    count = np.clip(np.ceil(_PER_AREA * area), _LEAST, _MOST).astype(np.int64)
    of = np.repeat(np.arange(len(count)), count)
    index = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
    u = (index[:, None] + 0.5) * np.array(_SHIFTS) + of[:, None] * np.sqrt(2.0) * np.arange(1, 6)
    u -= np.floor(u)
    order = np.argsort(piece, kind="stable")
    upto = np.cumsum(scene.areas[order])
    before = np.concatenate([[0.0], np.cumsum(area)])
    wanted = before[of] + (index + u[:, 0]) / count[of] * area[of]
    at = np.minimum(np.searchsorted(upto, wanted), len(order) - 1)
    first = np.searchsorted(piece[order], of)
    last = np.searchsorted(piece[order], of, "right") - 1
    face = order[np.clip(at, first, last)]
    root = np.sqrt(u[:, 1:2])
    a, b, c = (scene.corners[face] - scene.center).transpose(1, 0, 2)
    place = (1.0 - root) * a + root * (1.0 - u[:, 2:3]) * b + root * u[:, 2:3] * c
    return of, face, np.ascontiguousarray(place), np.ascontiguousarray(u[:, 3:])


@kernel
def _look(first, last, geometry, place, face, axis, numbers, side, rows):
    """Fill rows (n, 5), see `kept_in_beam`, of hits on one side; NaN where sound comes from, or goes, nowhere."""
    for i in range(first, last):
        n = geometry.normal[face[i]]
        nx, ny, nz = side * n[0], side * n[1], side * n[2]
        x, y, z = place[i, 0], place[i, 1], place[i, 2]
        dx, dy, dz = sample_cosine(nx, ny, nz, numbers[i, 0], numbers[i, 1])
        e = geometry.epsilon
        ox, oy, oz = x + e * nx, y + e * ny, z + e * nz
        one, _ = cast(geometry, ox, oy, oz, dx, dy, dz, np.inf)
        mx, my, mz = reflect(-dx, -dy, -dz, nx, ny, nz)
        other, _ = cast(geometry, ox, oy, oz, mx, my, mz, np.inf)
        if not (0.0 < one < np.inf and 0.0 < other < np.inf):  # zero: it stands on another face's edge
            continue
        ax, ay, az = axis[i, 0], axis[i, 1], axis[i, 2]
        bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
        at, up = (x, y, z), (nx, ny, nz)
        rows[i, 0], rows[i, 1] = _ends(geometry, at, up, (ax, ay, az), ax * dx + ay * dy + az * dz)
        rows[i, 2], rows[i, 3] = _ends(geometry, at, up, (bx, by, bz), bx * dx + by * dy + bz * dz)
        rows[i, 4] = one * other / (one + other)


@part
def _ends(geometry, at, up, along, cos):
    """Distances to the ends ahead and behind, as sound that comes at this cosine to them sees them; a piece is
    mirrored where another one stands on it."""
    x, free_x = _follow(geometry, at, up, along)
    y, free_y = _follow(geometry, at, up, (-along[0], -along[1], -along[2]))
    across = math.sqrt(max(1.0 - cos * cos, 0.0))
    if free_x and free_y:
        return x * across, y * across
    if free_x:
        return x * across, (x + 2.0 * y) * across
    if free_y:
        return (y + 2.0 * x) * across, y * across
    return np.inf, np.inf


@part
def _follow(geometry, at, up, along):
    """How far a surface goes on, and whether it ends there in the open; infinite beyond `_FARTHEST`."""
    x, y, z = at
    nx, ny, nz = up
    ex, ey, ez = along
    gone, step, growth = 0.0, _FIRST, _GROWTH
    for _ in range(_STEPS):
        if gone >= _FARTHEST:
            break
        px, py, pz = x + _LIFT * nx, y + _LIFT * ny, z + _LIFT * nz
        t, triangle = cast(geometry, px, py, pz, ex, ey, ez, step)
        rising = triangle >= 0
        if not rising:
            px, py, pz = px + step * ex, py + step * ey, pz + step * ez
            t, triangle = cast(geometry, px, py, pz, -nx, -ny, -nz, 2.0 * _LIFT)
            if triangle < 0:
                if step <= _FINE:
                    return gone + 0.5 * step, True
                step, growth = 0.5 * step, 1.0
                continue
            qx, qy, qz, mx, my, mz = hit_point(geometry, triangle, px, py, pz, -nx, -ny, -nz, t)
        else:
            qx, qy, qz, mx, my, mz = hit_point(geometry, triangle, px, py, pz, ex, ey, ez, t)
        level = mx * nx + my * ny + mz * nz > _SLOPE
        if level and mx * up[0] + my * up[1] + mz * up[2] > _TURN:
            moved = math.sqrt((qx - x) ** 2 + (qy - y) ** 2 + (qz - z) ** 2)
            gone, step = gone + moved, step * growth
            x, y, z, nx, ny, nz = qx, qy, qz, mx, my, mz
            k = ex * nx + ey * ny + ez * nz
            ex, ey, ez = ex - k * nx, ey - k * ny, ez - k * nz
            length = math.sqrt(ex * ex + ey * ey + ez * ez)
            ex, ey, ez = ex / length, ey / length, ez / length
            continue
        towards = mx * along[0] + my * along[1] + mz * along[2]
        if rising or towards < 0.0:
            return gone + (t if rising else step), False
        if step <= _FINE:
            return gone + 0.5 * step, True
        step, growth = 0.5 * step, 1.0
    return np.inf, False
