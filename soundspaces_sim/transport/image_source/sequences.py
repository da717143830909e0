"""Sequences of specular planes that are worth solving for a point: those that rays from it meet.

The rays are a dense, deterministic set of directions (a Fibonacci lattice), so that a pair's sequences are the same
in any tile. A pair tries those of both of its ends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, reflect, row
from soundspaces_sim.scene.rays.directions import sample_sphere
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray, material_met, surface_point
from soundspaces_sim.transport.bsdf.surface import Surfaces, specular_albedo
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.specular_planes import SpecularPlanes
from soundspaces_sim.transport.tile import Side

_RAYS = 8192
_GOLDEN = 0.6180339887498949


class Sequences(NamedTuple):
    """Planes worth trying from the points of a side."""

    seen: np.ndarray  # (N, P, P + 1), see `_find_sequences`
    start: np.ndarray  # (N + 1,) where each point's rows of `planes` start
    planes: np.ndarray  # (n, 2) plane, and the second one or -1


@part
def _specular_plane(geometry: Geometry, surfaces: Surfaces, triangle: int, direction: Vec3) -> int:
    """Plane of a triangle that reflects sound of this direction specularly in any band, else -1."""
    if specular_albedo(surfaces, material_met(geometry, triangle, direction)) > 0.0:
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
    seen: np.ndarray,
) -> None:
    """Set flags (N, P, P + 1): from point i, rays meet plane a alone ([a, P]) or a and then b ([a, b])."""
    count = len(planes.offset)
    for i in range(first, last):
        if count == 0:
            continue
        p = row(points, i)
        for k in range(_RAYS):
            v = k * _GOLDEN
            d = sample_sphere((k + 0.5) / _RAYS, v - math.floor(v))
            t, triangle = cast_ray(geometry, p, d, math.inf)
            if triangle < 0:
                continue
            a = _specular_plane(geometry, surfaces, triangle, d)
            if a < 0:
                continue
            seen[i, a, count] = True
            x, n = surface_point(geometry, triangle, p, d, t)
            x = along(x, geometry.epsilon + planes.margin[a], n)
            d = reflect(d, row(planes.normal, a))
            t, triangle = cast_ray(geometry, x, d, math.inf)
            if triangle < 0:
                continue
            b = _specular_plane(geometry, surfaces, triangle, d)
            if b >= 0 and b != a:
                seen[i, a, b] = True


def plane_sequences(side: Side) -> Sequences:
    """The planes that rays from the points of a side meet: `side.once(plane_sequences)`."""
    world, planes, points = side.model.world, side.model.prepared.part(prepare_planes), side.ends.points
    count = len(planes.offset)
    seen = np.zeros((len(points), count, count + 1), np.bool_)
    over_rows(_find_sequences, len(points), world.geometry, world.surfaces, planes, points, seen)
    rows = np.argwhere(seen)
    start = np.searchsorted(rows[:, 0], np.arange(len(points) + 1))
    found = rows[:, 1:].copy()
    found[found[:, 1] == count, 1] = -1
    return Sequences(seen, start, found)
