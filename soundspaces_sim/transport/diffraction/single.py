"""First-order diffraction at rigid wedges: one arrival for each edge.

For a pair out of sight of each other, a path by every wedge that both see and in whose shadow they are, by way of
the apex (`paths`); its field is that of the uniform theory (`utd`). Where it passes another edge closely, before
or after, the path by both edges is added to it (`passed_edges`). For a pair in sight, the direct sound takes the
factor |1 + p_d / p_direct|² of the edges that it passes closely (`energy.Interference`). Subpaths are never
diffracted: nothing is counted twice.
"""

from __future__ import annotations

import numpy as np

from soundspaces_sim.transport.diffraction.edge_kernel import BY_ONE, find_paths, of_points
from soundspaces_sim.transport.diffraction.points import edges_of_scene
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.tile import Tile


def connect(tile: Tile) -> PathTable | None:
    """Paths by one edge of every pair, and what edges take from the direct sound."""
    scene = tile.model.once(edges_of_scene)
    if scene is None:
        return None
    context = of_points(tile, scene, BY_ONE)
    paths = find_paths(tile, context)
    factor = context.factor.reshape(tile.direct.shape)
    wave, passed = context.wave.reshape(*factor.shape, -1), context.passed.reshape(tile.walls.shape)
    if tile.same:  # pairs i <= j were done, and count for both directions
        upper = np.tri(len(tile.a.ends.points), dtype=bool).T[:, :, None]
        factor = np.where(upper, factor, factor.transpose(1, 0, 2))
        wave = np.where(upper[..., None], wave, wave.transpose(1, 0, 2, 3))
        passed = np.where(upper[..., 0], passed, passed.T)
    tile.direct *= factor
    tile.direct_wave, tile.passed = wave, passed
    return paths
