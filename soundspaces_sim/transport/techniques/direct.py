"""Direct sound: the straight segment, weakened by every wall that it crosses. Deterministic."""

import math

import numpy as np
from numba import prange

from soundspaces_sim.base.kernel import kernel
from soundspaces_sim.rays.directions import INV_4PI
from soundspaces_sim.rays.geometry import cast
from soundspaces_sim.transport.surface import THROUGH

_LEAST = 1e-9  # of the unobstructed energy
_MAX_WALLS = 256


@kernel
def _walls(geometry, surfaces, p, q, energy):
    """Multiply `energy` (b,) by the transmission of the walls between two points; their number."""
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    r = math.sqrt(dx * dx + dy * dy + dz * dz)
    if r <= geometry.epsilon:
        return 0
    dx, dy, dz = dx / r, dy / r, dz / r
    at = 0.0
    for walls in range(_MAX_WALLS):
        left = r - geometry.epsilon - at
        if left <= 0.0:
            return walls
        t, triangle = cast(geometry, p[0] + at * dx, p[1] + at * dy, p[2] + at * dz, dx, dy, dz, left)
        if triangle < 0:
            return walls
        alive = False
        for band in range(len(energy)):
            energy[band] *= surfaces.energy[geometry.material[triangle], THROUGH, band]
            alive |= energy[band] >= _LEAST
        if not alive:
            break
        nx, ny, nz = geometry.normal[triangle]
        cos = abs(nx * dx + ny * dy + nz * dz)
        at += t + geometry.epsilon / max(cos, 0.05)
    energy[:] = 0.0
    return 1


@kernel(parallel=True)
def direct_paths(geometry, surfaces, points_a, points_b, keys_a, keys_b, least_distance):
    """Energy (A, B, b) without air, length (A, B) and number of walls crossed (A, B)."""
    bands = surfaces.energy.shape[2]
    energy = np.empty((len(points_a), len(points_b), bands))
    length = np.empty((len(points_a), len(points_b)))
    walls = np.empty((len(points_a), len(points_b)), np.int64)
    for i in prange(len(points_a)):
        for j in range(len(points_b)):
            p = (points_a[i, 0], points_a[i, 1], points_a[i, 2])
            q = (points_b[j, 0], points_b[j, 1], points_b[j, 2])
            if keys_a[i] > keys_b[j]:  # one direction per pair, so that both ends agree to the bit
                p, q = q, p
            e = energy[i, j]
            e[:] = 1.0
            walls[i, j] = _walls(geometry, surfaces, p, q, e)
            r = math.sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2 + (q[2] - p[2]) ** 2)
            length[i, j] = r
            for band in range(bands):
                e[band] = e[band] * INV_4PI / max(r, least_distance) ** 2
                if e[band] < _LEAST * INV_4PI / max(r, least_distance) ** 2:
                    e[band] = 0.0
    return energy, length, walls
