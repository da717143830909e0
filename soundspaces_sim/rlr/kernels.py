"""Single rays, as Python calls them."""

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray


@kernel
def probe(
    geometry: Geometry, origin: np.ndarray, direction: np.ndarray, limit: float
) -> tuple[float, int]:
    """(distance, triangle) of the nearest surface along a unit `direction`; (inf, -1) if none within `limit` m."""
    o, d = (origin[0], origin[1], origin[2]), (direction[0], direction[1], direction[2])
    return cast_ray(geometry, o, d, limit)
