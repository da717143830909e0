"""Direct sound: the straight segment, weakened by every wall that it crosses. Deterministic."""

import math

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import cast
from soundspaces_sim.transport.bsdf import THROUGH
from soundspaces_sim.transport.bsdf.surface import weaken
from soundspaces_sim.transport.model import air_transmission
from soundspaces_sim.transport.tile import Tile

_LEAST = 1e-9  # of the unobstructed energy
_MAX_WALLS = 256


@part
def _walls(geometry, surfaces, p, q, energy):
    """Multiply `energy` (b,) by the transmission of the walls between two points; their number."""
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    r = math.sqrt(dx * dx + dy * dy + dz * dz)
    if r <= geometry.epsilon:
        return 0
    dx, dy, dz = dx / r, dy / r, dz / r
    at = geometry.epsilon  # as at the other end: a point on a surface is in front of it
    for walls in range(_MAX_WALLS):
        left = r - geometry.epsilon - at
        if left <= 0.0:
            return walls
        t, triangle = cast(geometry, p[0] + at * dx, p[1] + at * dy, p[2] + at * dz, dx, dy, dz, left)
        if triangle < 0:
            return walls
        nx, ny, nz = geometry.normal[triangle]
        cos = abs(nx * dx + ny * dy + nz * dz)
        if weaken(surfaces, geometry.material[triangle], THROUGH, cos, energy, 1.0) < _LEAST:
            break
        at += t + geometry.epsilon / max(cos, 0.05)
    energy[:] = 0.0
    return 1


@kernel
def _direct_paths(
    first, last, geometry, surfaces, points_a, points_b, keys_a, keys_b, least_distance, energy, walls
):
    """Fill rows of `energy` (A, B, b), without air, and of `walls` (A, B)."""
    for i in range(first, last):
        for j in range(len(points_b)):
            p = (points_a[i, 0], points_a[i, 1], points_a[i, 2])
            q = (points_b[j, 0], points_b[j, 1], points_b[j, 2])
            if keys_a[i] > keys_b[j]:  # one direction per pair, so that both ends agree to the bit
                p, q = q, p
            e = energy[i, j]
            e[:] = 1.0
            walls[i, j] = _walls(geometry, surfaces, p, q, e)
            r = math.sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2 + (q[2] - p[2]) ** 2)
            for band in range(len(e)):
                e[band] = e[band] * INV_4PI / max(r, least_distance) ** 2
                if e[band] < _LEAST * INV_4PI / max(r, least_distance) ** 2:
                    e[band] = 0.0


def connect(tile: Tile) -> None:
    """Direct sound of every pair."""
    world, config, a, b = tile.model.world, tile.model.config, tile.a.ends, tile.b.ends
    over_rows(
        _direct_paths, len(a.points), world.geometry, world.surfaces, a.points, b.points, a.keys, b.keys,
        config.least_distance, tile.direct, tile.walls,
    )  # fmt: skip
    tile.direct *= air_transmission(config, tile.distance)
