"""Points that lie on faces, and points that have no air about them."""

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, add, along, dot, negate, put, row, subtract
from soundspaces_sim.scene.rays.directions import sample_sphere
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray

_RAYS = 32  # over the sphere
_GOLDEN = 0.6180339887498949
_FAR = 1.0  # m, beyond which space is open enough
_ON = 1.0  # of the offset of rays: nearer to a face is on it …
_OFF = 2.0  # … and is moved so far off
_BESIDE = 0.7  # of the offset of rays, in each coordinate: places about a point from which its faces are sought
_ALIKE = 0.99  # cosine from which on two faces are one
_INSIDE = 0.9  # share of lines by which a point lies in a body: some leave it by a hole
_THIN = 0.5  # share of lines that find it thin


@part(forceinline=True)
def _direction(k: int) -> Vec3:
    v = k * _GOLDEN
    return sample_sphere((k + 0.5) / _RAYS, v - math.floor(v))


@part
def _normal_at(geometry: Geometry, point: Vec3, known: tuple[Vec3, Vec3]) -> tuple[bool, Vec3, float]:
    """Whether a face lies within `_ON` offsets of a point, of a direction other than the `known` ones; its normal,
    and how far before it the point is."""
    reach, beside = 2.0 * _ON * geometry.epsilon, _BESIDE * geometry.epsilon
    for corner in range(
        9
    ):  # the point itself, and about it: an edge of faces may pass on its other side
        shift = (0.0, 0.0, 0.0)
        if corner > 0:
            x, y, z = (corner - 1) % 2, (corner - 1) // 2 % 2, (corner - 1) // 4
            shift = beside * (2 * x - 1), beside * (2 * y - 1), beside * (2 * z - 1)
        for k in range(_RAYS):
            d = _direction(k)
            _, triangle = cast_ray(geometry, along(add(point, shift), -reach, d), d, 2.0 * reach)
            if triangle < 0:
                continue
            n = row(geometry.normal, triangle)
            high = dot(n, subtract(point, row(geometry.anchor, triangle)))
            other = abs(dot(n, known[0])) < _ALIKE and abs(dot(n, known[1])) < _ALIKE
            if other and abs(high) < _ON * geometry.epsilon:
                return True, n, high
    return False, (0.0, 0.0, 0.0), 0.0


@part
def _openness(geometry: Geometry, point: Vec3) -> float:
    """m, mean distance that rays go, up to `_FAR`; those that meet nothing count as none."""
    total = 0.0
    for k in range(_RAYS):
        t, triangle = cast_ray(geometry, point, _direction(k), math.inf)
        if triangle >= 0:
            total += min(t, _FAR)
    return total / _RAYS


@kernel
def _move_off(first: int, last: int, geometry: Geometry, points: np.ndarray) -> None:
    off, none = _OFF * geometry.epsilon, (0.0, 0.0, 0.0)
    for i in range(first, last):
        p = row(points, i)
        one, n, at_n = _normal_at(geometry, p, (none, none))
        if not one:
            continue
        two, m, at_m = _normal_at(geometry, p, (n, n))
        three, o, at_o = _normal_at(geometry, p, (n, m))
        best, place = -1.0, p
        for side in range(8):
            if (not two and side & 2) or (not (two and three) and side & 4):
                continue
            q = along(p, (-off if side & 1 else off) - at_n, n)
            if two:
                q = along(q, (-off if side & 2 else off) - at_m, m)
            if two and three:
                q = along(q, (-off if side & 4 else off) - at_o, o)
            here = _openness(geometry, q)
            if here > best:
                best, place = here, q
        put(points, i, place)


def off_faces(geometry: Geometry, points: np.ndarray) -> np.ndarray:
    """(N, 3) points, m relative to the scene's centre, of which those that lie on faces are moved to the side where
    there is more space, by twice the offset of rays: else rounding would choose the side. Up to three faces that
    meet there count."""
    moved = np.array(points, float)
    over_rows(_move_off, len(moved), geometry, moved)
    return moved


@part
def _line(geometry: Geometry, p: Vec3, d: Vec3, sided: bool) -> tuple[float, int]:
    """How deep the body is through which a line goes at a point, m, and the triangle ahead; inf where it does not
    go in before the point and out behind."""
    ahead, first = cast_ray(geometry, p, d, math.inf)
    back, second = cast_ray(geometry, p, negate(d), math.inf)
    if first < 0 or second < 0:
        return math.inf, -1
    out, into = dot(row(geometry.normal, first), d), -dot(row(geometry.normal, second), d)
    if sided and (geometry.outward[first] * out <= 0.0 or geometry.outward[second] * into <= 0.0):
        return math.inf, first
    return (ahead + back) * min(abs(out), abs(into)), first


@kernel
def _find_bodies(
    first: int,
    last: int,
    geometry: Geometry,
    points: np.ndarray,
    deepest: float,
    sided: bool,
    depth: np.ndarray,
) -> None:
    """Fill `depth` (N,)."""
    for i in range(first, last):
        p, inside, thin, least = row(points, i), 0, 0, math.inf
        for k in range(_RAYS):
            deep, triangle = _line(geometry, p, _direction(k), sided)
            inside += deep < math.inf
            thin += deep <= deepest
            if triangle >= 0:
                across, _ = _line(geometry, p, row(geometry.normal, triangle), sided)
                least = min(least, across)
        found = inside >= _INSIDE * _RAYS and thin >= _THIN * _RAYS and least <= deepest
        depth[i] = least if found else math.inf


def depth_of_bodies(
    geometry: Geometry, points: np.ndarray, deepest: float, sided: bool = True
) -> np.ndarray:
    """(N,) m, how deep the bodies are in which points lie, inf of those in air and in bodies deeper than `deepest`.

    A point is in a body where lines through it go in before it and out behind, most of them soon. A corner of a
    room that is wound like a body is none: across from its walls it is wide. If not `sided` gaps count as well,
    where lines go out before and in behind, and no windings are asked for.
    """
    depth = np.empty(len(points))
    over_rows(_find_bodies, len(points), geometry, np.ascontiguousarray(points), deepest, sided, depth)
    return depth
