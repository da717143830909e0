"""Single rays, as Python calls them."""

import math

import numpy as np

from soundspaces_sim.parts import Geometry, cast_ray, kernel


@kernel
def probe(
    geometry: Geometry, origin: np.ndarray, direction: np.ndarray, limit: float
) -> tuple[float, int]:
    """(distance, triangle) of the nearest surface along a unit `direction`; (inf, -1) if none within `limit` m."""
    o, d = (origin[0], origin[1], origin[2]), (direction[0], direction[1], direction[2])
    return cast_ray(geometry, o, d, limit)


@kernel
def cast_pixels(
    geometry: Geometry,
    origin: np.ndarray,
    rays: np.ndarray,
    near: float,
    far: float,
    depth: np.ndarray,
    triangle: np.ndarray,
) -> None:
    """Depth (h, w) in lengths of each ray (h, w, 3) and the triangle (h, w) that it meets first; 0 and -1 where it
    meets none at a depth of `near` to `far`."""
    o = origin[0], origin[1], origin[2]
    for i in range(rays.shape[0]):
        for j in range(rays.shape[1]):
            x, y, z = rays[i, j, 0], rays[i, j, 1], rays[i, j, 2]
            length = math.sqrt(x * x + y * y + z * z)
            d = x / length, y / length, z / length
            begin = near * length
            start = o[0] + begin * d[0], o[1] + begin * d[1], o[2] + begin * d[2]
            distance, hit = cast_ray(geometry, start, d, far * length - begin)
            depth[i, j] = (begin + distance) / length if hit >= 0 else 0.0
            triangle[i, j] = hit
