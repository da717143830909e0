"""Second-order diffraction: round a wall as thick as it is, over one obstacle and then another.

For a pair out of sight of each other, a path by every two wedges that see each other, of which one sees one end
and the other the other, if it is the shortest path by way of both edges, and in the shadow of both. In sight these
paths fade (`by_edges`). Where an end lies in the light of the farther edge the path belongs to `single`, which adds
it to that by one edge. The field is `two_edges`'. Wedges are rigid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.vec3 import distance
from soundspaces_sim.transport.diffraction.by_edges import (
    EdgeScratch,
    make_edge_scratch,
    nearest_passed,
    pair_of,
    points_between,
    release,
    two_edge_paths,
)
from soundspaces_sim.transport.diffraction.passed_edges import EdgesOfScene
from soundspaces_sim.transport.diffraction.points import (
    EdgePoints,
    edge_points,
    edges_of_scene,
    seen_point,
)
from soundspaces_sim.transport.diffraction.spectrum import Spectrum, make_spectrum
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.path_table import PathSlots, PathTable
from soundspaces_sim.transport.tile import Tile


class _Context(NamedTuple):
    """What the kernel reads."""

    scene: EdgesOfScene
    spectrum: Spectrum
    a: EdgePoints
    b: EdgePoints
    walls: np.ndarray  # (A, B) between the points; 0: they see each other


@kernel
def _double_paths(
    first: int, last: int, context: _Context, pairs: np.ndarray, slots: PathSlots, scratch: EdgeScratch
) -> None:
    """Paths of pairs by two edges."""
    scene, spectrum = context.scene, context.spectrum
    for k in range(first, last):
        i, j = pairs[k]
        p, q = seen_point(context.a, i), seen_point(context.b, j)
        if distance(p.end.at, q.end.at) <= scene.sight.geometry.epsilon:
            continue
        swapped = context.a.keys[i] > context.b.keys[j]
        between = points_between(p, q, context.walls[i, j], swapped, slots, k)
        nearest = nearest_passed(scene, between, pair_of(between, scratch))
        two_edge_paths(scene, spectrum, between, nearest, scratch)
        release(between, scratch)


def connect(tile: Tile) -> PathTable | None:
    """Paths by two edges of every pair out of sight, or nearly."""
    scene, config = tile.model.once(edges_of_scene), tile.model.config
    if scene is None or len(scene.wedges.length) < 2:
        return None
    spectrum = make_spectrum(config.bands, config.c)
    a, b = tile.a.once(edge_points), tile.b.once(edge_points)
    context = _Context(scene, spectrum, a, b, tile.walls)

    def scratch() -> EdgeScratch:
        return make_edge_scratch(len(scene.wedges.length), len(scene.mutual.wedge), spectrum)

    return for_each_pair(tile, _double_paths, context, tile.pairs, scratch)
