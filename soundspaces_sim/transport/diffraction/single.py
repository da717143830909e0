"""First-order diffraction at rigid wedges: one arrival for each edge.

For a pair out of sight of each other, a path by every wedge that both see and in whose shadow they are, by way of
the apex (`paths`); its field is that of the uniform theory (`utd`). Where it passes another edge closely, before
or after, the path by both edges is added to it (`passed_edges`). For a pair in sight, the direct sound takes the
factor |1 + p_d / p_direct|² of the edges that it passes closely (`energy.Interference`). Subpaths are never
diffracted: nothing is counted twice.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.vec3 import distance
from soundspaces_sim.transport.diffraction.by_edges import (
    EdgeScratch,
    make_edge_scratch,
    one_edge_paths,
    pair_of,
    points_between,
    release,
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
from soundspaces_sim.transport.path_table import WAVE_POINTS, PathSlots, PathTable
from soundspaces_sim.transport.tile import Tile


class _Context(NamedTuple):
    """What the kernel reads, and `factor` and `wave`, which it fills."""

    scene: EdgesOfScene
    spectrum: Spectrum
    a: EdgePoints
    b: EdgePoints
    walls: np.ndarray  # (A, B) between the points; 0: they see each other
    factor: np.ndarray  # (A, B, b) of the direct sound
    wave: np.ndarray  # (A, B, b, n) complex, of the direct sound


@kernel
def _single_paths(
    first: int, last: int, context: _Context, pairs: np.ndarray, slots: PathSlots, scratch: EdgeScratch
) -> None:
    """Paths of pairs by one edge, and the factor of their direct sound."""
    scene, spectrum = context.scene, context.spectrum
    for k in range(first, last):
        i, j = pairs[k]
        p, q = seen_point(context.a, i), seen_point(context.b, j)
        if distance(p.end.at, q.end.at) <= scene.sight.geometry.epsilon:
            continue
        swapped = context.a.keys[i] > context.b.keys[j]
        between = points_between(p, q, context.walls[i, j], swapped, slots, k)
        passed, _ = one_edge_paths(scene, spectrum, between, pair_of(between, scratch), scratch)
        if passed:
            for b in range(context.factor.shape[2]):
                context.factor[i, j, b] = scratch.wave.energy[b]
                for n in range(context.wave.shape[3]):
                    context.wave[i, j, b, n] = scratch.wave.field[b, n]
        release(between, scratch)


def connect(tile: Tile) -> PathTable | None:
    """Paths by one edge of every pair, and what edges take from the direct sound."""
    model = tile.model
    scene = model.once(edges_of_scene)
    if scene is None:
        return None
    spectrum = make_spectrum(model.config.bands, model.config.c)
    factor = np.ones_like(tile.direct)
    wave = np.ones((*factor.shape, WAVE_POINTS), np.complex128)
    a, b = tile.a.once(edge_points), tile.b.once(edge_points)
    context = _Context(scene, spectrum, a, b, tile.walls, factor, wave)

    def scratch() -> EdgeScratch:
        return make_edge_scratch(len(scene.wedges.length), len(scene.mutual.wedge), spectrum)

    paths = for_each_pair(tile, _single_paths, context, tile.pairs, scratch)
    if tile.same:  # pairs i <= j were done, and count for both directions
        upper = np.tri(len(tile.a.ends.points), dtype=bool).T[:, :, None]
        factor = np.where(upper, factor, factor.transpose(1, 0, 2))
        wave = np.where(upper[..., None], wave, wave.transpose(1, 0, 2, 3))
    tile.direct *= factor
    tile.direct_wave = wave
    return paths
