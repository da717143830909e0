"""Direct sound: the straight segment, attenuated by every surface that it crosses. Deterministic.

Energy of 1 J emitted, per m²: 1 / (4 pi r²), times the transmission of every surface between, times air.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.limits import LEAST_DISTANCE
from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.vec3 import distance, row
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.transport.bsdf.surface import Surfaces
from soundspaces_sim.transport.elements import cross_walls
from soundspaces_sim.transport.state import Ends
from soundspaces_sim.transport.tile import Tile

_LEAST = 1e-9  # of the unobstructed energy


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
            walls[i, j] = cross_walls(scene.geometry, scene.surfaces, p, q, e)
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
