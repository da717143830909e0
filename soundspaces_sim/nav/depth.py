"""Depth pictures by casting rays."""

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.scene.rays.geometry import Geometry, cast


@kernel
def cast_depth(
    geometry: Geometry, camera: np.ndarray, headings: np.ndarray, size: int, out: np.ndarray
) -> None:
    """z-depth in m of a camera at (3,), 90° by 90°, per heading (radians), into `out` (k, size, size);
    0 where nothing is hit. Rows from the top, columns from the left."""
    x, y, z = camera
    for k in range(len(headings)):
        c, s = math.cos(headings[k]), math.sin(headings[k])
        for i in range(size):
            up = 1.0 - (2.0 * i + 1.0) / size
            for j in range(size):
                left = 1.0 - (2.0 * j + 1.0) / size
                length = math.sqrt(1.0 + left * left + up * up)
                dx, dy = (c - s * left) / length, (s + c * left) / length
                distance, triangle = cast(geometry, x, y, z, dx, dy, up / length, math.inf)
                out[k, i, j] = distance / length if triangle >= 0 else 0.0
