"""Second-order diffraction: round a wall as thick as it is, over one obstacle and then another.

For a pair out of sight of each other, a path by every two wedges that see each other, of which one sees one end
and the other the other, if it is the shortest path by way of both edges, and in the shadow of both. In sight these
paths fade (`by_edges`). Where an end lies in the light of the farther edge the path belongs to `single`, which adds
it to that by one edge. The field is `two_edges`'. Wedges are rigid.
"""

from __future__ import annotations

from soundspaces_sim.transport.diffraction.edge_kernel import BY_TWO, find_paths, of_points
from soundspaces_sim.transport.diffraction.points import edges_of_scene
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.tile import Tile


def connect(tile: Tile) -> PathTable | None:
    """Paths by two edges of every pair out of sight, or nearly."""
    scene = tile.model.once(edges_of_scene)
    if scene is None or len(scene.wedges.length) < 2:
        return None
    return find_paths(tile, of_points(tile, scene, BY_TWO))
