"""Second-order diffraction: round a wall as thick as it is, over one obstacle and then another.

For a pair out of sight of each other, a path by every two wedges that see each other, of which one sees one end
and the other the other, if it is the shortest path by way of both edges, and in the shadow of both. In sight these
paths fade (`_fading`). Where an end lies in the light of the farther edge the path belongs to `single`, which adds
it to that by one edge. The field is `two_edges`'. Wedges are rigid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, row, subtract
from soundspaces_sim.echogram.echogram import TWO_EDGES
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.transport.diffraction.double_wedge import (
    DoubleWedgeScratch,
    make_double_wedge_scratch,
)
from soundspaces_sim.transport.diffraction.energy import mean_energy
from soundspaces_sim.transport.diffraction.mutual_visibility import MutualVisibility
from soundspaces_sim.transport.diffraction.passed_edges import EdgePair, EdgesOfScene, single_path
from soundspaces_sim.transport.diffraction.paths import cosine_taper, next_common
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.spectrum import Quadrature, make_spectrum
from soundspaces_sim.transport.diffraction.two_edge_sight import alone, legs_clear
from soundspaces_sim.transport.diffraction.two_edges import path_length, two_edge_field, two_edge_path
from soundspaces_sim.transport.diffraction.visible_wedges import (
    VisibleWedges,
    coordinates_in,
    visible_wedges,
)
from soundspaces_sim.transport.diffraction.wedges import Wedges
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.path_table import FoundPath, PathSlots, PathTable, store
from soundspaces_sim.transport.tile import Tile

_MIN_SHARE = 1e-6  # of the free field's energy
_FADED = 0.1  # m, detour by an edge beside the direct sound at which paths by two edges have faded
_ON_BOUNDARY = 0.02  # rad, within which rays decide what is in the light (`two_edge_sight`)


class _Onward(NamedTuple):
    """How paths go on from wedges that N points see: rows start[i]:start[i + 1] of point i are rows of
    `MutualVisibility`, ascending, from a wedge that it sees to one that is partly in the shadow of the first."""

    start: np.ndarray  # (N + 1,)
    row: np.ndarray  # (n,)


class _Context(NamedTuple):
    """What the kernel reads."""

    geometry: Geometry
    wedges: Wedges
    mutual: MutualVisibility
    quadrature: Quadrature
    points_a: np.ndarray  # (A, 3) m
    points_b: np.ndarray  # (B, 3) m
    keys_a: np.ndarray  # (A,) of `point_keys`: the smaller one's point is solved from
    keys_b: np.ndarray  # (B,)
    walls: np.ndarray  # (A, B) between the points; 0: they see each other
    visible_a: VisibleWedges
    visible_b: VisibleWedges
    onward_a: _Onward
    onward_b: _Onward


class _Scratch(NamedTuple):
    energy: np.ndarray  # (b,)
    #: (n,) flags of rows of `MutualVisibility`, to wedges on which sound of the point of a has gone on
    continues: np.ndarray
    double: DoubleWedgeScratch
    field: np.ndarray  # (b, g) complex


@part
def _solve(
    context: _Context, e: int, f: int, p: Vec3, q: Vec3, scratch: _Scratch
) -> tuple[bool, FoundPath]:
    """The path from p by edges e and f to q, its energies into the scratch; whether there is one."""
    geometry, wedges = context.geometry, context.wedges
    none = FoundPath(0.0, p, q, (-1, -1), TWO_EDGES, (e, f), (-1, -1))
    inside, x = two_edge_path(wedges, e, f, p, q)
    if not (inside and alone(geometry, wedges, x) and legs_clear(geometry, wedges, x)):
        return False, none
    two_edge_field(wedges, x, (False, False), 0.0, context.quadrature.k, scratch.double, scratch.field)
    most, total = mean_energy(scratch.field, context.quadrature, scratch.energy), path_length(x)
    if most < _MIN_SHARE * INV_4PI / (total * total):
        return False, none
    at_q, at_p = divide(subtract(x.at_f, q), x.d_q), divide(subtract(x.at_e, p), x.d_p)
    return True, FoundPath(total, at_q, at_p, (-1, -1), TWO_EDGES, (e, f), (-1, -1))


@kernel
def _find_onward(
    first: int,
    last: int,
    mutual: MutualVisibility,
    visible: VisibleWedges,
    count: np.ndarray,
    onward: _Onward,
) -> None:
    """Counts (N,) rows of `_Onward`; fills them unless there is no room for any."""
    for i in range(first, last):
        found = 0
        for seen in range(visible.start[i], visible.start[i + 1]):
            e = visible.wedge[seen]
            for other in range(mutual.start[e], mutual.start[e + 1]):
                low, high = mutual.phi[other, 0], mutual.phi[other, 1]
                if max(high - visible.phi[seen], visible.phi[seen] - low) > math.pi - _ON_BOUNDARY:
                    if len(onward.row) > 0:
                        onward.row[onward.start[i] + found] = other
                    found += 1
        count[i] = found


def _onward(mutual: MutualVisibility, visible: VisibleWedges) -> _Onward:
    points = len(visible.start) - 1
    count, start = np.zeros(points, np.int64), np.zeros(points + 1, np.int64)

    def find(row: np.ndarray) -> _Onward:
        onward = _Onward(start, row)
        over_rows(_find_onward, points, mutual, visible, count, onward)
        return onward

    find(np.empty(0, np.int64))  # how many
    np.cumsum(count, out=start[1:])
    return find(np.empty(start[-1], np.int64))


@part
def _mark(context: _Context, i: int, continues: np.ndarray, value: bool) -> None:
    """Flag rows of `MutualVisibility` by which sound from point i of a comes to other wedges, reversed."""
    onward = context.onward_a
    for n in range(onward.start[i], onward.start[i + 1]):
        continues[context.mutual.reverse[onward.row[n]]] = value


@part
def _fading(context: _Context, i: int, j: int) -> float:
    """Weight of the paths between points i and j: 1 out of sight; in sight they fade with the detour by the edge
    that the direct sound passes most closely."""
    if context.walls[i, j] > 0:
        return 1.0
    p, q = row(context.points_a, i), row(context.points_b, j)
    straight, least = distance(p, q), _FADED
    pair = EdgePair(p, q, context.mutual.wedge, context.mutual.wedge, True)
    scene = EdgesOfScene(context.geometry, context.wedges, context.mutual)
    own, end = context.visible_a.start[i] - 1, context.visible_a.start[i + 1]
    other, stop = context.visible_b.start[j] - 1, context.visible_b.start[j + 1]
    while True:
        own, other = next_common(
            context.visible_a.wedge, own + 1, end, context.visible_b.wedge, other + 1, stop
        )
        if own >= end or other >= stop:
            return cosine_taper(least / _FADED)
        s, r = coordinates_in(context.visible_a, own), coordinates_in(context.visible_b, other)
        detour = math.sqrt((s.r + r.r) ** 2 + (s.z - r.z) ** 2) - straight
        if detour < least and single_path(scene, context.visible_a.wedge[own], s, r, pair)[0]:
            least = max(detour, 0.0)


@kernel
def _double_paths(
    first: int, last: int, context: _Context, pairs: np.ndarray, slots: PathSlots, scratch: _Scratch
) -> None:
    """Paths of pairs by two edges, in order of the wedges that b sees. Pairs of one point of a stand together."""
    mutual, onward_b, marked = context.mutual, context.onward_b, -1
    for k in range(first, last):
        i, j = pairs[k]
        if i != marked:
            if marked >= 0:
                _mark(context, marked, scratch.continues, False)
            _mark(context, i, scratch.continues, True)
            marked = i
        p, q = row(context.points_a, i), row(context.points_b, j)
        fading = _fading(context, i, j) if distance(p, q) > context.geometry.epsilon else 0.0
        if fading <= 0.0:
            continue
        for n in range(onward_b.start[j], onward_b.start[j + 1]):
            other = onward_b.row[n]
            if not scratch.continues[other]:
                continue
            e, f = mutual.wedge[other], mutual.wedge[mutual.reverse[other]]
            if context.keys_a[i] > context.keys_b[j]:  # so that a pair gives the same bits both ways
                found, path = _solve(context, f, e, q, p, scratch)
                path = FoundPath(
                    path.length, path.at_a, path.at_b, path.planes, path.kind, (e, f), path.groups
                )
            else:
                found, path = _solve(context, e, f, p, q, scratch)
            if found:
                for band in range(len(scratch.energy)):
                    scratch.energy[band] *= fading
                store(slots, k, path, scratch.energy)


def connect(tile: Tile) -> PathTable | None:
    """Paths by two edges of every pair out of sight, or nearly."""
    model, a, b = tile.model, tile.a.ends, tile.b.ends
    wedges, mutual = model.prepared.part(prepare_wedges)
    if len(wedges.length) < 2:
        return None
    onward_a = _onward(mutual, tile.a.once(visible_wedges))
    onward_b = onward_a if tile.same else _onward(mutual, tile.b.once(visible_wedges))
    quadrature = make_spectrum(model.config.bands, model.config.c).shadow
    context = _Context(
        geometry=model.world.geometry,
        wedges=wedges,
        mutual=mutual,
        quadrature=quadrature,
        points_a=a.points,
        points_b=b.points,
        keys_a=a.keys,
        keys_b=b.keys,
        walls=tile.walls,
        visible_a=tile.a.once(visible_wedges),
        visible_b=tile.b.once(visible_wedges),
        onward_a=onward_a,
        onward_b=onward_b,
    )

    def scratch() -> _Scratch:
        return _Scratch(
            energy=np.empty(len(quadrature.k)),
            continues=np.zeros(len(mutual.wedge), np.bool_),
            double=make_double_wedge_scratch(),
            field=np.empty(quadrature.k.shape, np.complex128),
        )

    return for_each_pair(tile, _double_paths, context, tile.pairs, scratch)
