"""Points in general position: off the planes of faces, the lines by edges and the boundaries of shadows.

Points and walls of round coordinates lie there exactly: a point on the plane of a jamb, an edge on the line between
two points. The field is continuous there, but rounding would decide what is hidden and what is in sight, for the
direct sound and for each edge by itself, and levels were off by up to 9 dB.
"""

from __future__ import annotations

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.rng import hashed_uniform, point_keys
from soundspaces_sim.core.numerics.vec3 import along, put, row
from soundspaces_sim.scene.rays.geometry import Geometry, unoccluded
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.model import Model

_STEP = 0.5  # of how far rays start off a surface
_AROUND = 12.0  # steps within which there may be no surface, along each axis


@kernel
def _moved(geometry: Geometry, keys: np.ndarray, points: np.ndarray, out: np.ndarray) -> None:
    step = _STEP * geometry.epsilon
    reach = _AROUND * step
    axes = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    for i in range(len(points)):
        p = row(points, i)
        free = True
        for axis in axes:
            free = free and unoccluded(geometry, along(p, -reach, axis), along(p, reach, axis))
        if free:
            z, turn = 2.0 * hashed_uniform(keys[i], 0) - 1.0, 2.0 * math.pi * hashed_uniform(keys[i], 1)
            flat = math.sqrt(1.0 - z * z)
            p = along(p, step, (flat * math.cos(turn), flat * math.sin(turn), z))
        put(out, i, p)


def in_general_position(model: Model, points: np.ndarray) -> np.ndarray:
    """(N, 3) m about the scene's centre, of points (N, 3) m in its frame.

    In a scene whose edges diffract each is moved by `_STEP` times `Geometry.epsilon` (.02 mm in a room of 6 m) in a
    direction drawn from its coordinates, the same in any tile and for any seed. A point as near to a surface stays,
    as it could get to the other side.
    """
    local = np.ascontiguousarray(points - model.scene.center)
    if len(model.prepared.part(prepare_wedges).wedges.length) == 0:
        return local
    out = np.empty_like(local)
    _moved(model.world.geometry, point_keys(points, 0), local, out)
    return out
