"""Sequences of specular planes that are worth solving for a point: those that rays from it meet.

The rays are a dense, deterministic set of directions (a Fibonacci lattice), so that a pair's sequences are the same
in any tile. A pair tries those of both of its ends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, distance, reflect, row
from soundspaces_sim.scene.rays.directions import sample_sphere
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray, surface_point
from soundspaces_sim.transport.bsdf.surface import Surfaces, specular_albedo
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.specular_planes import SpecularPlanes
from soundspaces_sim.transport.tile import Side

_RAYS = 8192  # of a point
_LEAST = 1e-300
_GOLDEN = 0.6180339887498949


class Sequences(NamedTuple):
    """Planes worth trying from the points of a side."""

    seen: np.ndarray  # (N, P, P + 1), see `_find_sequences`
    start: np.ndarray  # (N + 1,) where each point's rows of `planes` start
    planes: np.ndarray  # (n, 2) plane, and the second one or -1


@part(forceinline=True)
def ray_direction(k: int, rays: int) -> Vec3:
    """Ray `k` of so many."""
    v = k * _GOLDEN
    return sample_sphere((k + 0.5) / rays, v - math.floor(v))


@part
def _specular_plane(geometry: Geometry, surfaces: Surfaces, triangle: int) -> int:
    """Plane of a triangle that reflects sound specularly in any band, else -1."""
    if specular_albedo(surfaces, geometry.material[triangle]) > 0.0:
        return geometry.plane[triangle]
    return -1


@kernel
def _find_sequences(
    first: int,
    last: int,
    geometry: Geometry,
    surfaces: Surfaces,
    planes: SpecularPlanes,
    points: np.ndarray,
    rays: int,
    seen: np.ndarray,
) -> None:
    """Set flags (N, P, P + 1): from point i, so many rays meet plane a alone ([a, P]) or a and then b ([a, b])."""
    count = len(planes.offset)
    for i in range(first, last):
        if count == 0:
            continue
        p = row(points, i)
        for k in range(rays):
            d = ray_direction(k, rays)
            t, triangle = cast_ray(geometry, p, d, math.inf)
            if triangle < 0:
                continue
            a = _specular_plane(geometry, surfaces, triangle)
            if a < 0:
                continue
            seen[i, a, count] = True
            x, n = surface_point(geometry, triangle, p, d, t)
            x = along(x, geometry.epsilon + planes.margin[a], n)
            t, triangle = cast_ray(geometry, x, reflect(d, row(planes.normal, a)), math.inf)
            if triangle < 0:
                continue
            b = _specular_plane(geometry, surfaces, triangle)
            if b >= 0 and b != a:
                seen[i, a, b] = True


@part
def _may_meet(boxes: np.ndarray, a: int, p: Vec3, d: Vec3) -> bool:
    """Whether a ray passes the bounds of plane `a`: the slab method."""
    near, far = 0.0, math.inf
    for c in range(3):
        if abs(d[c]) < _LEAST:
            if not boxes[a, 0, c] <= p[c] <= boxes[a, 1, c]:
                return False
            continue
        one, two = (boxes[a, 0, c] - p[c]) / d[c], (boxes[a, 1, c] - p[c]) / d[c]
        near, far = max(near, min(one, two)), min(far, max(one, two))
    return near <= far


@part
def rays_meet(
    geometry: Geometry, surfaces: Surfaces, boxes: np.ndarray, p: Vec3, a: int, x: Vec3
) -> bool:
    """Whether a ray of `plane_sequences` from a point meets plane `a` first. Rays near the way to `x` are tried
    first, and only those that pass the plane's bounds `boxes` (P, 2, 3)."""
    z = (x[2] - p[2]) / max(distance(x, p), _LEAST)
    middle = min(max(int(0.5 * (1.0 - z) * _RAYS), 0), _RAYS - 1)
    for n in range(2 * _RAYS):
        k = middle + (n + 1) // 2 if n % 2 else middle - n // 2
        if not 0 <= k < _RAYS:
            continue
        d = ray_direction(k, _RAYS)
        if _may_meet(boxes, a, p, d):
            _, triangle = cast_ray(geometry, p, d, math.inf)
            if triangle >= 0 and _specular_plane(geometry, surfaces, triangle) == a:
                return True
    return False


def plane_sequences(side: Side) -> Sequences:
    """The planes that rays from the points of a side meet: `side.once(plane_sequences)`."""
    return sequences_by(side, _RAYS)


def sequences_by(side: Side, rays: int) -> Sequences:
    """`plane_sequences` with so many rays."""
    world, planes, points = side.model.world, side.model.prepared.part(prepare_planes), side.ends.points
    count = len(planes.offset)
    seen = np.zeros((len(points), count, count + 1), np.bool_)
    over_rows(_find_sequences, len(points), world.geometry, world.surfaces, planes, points, rays, seen)
    rows = np.argwhere(seen)
    start = np.searchsorted(rows[:, 0], np.arange(len(points) + 1))
    found = rows[:, 1:].copy()
    found[found[:, 1] == count, 1] = -1
    return Sequences(seen, start, found)
