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

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, row, subtract
from soundspaces_sim.echogram.echogram import EDGE
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.diffraction.energy import Interference, mean_energy, write_factor
from soundspaces_sim.transport.diffraction.passed_edges import (
    EdgePair,
    EdgesOfScene,
    PassedScratch,
    clear_rows,
    make_passed_scratch,
    past_others,
    set_rows,
    single_path,
)
from soundspaces_sim.transport.diffraction.passed_in_sight import add_passed, interference
from soundspaces_sim.transport.diffraction.paths import next_common
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.spectrum import Spectrum, make_spectrum
from soundspaces_sim.transport.diffraction.visible_wedges import (
    VisibleWedges,
    coordinates_in,
    visible_wedges,
)
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.path_table import FoundPath, PathSlots, PathTable, store
from soundspaces_sim.transport.tile import Tile

_MIN_SHARE = 1e-6  # of the free field's energy


class _Context(NamedTuple):
    """What the kernel reads, and `factor`, which it fills."""

    scene: EdgesOfScene
    spectrum: Spectrum
    points_a: np.ndarray  # (A, 3) m
    points_b: np.ndarray  # (B, 3) m
    keys_a: np.ndarray  # (A,) of `point_keys`: the smaller one's point is p
    keys_b: np.ndarray  # (B,)
    visible_a: VisibleWedges
    visible_b: VisibleWedges
    walls: np.ndarray  # (A, B) between the points; 0: they see each other
    factor: np.ndarray  # (A, B, b) of the direct sound


class _Scratch(NamedTuple):
    energy: np.ndarray  # (b,)
    sums: Interference
    passed: PassedScratch


@part(forceinline=True)
def one_edge(e: int, at: Vec3, p: Vec3, q: Vec3, group: int) -> FoundPath:
    """The path from p by a point of edge `e` to q; `group` of what reflects it there, -1 for none."""
    to_q, to_p = distance(at, q), distance(at, p)
    at_q, at_p = divide(subtract(at, q), to_q), divide(subtract(at, p), to_p)
    return FoundPath(to_p + to_q, at_q, at_p, (-1, -1), EDGE, (e, -1), (group, -1))


@kernel
def _single_paths(
    first: int, last: int, context: _Context, pairs: np.ndarray, slots: PathSlots, scratch: _Scratch
) -> None:
    """Paths of pairs by one edge, and the factor of their direct sound."""
    for k in range(first, last):
        i, j = pairs[k]
        if distance(row(context.points_a, i), row(context.points_b, j)) > context.scene.geometry.epsilon:
            set_rows(context.visible_a, i, scratch.passed.row_a)
            set_rows(context.visible_b, j, scratch.passed.row_b)
            _paths_of_pair(context, i, j, k, slots, scratch)
            clear_rows(context.visible_a, i, scratch.passed.row_a)
            clear_rows(context.visible_b, j, scratch.passed.row_b)


@part
def _pair(context: _Context, i: int, j: int, scratch: _Scratch) -> EdgePair:
    """The points i and j, in an order that does not depend on which of them is the source."""
    p, q = row(context.points_a, i), row(context.points_b, j)
    lit, passed = context.walls[i, j] == 0, scratch.passed
    if context.keys_a[i] > context.keys_b[j]:
        return EdgePair(q, p, passed.row_b, passed.row_a, lit)
    return EdgePair(p, q, passed.row_a, passed.row_b, lit)


@part
def _paths_of_pair(
    context: _Context, i: int, j: int, k: int, slots: PathSlots, scratch: _Scratch
) -> None:
    """`_single_paths` of pair `k`, of the points i and j."""
    scene, spectrum, passed = context.scene, context.spectrum, scratch.passed
    visible_a, visible_b, found = context.visible_a, context.visible_b, 0
    pair = _pair(context, i, j, scratch)
    p, q = row(context.points_a, i), row(context.points_b, j)
    own, end = visible_a.start[i] - 1, visible_a.start[i + 1]
    other, stop = visible_b.start[j] - 1, visible_b.start[j + 1]
    while True:
        own, other = next_common(visible_a.wedge, own + 1, end, visible_b.wedge, other + 1, stop)
        if own >= end or other >= stop:
            break
        e = visible_a.wedge[own]
        s, r = coordinates_in(visible_a, own), coordinates_in(visible_b, other)
        ok, path, at = single_path(scene, e, s, r, pair)
        if not ok:
            continue
        if pair.lit:
            found = add_passed(e, path, spectrum.lit, distance(p, q), passed, found)
        elif past_others(scene, e, path, pair, spectrum.shadow, passed):
            most, total = (
                mean_energy(passed.field[0], spectrum.shadow, scratch.energy),
                path.d_s + path.d_r,
            )
            if most >= _MIN_SHARE * INV_4PI / (total * total):
                store(slots, k, one_edge(e, at, p, q, -1), scratch.energy)
    if found > 0:
        interference(scene, pair, spectrum.lit, found, passed, scratch.sums)
        write_factor(scratch.sums, spectrum.lit, context.factor[i, j])


def connect(tile: Tile) -> PathTable | None:
    """Paths by one edge of every pair, and what edges take from the direct sound."""
    model, a, b = tile.model, tile.a.ends, tile.b.ends
    wedges, mutual = model.prepared.part(prepare_wedges)
    if len(wedges.length) == 0:
        return None
    spectrum = make_spectrum(model.config.bands, model.config.c)
    factor = np.ones_like(tile.direct)
    context = _Context(
        scene=EdgesOfScene(model.world.geometry, wedges, mutual),
        spectrum=spectrum,
        points_a=a.points,
        points_b=b.points,
        keys_a=a.keys,
        keys_b=b.keys,
        visible_a=tile.a.once(visible_wedges),
        visible_b=tile.b.once(visible_wedges),
        walls=tile.walls,
        factor=factor,
    )

    def scratch() -> _Scratch:
        shape = spectrum.lit.k.shape
        sums = Interference(np.empty(shape, np.complex128), np.empty(shape))
        return _Scratch(np.empty(shape[0]), sums, make_passed_scratch(len(wedges.length), spectrum))

    paths = for_each_pair(tile, _single_paths, context, tile.pairs, scratch)
    if tile.same:  # pairs i <= j were done, and count for both directions
        upper = np.tri(len(a.points), dtype=bool).T[:, :, None]
        factor = np.where(upper, factor, factor.transpose(1, 0, 2))
    tile.direct *= factor
    return paths
