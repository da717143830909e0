"""Early mirror reflections: paths of one or two mirrors at grouped planes, one arrival each.

The sequences of planes worth trying for a point are those that a dense, deterministic set of rays from
it really meets; for a pair, the sequences seen from either end. Each is then solved by images, checked
by real rays, and recorded with its exact delay and direction. Specular walks leave exactly this class of
paths out, so nothing is counted twice.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.echogram.echogram import MIRRORS
from soundspaces_sim.scene.rays.directions import INV_4PI, reflect, sample_sphere
from soundspaces_sim.scene.rays.geometry import cast, hit_point, visible
from soundspaces_sim.transport.bsdf.surface import specular_albedo, specular_reflectance
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.model import air_transmission
from soundspaces_sim.transport.tile import EarlyPaths, Side, Tile, join_paths

ORDER = 2  # longer mirror paths are left to `specular`
_RAYS = 8192
_GOLDEN = 0.6180339887498949


@part
def _mirror_plane(geometry, surfaces, triangle):
    """Plane of a triangle that mirrors sound in any band, else -1."""
    if specular_albedo(surfaces, geometry.material[triangle]) > 0.0:
        return geometry.plane[triangle]
    return -1


@kernel
def _find_sequences(first, last, geometry, surfaces, mirrors, points, seen):
    """Set flags (N, P, P + 1): from point i, rays meet plane a alone ([a, P]) or a and then b ([a, b])."""
    planes = len(mirrors.offset)
    for i in range(first, last):
        if planes == 0:
            continue
        px, py, pz = points[i]
        for k in range(_RAYS):
            v = k * _GOLDEN
            dx, dy, dz = sample_sphere((k + 0.5) / _RAYS, v - math.floor(v))
            t, triangle = cast(geometry, px, py, pz, dx, dy, dz, math.inf)
            if triangle < 0:
                continue
            a = _mirror_plane(geometry, surfaces, triangle)
            if a < 0:
                continue
            seen[i, a, planes] = True
            x, y, z, nx, ny, nz = hit_point(geometry, triangle, px, py, pz, dx, dy, dz, t)
            lift = geometry.epsilon + mirrors.margin[a]
            x, y, z = x + lift * nx, y + lift * ny, z + lift * nz
            nx, ny, nz = mirrors.normal[a]
            dx, dy, dz = reflect(dx, dy, dz, nx, ny, nz)
            t, triangle = cast(geometry, x, y, z, dx, dy, dz, math.inf)
            if triangle < 0:
                continue
            b = _mirror_plane(geometry, surfaces, triangle)
            if b >= 0 and b != a:
                seen[i, a, b] = True


@part
def side_of(mirrors, a, x, y, z):
    n = mirrors.normal[a]
    return n[0] * x + n[1] * y + n[2] * z - mirrors.offset[a]


@part
def image_of(mirrors, a, x, y, z):
    k = 2.0 * side_of(mirrors, a, x, y, z)
    n = mirrors.normal[a]
    return x - k * n[0], y - k * n[1], z - k * n[2]


@part
def crossing(mirrors, a, image, q):
    """Point of plane a on the line from an image to q, or a negative first value if not between."""
    s_image, s_q = -side_of(mirrors, a, *image), side_of(mirrors, a, *q)
    if s_image * s_q <= 0.0:  # the image lies on the far side, so equal signs mean the same side
        return False, (0.0, 0.0, 0.0)
    t = s_image / (s_image + s_q)
    return True, (
        image[0] + t * (q[0] - image[0]),
        image[1] + t * (q[1] - image[1]),
        image[2] + t * (q[2] - image[2]),
    )


@part
def bounce_at(geometry, mirrors, a, origin, target):
    """Cast a ray at a reflection point: (triangle, point lifted off the plane) if plane a is there."""
    dx, dy, dz = target[0] - origin[0], target[1] - origin[1], target[2] - origin[2]
    r = math.sqrt(dx * dx + dy * dy + dz * dz)
    if r <= 0.0:
        return -1, target
    dx, dy, dz = dx / r, dy / r, dz / r
    t, triangle = cast(geometry, origin[0], origin[1], origin[2], dx, dy, dz, math.inf)
    if triangle < 0 or geometry.plane[triangle] != a:
        return -1, target
    x, y, z, nx, ny, nz = hit_point(geometry, triangle, *origin, dx, dy, dz, t)
    lift = geometry.epsilon + mirrors.margin[a]
    return triangle, (x + lift * nx, y + lift * ny, z + lift * nz)


@part
def solve(geometry, surfaces, mirrors, a, b, p, q, row):
    """One sequence for one pair: True and `row` filled if the path exists.

    `row`: length, direction of arrival at q, at p (unit vectors from the end outward), energy per band
    without air. b = -1 for a single mirror.
    """
    image = image_of(mirrors, a, *p)
    if b < 0:
        last = image
        ok, x = crossing(mirrors, a, image, q)
        if not ok:
            return False
        y = x
    else:
        last = image_of(mirrors, b, *image)
        ok, y = crossing(mirrors, b, last, q)
        if not ok:
            return False
        ok, x = crossing(mirrors, a, image, y)
        if not ok:
            return False
    length2 = (last[0] - q[0]) ** 2 + (last[1] - q[1]) ** 2 + (last[2] - q[2]) ** 2
    row[0] = math.sqrt(length2)
    to_y = math.sqrt((y[0] - q[0]) ** 2 + (y[1] - q[1]) ** 2 + (y[2] - q[2]) ** 2)
    to_x = math.sqrt((x[0] - p[0]) ** 2 + (x[1] - p[1]) ** 2 + (x[2] - p[2]) ** 2)
    if to_x <= 0.0 or to_y <= 0.0:
        return False
    for axis in range(3):
        row[1 + axis] = (y[axis] - q[axis]) / to_y
        row[4 + axis] = (x[axis] - p[axis]) / to_x
    at_a, half = abs(side_of(mirrors, a, *p)) / to_x, 0.5 * INV_4PI / length2
    energy = row[7:]
    energy[:] = 0.0
    if b < 0:
        there = _add_way(geometry, surfaces, mirrors, a, -1, p, x, x, q, at_a, 1.0, half, energy)
        back = _add_way(geometry, surfaces, mirrors, a, -1, q, x, x, p, at_a, 1.0, half, energy)
    else:
        at_b = abs(side_of(mirrors, b, *q)) / to_y
        there = _add_way(geometry, surfaces, mirrors, a, b, p, x, y, q, at_a, at_b, half, energy)
        back = _add_way(geometry, surfaces, mirrors, b, a, q, y, x, p, at_b, at_a, half, energy)
    return there or back


@part
def _add_way(geometry, surfaces, mirrors, a, b, p, x, y, q, at_a, at_b, scale, energy):
    """Add `scale` of what mirrors leave of sound from p over x on plane a, and y on plane b if there is one, to q.

    False if rays do not get through. Where a plane's triangles are not quite in it, those from one end may and
    those from the other not: hence both.
    """
    first, lifted = bounce_at(geometry, mirrors, a, p, x)
    if first < 0:
        return False
    second = first
    if b >= 0:
        second, lifted = bounce_at(geometry, mirrors, b, lifted, y)
        if second < 0:
            return False
    if not visible(geometry, lifted[0], lifted[1], lifted[2], q[0], q[1], q[2]):
        return False
    for band in range(len(energy)):
        left = specular_reflectance(surfaces, geometry.material[first], at_a, band)
        if b >= 0:
            left *= specular_reflectance(surfaces, geometry.material[second], at_b, band)
        energy[band] += scale * left
    return True


@kernel
def _mirror_paths(
    first, last, geometry, surfaces, mirrors, p, p_sequences, p_seen, points, partners, q_start, q_sequences,
    swap, rows, found,
):  # fmt: skip
    """Early mirror paths from one point to several.

    `p_sequences` (K, 2) of the point, `p_seen` its flags; rows q_start[j]:q_start[j + 1] of
    `q_sequences` belong to point j. `swap[k]`: solve from the partner's side, so that a pair gives the
    same bits whichever end is asked.
    Fills `rows` (partners, slots, 9 + b) and flags `found` (partners, slots): planes as seen from p, then
    the columns of `solve` with q the partner.
    """
    planes = len(mirrors.offset)
    for k in range(first, last):
        j = partners[k]
        q = (points[j, 0], points[j, 1], points[j, 2])
        own = len(p_sequences)
        for s in range(own + q_start[j + 1] - q_start[j]):
            if s < own:
                a, b = p_sequences[s, 0], p_sequences[s, 1]
            else:
                one, two = q_sequences[q_start[j] + s - own, 0], q_sequences[q_start[j] + s - own, 1]
                a, b = (one, -1) if two < 0 else (two, one)
                if p_seen[a, b if b >= 0 else planes]:
                    continue  # already tried from p's own list
            row = rows[k, s]
            row[0], row[1] = a, b
            if swap[k]:
                c, d = (a, b) if b < 0 else (b, a)
                found[k, s] = solve(geometry, surfaces, mirrors, c, d, q, p, row[2:])
                for axis in range(3):  # arrival at q and at p change places
                    row[3 + axis], row[6 + axis] = row[6 + axis], row[3 + axis]
            else:
                found[k, s] = solve(geometry, surfaces, mirrors, a, b, p, q, row[2:])


class Sequences(NamedTuple):
    """Planes worth trying from the points of a side."""

    seen: np.ndarray  # (N, P, P + 1), see `_find_sequences`
    start: np.ndarray  # (N + 1,) where each point's rows of `codes` start
    codes: np.ndarray  # (n, 2) plane, and the second one or -1


def sequences(side: Side) -> Sequences:
    """The planes that the points of a side meet; it is looked up once."""
    return side.once(_look_round)


def _look_round(side: Side) -> Sequences:
    model = side.model
    world, mirrors, points = model.world, model.prepared.part(prepare_planes), side.ends.points
    planes = len(mirrors.offset)
    seen = np.zeros((len(points), planes, planes + 1), np.bool_)
    over_rows(_find_sequences, len(points), world.geometry, world.surfaces, mirrors, points, seen)
    rows = np.argwhere(seen)
    start = np.searchsorted(rows[:, 0], np.arange(len(points) + 1))
    codes = rows[:, 1:].copy()
    codes[codes[:, 1] == planes, 1] = -1
    return Sequences(seen, start, codes)


class Reflections(NamedTuple):
    """The paths of a tile with one mirror: rows start[k]:start[k + 1] are those of pair k."""

    start: np.ndarray  # (A * B + 1,)
    plane: np.ndarray  # (n,) ascending for a pair
    row: np.ndarray  # (n,) of the table


def reflections(tile: Tile) -> Reflections:
    """What `connect` has found with one mirror."""
    found, pairs = tile.discrete.get("image_source"), tile.walls.size
    if found is None:
        return Reflections(np.zeros(pairs + 1, np.int64), np.empty(0, np.int64), np.empty(0, np.int64))
    row = np.flatnonzero(found.planes[:, 1] < 0)
    row = row[np.lexsort((found.planes[row, 0], found.pair[row]))]
    start = np.searchsorted(found.pair[row], np.arange(pairs + 1))
    return Reflections(start, np.ascontiguousarray(found.planes[row, 0]), row)


def weaken_reflections(tile: Tile, of: Reflections, factor: np.ndarray) -> None:
    """Multiply the energies of reflections by factors (n, b); in a tile of one side those of (i, j), i <= j, count
    for both ways."""
    found = tile.discrete.get("image_source")
    if found is None or len(of.row) == 0:
        return
    if tile.same:
        n = len(tile.a.ends.points)
        pair = found.pair[of.row]
        i, j = pair // n, pair % n
        twin = (
            of.start[j * n + i] + np.arange(len(pair)) - of.start[pair]
        )  # the same plane, the other way
        factor = np.where((i <= j)[:, None], factor, factor[twin])
    found.energy[of.row] *= factor


def connect(tile: Tile) -> EarlyPaths:
    """Early mirror paths of every pair."""
    world, mirrors = tile.model.world, tile.model.prepared.part(prepare_planes)
    a, b = tile.a.ends, tile.b.ends
    of_a = sequences(tile.a)
    of_b = of_a if tile.same else sequences(tile.b)
    n_a, n_b, bands = len(a.points), len(b.points), world.air.shape[1]
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    for i in range(n_a if len(mirrors.offset) else 0):
        partners = np.arange(i if tile.same else 0, n_b)
        p, own = a.points[i], of_a.codes[of_a.start[i] : of_a.start[i + 1]]
        slots = len(own) + int(np.diff(of_b.start)[partners].max())
        rows = np.empty((len(partners), slots, 9 + bands))
        found = np.zeros((len(partners), slots), np.bool_)
        over_rows(
            _mirror_paths, len(partners), world.geometry, world.surfaces, mirrors, (p[0], p[1], p[2]), own,
            of_a.seen[i], b.points, partners, of_b.start, of_b.codes, a.keys[i] > b.keys[partners], rows,
            found,
        )  # fmt: skip
        parts.append((i * n_b + partners[np.nonzero(found)[0]], rows[found]))
    pair = np.concatenate([k for k, _ in parts] or [np.empty(0, np.int64)])
    rows = np.concatenate([r for _, r in parts] or [np.empty((0, 9 + bands))])
    energy = rows[:, 9:] * air_transmission(tile.model.config, rows[:, 2])
    early = EarlyPaths(
        pair, rows[:, 2], rows[:, 3:6], rows[:, 6:9], energy, rows[:, :2].astype(np.int64),
        np.full(len(rows), MIRRORS), np.full((len(rows), 2), -1),
    )  # fmt: skip
    if tile.same:  # the other direction of every pair of two different points
        back = early.reversed(n_a, n_b)
        other = back.pair // n_b != back.pair % n_b
        early = join_paths([early, back.rows(other)], bands)
    return early
