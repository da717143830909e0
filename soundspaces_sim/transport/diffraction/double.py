"""Second-order diffraction: round a wall as thick as it is, over one obstacle and then another.

For a pair out of sight of each other, a path by every two wedges that see each other, of which one sees one end
and the other the other, if it is the shortest path by way of both edges, and in the shadow of both. The pressure
is the product of two coefficients (`utd`), that which deflects the path more with the whole path for its
distances, the other with its own legs (Pierce 1974, Diffraction of sound around corners and over wide barriers,
JASA 55 (5)). Along a common face it is halved, for the face's image is in both coefficients. A wall is thin if k
times its thickness is small: the thinner it is, the more its two edges are taken as the one edge of a screen.
Wedges are rigid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, row, subtract
from soundspaces_sim.echogram.echogram import TWO_EDGES
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry, unoccluded
from soundspaces_sim.transport.diffraction.mutual_visibility import MutualVisibility
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.spectrum import Quadrature, make_spectrum
from soundspaces_sim.transport.diffraction.two_edges import (
    Apexes,
    path_angles,
    shortest_path,
    two_edge_energy,
    two_edge_factors,
)
from soundspaces_sim.transport.diffraction.visible_wedges import VisibleWedges, visible_wedges
from soundspaces_sim.transport.diffraction.wedges import (
    Wedges,
    clear_point,
    edge_point,
)
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.path_table import FoundPath, PathSlots, PathTable, store
from soundspaces_sim.transport.tile import Tile

_MIN_SHARE = 1e-6  # of the free field's energy


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
    onward_a: _Onward
    onward_b: _Onward


class _Scratch(NamedTuple):
    energy: np.ndarray  # (b,)
    #: (n,) flags of rows of `MutualVisibility`, to wedges on which sound of the point of a has gone on
    continues: np.ndarray


@part
def _solve(
    context: _Context, e: int, f: int, p: Vec3, q: Vec3, energy: np.ndarray
) -> tuple[bool, FoundPath]:
    """The path from p by edges e and f to q, its energies into `energy` (b,); whether there is one."""
    geometry, wedges = context.geometry, context.wedges
    none = FoundPath(0.0, p, q, (-1, -1), TWO_EDGES, (e, f), (-1, -1))
    z_e, z_f = shortest_path(wedges, e, f, p, q)
    if not (0.0 < z_e < wedges.length[e] and 0.0 < z_f < wedges.length[f]):
        return False, none
    at_e, at_f = edge_point(wedges, e, z_e), edge_point(wedges, f, z_f)
    x = Apexes(z_e, z_f, at_e, at_f, distance(p, at_e), distance(at_e, at_f), distance(at_f, q))
    shadow, angles = path_angles(wedges, e, f, p, q, x)
    if not shadow:
        return False, none
    clear_e, clear_f = clear_point(wedges, e, z_e), clear_point(wedges, f, z_f)
    if not (
        unoccluded(geometry, p, clear_e)
        and unoccluded(geometry, q, clear_f)
        and unoccluded(geometry, clear_e, clear_f)
    ):
        return False, none
    most = two_edge_energy(two_edge_factors(wedges, e, f, p, q, x, angles), context.quadrature, energy)
    total = x.d_p + x.d_ef + x.d_q
    if most < _MIN_SHARE * INV_4PI / (total * total):
        return False, none
    at_q, at_p = divide(subtract(at_f, q), x.d_q), divide(subtract(at_e, p), x.d_p)
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
                if max(high - visible.phi[seen], visible.phi[seen] - low) > math.pi:
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
        if distance(p, q) <= context.geometry.epsilon:
            continue
        for n in range(onward_b.start[j], onward_b.start[j + 1]):
            other = onward_b.row[n]
            if not scratch.continues[other]:
                continue
            e, f = mutual.wedge[other], mutual.wedge[mutual.reverse[other]]
            if context.keys_a[i] > context.keys_b[j]:  # so that a pair gives the same bits both ways
                found, path = _solve(context, f, e, q, p, scratch.energy)
                path = FoundPath(
                    path.length, path.at_a, path.at_b, path.planes, path.kind, (e, f), path.groups
                )
            else:
                found, path = _solve(context, e, f, p, q, scratch.energy)
            if found:
                store(slots, k, path, scratch.energy)


def connect(tile: Tile) -> PathTable | None:
    """Paths by two edges of every pair out of sight."""
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
        onward_a=onward_a,
        onward_b=onward_b,
    )

    def scratch() -> _Scratch:
        return _Scratch(np.empty(len(quadrature.k)), np.zeros(len(mutual.wedge), np.bool_))

    pairs = tile.pairs
    hidden = pairs[tile.walls[pairs[:, 0], pairs[:, 1]] > 0]
    return for_each_pair(tile, _double_paths, context, hidden, scratch)
