"""The kernel of this room: single rays."""

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.scene.rays.geometry import cast


@kernel
def probe(geometry, x, y, z, dx, dy, dz, limit):
    """(distance, triangle) of the nearest surface along a unit direction; (inf, -1) if none within `limit`."""
    return cast(geometry, x, y, z, dx, dy, dz, limit)
