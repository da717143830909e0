"""How large the patches of a scene are: as its rooms ask for.

A patch's size makes the light that falls on it even, and the times of paths vague, in proportion to how far sound
goes from surface to surface. Where that is far, patches may be as much larger: a hall of 100,000 m³ has a
twentieth as many as of 0.8 m. Half of the ways from surface to surface are at least `_WAYS` patches long.
"""

from __future__ import annotations

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.scene.rays.directions import sample_cosine_hemisphere, stratified_pair
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray, lifted
from soundspaces_sim.scene.triangles import points_on
from soundspaces_sim.transport.radiance_transfer.patches import PATCH_SIZE

_RAYS = 4096
_WAYS = 8.0  # sizes of a patch: 0.8 m in rooms where half of the ways are shorter than 6.4 m


@kernel
def _measure_ways(
    first: int,
    last: int,
    geometry: Geometry,
    triangle: np.ndarray,
    places: np.ndarray,
    found: np.ndarray,
) -> None:
    """Fill `found` (n, 2), m: from `places` (n, 3) on triangles to the next surface on either side, inf if there is
    none, in a direction of Lambert's law."""
    for i in range(first, last):
        n, place = row(geometry.normal, triangle[i]), row(places, i)
        for side in range(2):
            normal = n if side == 0 else (-n[0], -n[1], -n[2])
            direction = sample_cosine_hemisphere(normal, *stratified_pair(2 * i + side, 0.0, 0.0))
            found[i, side] = cast_ray(geometry, lifted(geometry, place, normal), direction, math.inf)[0]


def patch_size(geometry: Geometry, corners: np.ndarray, areas: np.ndarray) -> float:
    """Edge of the lattice of patches, m, of triangles with `corners` (F, 3, 3), in m, and `areas` (F,)."""
    upto = np.cumsum(areas)
    at = (np.arange(_RAYS) + 0.5) / _RAYS * upto[-1]
    triangle = np.minimum(np.searchsorted(upto, at, "right"), len(upto) - 1)
    u, v = np.modf(np.arange(1, _RAYS + 1)[:, None] * np.array([math.sqrt(2.0), math.sqrt(3.0)]))[0].T
    places = points_on(corners[triangle], u, v)
    ways = np.empty((_RAYS, 2))
    over_rows(_measure_ways, _RAYS, geometry, triangle, places, ways, least=_RAYS)
    met = ways[np.isfinite(ways)]
    return max(PATCH_SIZE, float(np.median(met)) / _WAYS) if len(met) else PATCH_SIZE
