"""The scene as kernels see it: a ray handle and flat arrays, coordinates relative to its centre."""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.scene.rays.embree import intersect, occluded


class Geometry(NamedTuple):
    """F triangles."""

    handle: int  # of the RayScene
    anchor: np.ndarray  # (F, 3) first vertex of each triangle, m
    normal: np.ndarray  # (F, 3) unit
    material: np.ndarray  # (F,) row of Surfaces
    plane: np.ndarray  # (F,) row of the planes that mirror early sound, or -1
    epsilon: float  # m, offset of ray origins from the surface they leave


@part(forceinline=True)
def hit_point(geometry, triangle, px, py, pz, dx, dy, dz, t):
    """Point at `t` along a ray, put on its triangle's plane, and the normal on the incoming side."""
    normal, anchor = geometry.normal, geometry.anchor
    nx, ny, nz = normal[triangle, 0], normal[triangle, 1], normal[triangle, 2]
    ax, ay, az = anchor[triangle, 0], anchor[triangle, 1], anchor[triangle, 2]
    if nx * dx + ny * dy + nz * dz > 0.0:
        nx, ny, nz = -nx, -ny, -nz
    x, y, z = px + t * dx, py + t * dy, pz + t * dz
    off = (x - ax) * nx + (y - ay) * ny + (z - az) * nz
    return x - off * nx, y - off * ny, z - off * nz, nx, ny, nz


@part(forceinline=True)
def visible(geometry, px, py, pz, qx, qy, qz):
    """True if nothing lies between two points (both already off their surfaces)."""
    dx, dy, dz = qx - px, qy - py, qz - pz
    r = np.sqrt(dx * dx + dy * dy + dz * dz)
    if r <= geometry.epsilon:
        return True
    return not occluded(geometry.handle, px, py, pz, dx / r, dy / r, dz / r, r - geometry.epsilon)


@part(forceinline=True)
def cast(geometry, px, py, pz, dx, dy, dz, limit):
    """(distance, triangle) of the nearest surface; (inf, -1) if none within `limit`."""
    return intersect(geometry.handle, px, py, pz, dx, dy, dz, limit)
