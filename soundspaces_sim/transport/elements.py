"""Sound through building elements: what transmits is an element as a whole, not each face that a mesh gives it.

It is decided along the ray. Sound that crosses a face goes in; if the next face looks away, it goes out there, and
has passed one element, once, with the lesser transmission of both. No mesh needs to be closed for that: where a
face is missing, what is left is a sheet, which transmits as well. Faces that go in between are elements within it.

An element is as deep as the way through it times the lesser cosine at its ends: a wall is as deep as it is thick,
however sound comes. From `WHOLE` to `APART` m the chance that its faces are sheets, with air between them, rises
from 0 to 1, so that nothing jumps at a limit. All of it is the same from the other end.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, divide, dot, length, reflect, row, subtract
from soundspaces_sim.scene.enclosure import DEEPEST
from soundspaces_sim.scene.rays.geometry import Geometry, Hit, cast_ray, lifted, surface_point
from soundspaces_sim.transport.bsdf.surface import (
    Surfaces,
    attenuate_transmission,
    transmission,
    transmittance,
)

# m, depth up to which two faces are one element, and from which on they are two.
WHOLE, APART = DEEPEST, 1.2
_LONGEST = 10.0  # m, of the way through one
_FACES = 16  # on that way
_LEAST = 1e-9  # of the unobstructed energy
_MAX_WALLS = 256


@part(forceinline=True)
def _facing(geometry: Geometry, triangle: int, direction: Vec3) -> float:
    """Cosine of a direction with the normal that points out of what a face bounds; 0 for faces of no element."""
    return geometry.outward[triangle] * dot(row(geometry.normal, triangle), direction)


@part(forceinline=True)
def _step(geometry: Geometry, cos: float) -> float:
    """How far behind a face the next ray starts, m."""
    return geometry.epsilon / max(abs(cos), 0.05)


class Way(NamedTuple):
    """How a ray goes through an element."""

    triangle: int  # by which it leaves, -1 if it does not
    distance: float  # m, from where it has come in
    point: Vec3  # where it leaves
    direction: Vec3
    within: bool  # whether it passes elements within
    turned: bool  # whether it was mirrored


_NO_WAY = Way(-1, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), False, False)


@part
def way_through(
    geometry: Geometry,
    surfaces: Surfaces,
    first: int,
    origin: Vec3,
    direction: Vec3,
    limit: float,
    straight: bool,
    energy: np.ndarray,
) -> Way:
    """The way from `origin` on the face `first`, which lets a ray in, to where it leaves again, up to `limit` m.

    `energy` (b,) is multiplied by what elements within let pass. Where more than three lie in each other, the outer
    ones end as sheets. What lets nothing pass mirrors the ray, unless that must go `straight`: where a wall stands
    on a floor, or goes through it, none of its sound is lost there.
    """
    step = _step(geometry, dot(row(geometry.normal, first), direction))
    if _facing(geometry, first, direction) >= 0.0:
        return _NO_WAY
    origin, total, limit = along(origin, step, direction), step, min(limit, _LONGEST)
    a, b, c, depth, turned = -1, -1, -1, 1, False  # faces by which it went in within, the last one first
    for face in range(_FACES):
        t, triangle = cast_ray(geometry, origin, direction, limit - total)
        if triangle < 0:
            break
        cos, material = _facing(geometry, triangle, direction), geometry.material[triangle, 0]
        if transmission(surfaces, material) <= 0.0:
            if straight:
                break
            point, normal = surface_point(geometry, triangle, origin, direction, t)
            origin, total, turned = lifted(geometry, point, normal), total + t, True
            direction = reflect(direction, normal)
            continue
        if cos == 0.0:
            break
        total, origin = total + t, along(origin, t, direction)
        if cos < 0.0:
            a, b, c, depth = triangle, a, b, depth + 1
            attenuate_transmission(surfaces, material, -cos, energy)
        else:
            depth -= 1
            if depth == 0:
                return Way(triangle, total, origin, direction, face > 0, turned)
            if a >= 0:
                leave(geometry, surfaces, (a, triangle), (direction, direction), 0.0, energy)
            else:
                attenuate_transmission(surfaces, material, cos, energy)
            a, b, c = b, c, -1
        step = _step(geometry, cos)
        origin, total = along(origin, step, direction), total + step
        if total >= limit:
            break
    return _NO_WAY


@part
def _sheets(
    geometry: Geometry, faces: tuple[int, int], directions: tuple[Vec3, Vec3], distance: float
) -> float:
    """Chance with which the first and the last of an element's faces, `distance` m apart, are two sheets."""
    into, out = _facing(geometry, faces[0], directions[0]), _facing(geometry, faces[1], directions[1])
    x = min(max((distance * min(abs(into), abs(out)) - WHOLE) / (APART - WHOLE), 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


@part(forceinline=True)
def _passed(geometry: Geometry, surfaces: Surfaces, triangle: int, direction: Vec3, band: int) -> float:
    """What a face transmits of a band at the angle at which sound meets it."""
    cos = abs(dot(row(geometry.normal, triangle), direction))
    return transmittance(surfaces, geometry.material[triangle, 0], cos, band)


@part
def leave(
    geometry: Geometry,
    surfaces: Surfaces,
    faces: tuple[int, int],
    directions: tuple[Vec3, Vec3],
    sheets: float,
    energy: np.ndarray,
) -> None:
    """Multiply `energy` (b,), which the first of two faces has let in, by what the element lets out at the second
    one, with the chance `sheets` that both are sheets."""
    for b in range(len(energy)):
        into = _passed(geometry, surfaces, faces[0], directions[0], b)
        out = _passed(geometry, surfaces, faces[1], directions[1], b)
        once = min(out / into, 1.0) if into > 0.0 else 0.0
        energy[b] *= (1.0 - sheets) * once + sheets * out


@part
def through_element(
    geometry: Geometry, surfaces: Surfaces, hit: Hit, direction: Vec3, u: float, energy: np.ndarray
) -> tuple[float, Vec3, Vec3]:
    """How far behind a face that has let sound in the next ray starts, m, where, and its direction: behind the
    element, or behind the face alone if it is a sheet. `energy` (b,) is multiplied by what lies between; `u`: a
    uniform number."""
    first, none = hit.triangle, energy[:0]
    behind = 0.0, along(hit.point, -geometry.epsilon, hit.normal), direction
    way = way_through(geometry, surfaces, first, hit.point, direction, math.inf, False, none)
    last = way.triangle
    if last < 0:
        return behind
    directions = direction, way.direction
    if u < _sheets(geometry, (first, last), directions, way.distance):
        return behind
    if way.within:
        way_through(geometry, surfaces, first, hit.point, direction, math.inf, False, energy)
    back = way.turned and _facing(geometry, first, way.direction) > 0.0
    leave(geometry, surfaces, (first, last), directions, 0.0, energy)
    if back:  # what has come in does not come out on the same side
        energy[:] = 0.0
    out = geometry.epsilon * geometry.outward[last]
    return way.distance, along(way.point, out, row(geometry.normal, last)), way.direction


@part
def cross_walls(geometry: Geometry, surfaces: Surfaces, p: Vec3, q: Vec3, energy: np.ndarray) -> int:
    """Multiply `energy` (b,) by the transmission of the elements between two points; their number."""
    between = subtract(q, p)
    r = length(between)
    if r <= geometry.epsilon:
        return 0
    d = divide(between, r)
    at = geometry.epsilon  # as at the other end: a point on a surface is in front of it
    for walls in range(_MAX_WALLS):
        left = r - geometry.epsilon - at
        if left <= 0.0:
            return walls
        t, first = cast_ray(geometry, along(p, at, d), d, left)
        if first < 0:
            return walls
        at += t
        cos = abs(dot(row(geometry.normal, first), d))
        strongest = attenuate_transmission(surfaces, geometry.material[first, 0], cos, energy)
        if strongest < _LEAST:
            break
        origin, behind, left = along(p, at, d), _step(geometry, cos), r - geometry.epsilon - at
        way = way_through(geometry, surfaces, first, origin, d, left, True, energy[:0])
        if way.triangle >= 0:
            if way.within:
                way_through(geometry, surfaces, first, origin, d, left, True, energy)
            faces = first, way.triangle
            sheets = _sheets(geometry, faces, (d, d), way.distance)
            leave(geometry, surfaces, faces, (d, d), sheets, energy)
            behind = way.distance + _step(geometry, _facing(geometry, way.triangle, d))
        at += behind
    energy[:] = 0.0
    return 1
