"""Direct sound: the straight segment, attenuated by every surface that it crosses. Deterministic.

Energy of 1 J emitted, per m²: 1 / (4 pi r²), times the transmission of every surface between, times air.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.limits import LEAST_DISTANCE
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, distance, divide, dot, length, row, subtract
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray, material_met
from soundspaces_sim.transport.bsdf.surface import Surfaces, attenuate_transmission
from soundspaces_sim.transport.state import Ends
from soundspaces_sim.transport.tile import Tile

_LEAST = 1e-9  # of the unobstructed energy
_MAX_WALLS = 256


@part
def _cross_walls(geometry: Geometry, surfaces: Surfaces, p: Vec3, q: Vec3, energy: np.ndarray) -> int:
    """Multiply `energy` (b,) by the transmission of the surfaces between two points; their number."""
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
        t, triangle = cast_ray(geometry, along(p, at, d), d, left)
        if triangle < 0:
            return walls
        cos, material = abs(dot(row(geometry.normal, triangle), d)), material_met(geometry, triangle, d)
        if attenuate_transmission(surfaces, material, cos, energy) < _LEAST:
            break
        at += t + geometry.epsilon / max(cos, 0.05)
    energy[:] = 0.0
    return 1


class _Scene(NamedTuple):
    geometry: Geometry
    surfaces: Surfaces
    least_distance: float  # m, shorter ones count as this


@kernel
def _direct_paths(
    first: int,
    last: int,
    scene: _Scene,
    a: Ends,
    b: Ends,
    energy: np.ndarray,
    walls: np.ndarray,
) -> None:
    """Fill rows of `energy` (A, B, b), without air, and of `walls` (A, B)."""
    for i in range(first, last):
        for j in range(len(b.points)):
            p, q = row(a.points, i), row(b.points, j)
            if a.keys[i] > b.keys[j]:  # one direction per pair, so that both ends agree to the bit
                p, q = q, p
            e = energy[i, j]
            e[:] = 1.0
            walls[i, j] = _cross_walls(scene.geometry, scene.surfaces, p, q, e)
            r = max(distance(q, p), scene.least_distance)
            for band in range(len(e)):
                e[band] = e[band] * INV_4PI / r**2
                if e[band] < _LEAST * INV_4PI / r**2:
                    e[band] = 0.0


def direct_sound(tile: Tile) -> None:
    """Direct sound of every pair, without air."""
    world, a, b = tile.model.world, tile.a.ends, tile.b.ends
    scene = _Scene(world.geometry, world.surfaces, LEAST_DISTANCE)
    over_rows(_direct_paths, len(a.points), scene, a, b, tile.direct, tile.walls)
