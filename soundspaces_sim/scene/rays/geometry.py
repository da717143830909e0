"""The scene as kernels see it: a ray handle and flat arrays, and rays against them.

Conventions: metres, relative to the middle of the scene's bounds. Directions are unit vectors, so ray parameters
are distances. Points that rays start from or end at lie `epsilon` off the surfaces that they are on: those that a
ray has met on that ray (`before`), as the surface's normal leads through a wall that leans over the point.
"""

from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import (
    Vec3,
    along,
    cross,
    divide,
    dot,
    length,
    negate,
    row,
    subtract,
)
from soundspaces_sim.scene.rays import caster

_ON = 0.01  # of the offset of rays: nearer to a surface is on it
_NEAR = 0.1  # of the offset of rays: more than rounding takes off


class Covers(NamedTuple):
    """What lies on triangles in their own plane (`rays.overlaps`): rows `start[t]` to `start[t + 1]` on triangle t,
    that which counts first of all in the first of them."""

    start: np.ndarray  # (F + 1,)
    triangle: np.ndarray  # (n,)
    corners: np.ndarray  # (n, 3, 3) m, which turn to the left about `normal`
    normal: np.ndarray  # (n, 3) unit


class Geometry(NamedTuple):
    """F triangles."""

    handle: Any  # of the RayScene: a number, or the arrays of a hierarchy
    anchor: np.ndarray  # (F, 3) first vertex of each triangle, m
    normal: np.ndarray  # (F, 3) unit
    material: np.ndarray  # (F, 2) row of Surfaces in front of and behind the stored normal
    # (F,) int8, 1 where the stored normal points out of an element, -1 in, 0: of none
    outward: np.ndarray
    plane: np.ndarray  # (F,) row of the planes that mirror early sound, or -1
    epsilon: float  # m, offset of ray origins from the surface they leave
    covers: Covers


class Hit(NamedTuple):
    """Where a ray meets a surface."""

    distance: float  # m from the ray's origin, inf if it meets none
    triangle: int  # -1 if it meets none
    point: Vec3  # m, on the triangle's plane
    normal: Vec3  # unit, on the side from which the ray comes
    material: int  # row of Surfaces on that side, -1 if it meets none


@part(forceinline=True)
def cast_ray(geometry: Geometry, origin: Vec3, direction: Vec3, limit: float) -> tuple[float, int]:
    """(distance, triangle) of the nearest surface; (inf, -1) if there is none within `limit`. Of triangles that lie
    in one place it is the one that counts."""
    t, triangle = _nearest(geometry, origin, direction, limit)
    if triangle >= 0 and geometry.covers.start[triangle + 1] > geometry.covers.start[triangle]:
        triangle = _counting(geometry.covers, triangle, along(origin, t, direction))
    return t, triangle


@part(forceinline=True)
def _nearest(geometry: Geometry, origin: Vec3, direction: Vec3, limit: float) -> tuple[float, int]:
    return caster.intersect(geometry.handle, origin, direction, limit)


@part
def _counting(covers: Covers, triangle: int, point: Vec3) -> int:
    """The triangle that counts at a point of one on which others lie."""
    for k in range(covers.start[triangle], covers.start[triangle + 1]):
        n, inside = row(covers.normal, k), True
        for i in range(3):
            p, q = row(covers.corners[k], i), row(covers.corners[k], i + 1 if i < 2 else 0)
            inside = inside and dot(cross(n, subtract(q, p)), subtract(point, p)) >= 0.0
        if inside:
            return covers.triangle[k]
    return triangle


@part(forceinline=True)
def material_met(geometry: Geometry, triangle: int, direction: Vec3) -> int:
    """Row of Surfaces on the side of a triangle to which sound of this direction comes."""
    behind = dot(row(geometry.normal, triangle), direction) > 0.0
    return geometry.material[triangle, 1 if behind else 0]


@part(forceinline=True)
def surface_point(
    geometry: Geometry, triangle: int, origin: Vec3, direction: Vec3, t: float
) -> tuple[Vec3, Vec3]:
    """(point, normal) at distance `t` along a ray: the point moved along the normal on to its triangle's plane
    (Embree computes in single precision), and the unit normal on the side from which the ray comes."""
    n = row(geometry.normal, triangle)
    if dot(n, direction) > 0.0:
        n = negate(n)
    x = along(origin, t, direction)
    off = dot(subtract(x, row(geometry.anchor, triangle)), n)
    return (x[0] - off * n[0], x[1] - off * n[1], x[2] - off * n[2]), n


@part(forceinline=True)
def intersect(geometry: Geometry, origin: Vec3, direction: Vec3, limit: float) -> Hit:
    """Where a ray first meets a surface within `limit`; `Hit.triangle` is -1 if it meets none."""
    t, triangle = cast_ray(geometry, origin, direction, limit)
    if triangle < 0:
        return Hit(t, triangle, origin, direction, -1)
    point, normal = surface_point(geometry, triangle, origin, direction, t)
    return Hit(t, triangle, point, normal, material_met(geometry, triangle, direction))


@part(forceinline=True)
def unoccluded(geometry: Geometry, p: Vec3, q: Vec3) -> bool:
    """Whether nothing lies between two points, of which q may be on a surface."""
    return _unoccluded(geometry, p, q, geometry.epsilon)


@part(forceinline=True)
def in_sight(geometry: Geometry, p: Vec3, q: Vec3) -> bool:
    """Whether nothing lies between two points, both off all surfaces: a wall just before q counts."""
    return _unoccluded(geometry, p, q, _NEAR * geometry.epsilon)


@part(forceinline=True)
def _unoccluded(geometry: Geometry, p: Vec3, q: Vec3, margin: float) -> bool:
    between = subtract(q, p)
    r = length(between)
    if r <= margin:
        return True
    return not caster.occluded(geometry.handle, p, divide(between, r), r - margin)


@part(forceinline=True)
def lifted(geometry: Geometry, point: Vec3, normal: Vec3) -> Vec3:
    """A point of a surface, `epsilon` off it on the side of `normal`."""
    return along(point, geometry.epsilon, normal)


@part(forceinline=True)
def before(geometry: Geometry, hit: Hit, direction: Vec3) -> Vec3:
    """A point on the ray of this `direction` that has met a surface, `epsilon` off it, or half way from the ray's
    origin where that is nearer; `lifted` where the ray starts on the surface itself."""
    cos = max(-dot(hit.normal, direction), 1e-9)
    back = min(geometry.epsilon / cos, 0.5 * hit.distance)
    if back * cos < _ON * geometry.epsilon:
        return lifted(geometry, hit.point, hit.normal)
    return along(hit.point, -back, direction)
