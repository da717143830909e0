"""Second-order diffraction: round a wall as thick as it is, over one obstacle and then another.

For a pair out of sight of each other, a path by every two wedges that see each other, of which one sees one end
and the other the other, if it is the shortest path by way of both edges, and in the shadow of both. The pressure
is the product of two coefficients (`utd`), that which turns the path farther with the whole path for its
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
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, divide, dot, row, subtract
from soundspaces_sim.echogram.echogram import TWO_EDGES
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.scene.rays.geometry import Geometry, unoccluded
from soundspaces_sim.transport.diffraction.mutual_visibility import MutualVisibility
from soundspaces_sim.transport.diffraction.paths import DiffractedPath, edge_share, endless_field
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.shortest_path import shortest_path
from soundspaces_sim.transport.diffraction.spectrum import Quadrature, make_spectrum
from soundspaces_sim.transport.diffraction.visible_wedges import VisibleWedges, visible_wedges
from soundspaces_sim.transport.diffraction.wedges import (
    Wedges,
    clear_point,
    edge_point,
    wedge_coordinates,
)
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.path_table import FoundPath, PathSlots, PathTable, store
from soundspaces_sim.transport.tile import Tile

_MIN_SHARE = 1e-6  # of the free field's energy
_MIN_RADIUS = 1e-6  # m, of a point about a wedge
_ON_FACE = 0.01  # rad: a point so near to a face is on it
_PARALLEL = 0.999  # cosine between edges
_THIN = 2.0  # k times thickness at which a wall's edges are half one, half two


class _Apexes(NamedTuple):
    """Where a path from p meets the edges e and f on its way to q."""

    z_e: float  # m along e
    z_f: float  # m along f
    at_e: Vec3
    at_f: Vec3
    d_p: float  # m, from p to e
    d_ef: float  # m
    d_q: float  # m, from f to q


class _Angles(NamedTuple):
    """The path's coordinates about both wedges; angles in rad, as in `WedgeCoordinates`."""

    r_p: float  # m, of p about e
    r_q: float  # m, of q about f
    phi_p: float  # of p about e
    phi_f: float  # of the apex on f about e
    phi_e: float  # of the apex on e about f
    phi_q: float  # of q about f


class _TwoEdges(NamedTuple):
    """The factors of the pressure: |first second| scale, or |single| where the wall between is thin."""

    first: DiffractedPath
    second: DiffractedPath
    scale: float
    may_be_thin: bool
    single: DiffractedPath
    thickness: float  # m


@part(forceinline=True)
def _snapped(phi: float, sector: float) -> float:
    """The angle of a face for a point on it, whichever side of the face rounding puts the point."""
    if phi < _ON_FACE or phi > 2.0 * math.pi - _ON_FACE:
        return 0.0 if sector < 2.0 * math.pi - _ON_FACE or phi < _ON_FACE else sector
    return sector if abs(phi - sector) < _ON_FACE else phi


@part
def _angles(wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3, x: _Apexes) -> tuple[bool, _Angles]:
    """Whether the path goes through both open sectors into the shadow of both wedges; its angles."""
    p_e, f_e = wedge_coordinates(wedges, e, p), wedge_coordinates(wedges, e, x.at_f)
    q_f, e_f = wedge_coordinates(wedges, f, q), wedge_coordinates(wedges, f, x.at_e)
    sector_e, sector_f = math.pi * wedges.n[e], math.pi * wedges.n[f]
    phi_f, phi_e = _snapped(f_e.phi, sector_e), _snapped(e_f.phi, sector_f)
    inside = max(p_e.phi, phi_f) <= sector_e and max(q_f.phi, phi_e) <= sector_f
    shadow = abs(phi_f - p_e.phi) > math.pi and abs(q_f.phi - phi_e) > math.pi
    apart = min(p_e.r, f_e.r, q_f.r, e_f.r) >= _MIN_RADIUS
    return apart and inside and shadow, _Angles(p_e.r, q_f.r, p_e.phi, phi_f, phi_e, q_f.phi)


class _Line(NamedTuple):
    """The path's two legs at one of its edges."""

    p: Vec3
    q: Vec3
    length: float  # m


@part(forceinline=True)
def _detour(wedges: Wedges, e: int, z: float, line: _Line) -> float:
    """By way of z on an edge, over the shortest path, m."""
    at = edge_point(wedges, e, z)
    return max(distance(line.p, at) + distance(at, line.q) - line.length, 0.0)


@part
def _at_edge(
    wedges: Wedges,
    e: int,
    z: float,
    line: _Line,
    phi: tuple[float, float],
    legs: tuple[float, float],
    sin_beta: float,
) -> DiffractedPath:
    """The path at one of its edges; `phi` of both ends, `legs` as the coefficient takes them."""
    length = wedges.length[e]
    start, end = _detour(wedges, e, 0.0, line), _detour(wedges, e, length, line)
    low, high = min(phi[0], phi[1]), max(phi[0], phi[1])
    return DiffractedPath(wedges.n[e], low, high, legs[0], legs[1], sin_beta, z, length, start, end, 1.0)


@part(forceinline=True)
def _parallel(wedges: Wedges, e: int, f: int) -> bool:
    return abs(dot(row(wedges.along, e), row(wedges.along, f))) > _PARALLEL


@part
def _factors(wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3, x: _Apexes, angles: _Angles) -> _TwoEdges:
    """What the pressure of the path from p by e and f to q consists of."""
    sector_e, sector_f = math.pi * wedges.n[e], math.pi * wedges.n[f]
    about_e, about_f = (angles.phi_p, angles.phi_f), (angles.phi_e, angles.phi_q)
    beyond_e, beyond_f = abs(about_e[1] - about_e[0]) - math.pi, abs(about_f[1] - about_f[0]) - math.pi
    f_on_face = angles.phi_f <= 0.0 or angles.phi_f >= sector_e
    e_on_face = angles.phi_e <= 0.0 or angles.phi_e >= sector_f
    common = f_on_face and e_on_face
    half = 0.5 if common else 1.0
    if beyond_e * angles.r_p >= beyond_f * angles.r_q:
        legs_e, legs_f, scale = (x.d_p, x.d_ef + x.d_q), (x.d_ef, x.d_q), half * (x.d_ef + x.d_q)
    else:
        legs_e, legs_f, scale = (x.d_p, x.d_ef), (x.d_p + x.d_ef, x.d_q), half * (x.d_p + x.d_ef)
    line_e, line_f = _Line(p, x.at_f, x.d_p + x.d_ef), _Line(x.at_e, q, x.d_ef + x.d_q)
    first = _at_edge(wedges, e, x.z_e, line_e, about_e, legs_e, angles.r_p / x.d_p)
    second = _at_edge(wedges, f, x.z_f, line_f, about_f, legs_f, angles.r_q / x.d_q)
    # As one edge: a wedge that turns the path as both do, each end at its angle from its own outer face.
    outer_p = angles.phi_p if angles.phi_f > angles.phi_p else sector_e - angles.phi_p
    outer_q = angles.phi_q if angles.phi_e > angles.phi_q else sector_f - angles.phi_q
    n = wedges.n[e] + wedges.n[f] - 1.0
    d_s, d_r = x.d_p + 0.5 * x.d_ef, x.d_q + 0.5 * x.d_ef
    single = DiffractedPath(
        n, outer_p, math.pi * n - outer_q, d_s, d_r, first.sin_beta, first.apex, first.edge_length,
        first.detour_start, first.detour_end, 1.0,
    )  # fmt: skip
    thin = common and _parallel(wedges, e, f) and n <= 2.0 + 1e-9
    return _TwoEdges(first, second, scale, thin, single, x.d_ef)


@part
def _energy(two: _TwoEdges, quadrature: Quadrature, energy: np.ndarray) -> float:
    """Energies (b,) of a path by two edges, J/m² for 1 J, without air; the largest of them."""
    most = 0.0
    for b in range(len(energy)):
        mean = 0.0
        for g in range(len(quadrature.weight)):
            k = quadrature.k[b, g]
            size = abs(endless_field(two.first, k, 1.0) * endless_field(two.second, k, 1.0) * two.scale)
            if two.may_be_thin:
                thick = k * two.thickness / (_THIN + k * two.thickness)
                size = thick * size + (1.0 - thick) * abs(endless_field(two.single, k, 1.0))
            size *= abs(edge_share(two.first, k) * edge_share(two.second, k))
            mean += quadrature.weight[g] * size * size
        energy[b] = mean * INV_4PI
        most = max(most, energy[b])
    return most


@part
def _solve(
    context: _Context, e: int, f: int, p: Vec3, q: Vec3, energy: np.ndarray
) -> tuple[bool, FoundPath]:
    """The path from p by edges e and f to q, its energies into `energy` (b,); whether there is one."""
    geometry, wedges = context.geometry, context.wedges
    none = FoundPath(0.0, p, q, (-1, -1), TWO_EDGES, (e, f))
    z_e, z_f = shortest_path(wedges, e, f, p, q)
    if not (0.0 < z_e < wedges.length[e] and 0.0 < z_f < wedges.length[f]):
        return False, none
    at_e, at_f = edge_point(wedges, e, z_e), edge_point(wedges, f, z_f)
    x = _Apexes(z_e, z_f, at_e, at_f, distance(p, at_e), distance(at_e, at_f), distance(at_f, q))
    shadow, angles = _angles(wedges, e, f, p, q, x)
    if not shadow:
        return False, none
    clear_e, clear_f = clear_point(wedges, e, z_e), clear_point(wedges, f, z_f)
    if not (
        unoccluded(geometry, p, clear_e)
        and unoccluded(geometry, q, clear_f)
        and unoccluded(geometry, clear_e, clear_f)
    ):
        return False, none
    most = _energy(_factors(wedges, e, f, p, q, x, angles), context.quadrature, energy)
    total = x.d_p + x.d_ef + x.d_q
    if most < _MIN_SHARE * INV_4PI / (total * total):
        return False, none
    at_q, at_p = divide(subtract(at_f, q), x.d_q), divide(subtract(at_e, p), x.d_p)
    return True, FoundPath(total, at_q, at_p, (-1, -1), TWO_EDGES, (e, f))


class _Onward(NamedTuple):
    """How paths go on from wedges that N points see: rows start[i]:start[i + 1] of point i are rows of
    `MutualVisibility`, ascending, from a wedge that it sees to one that is partly in the shadow of the first."""

    start: np.ndarray  # (N + 1,)
    row: np.ndarray  # (n,)


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
    meets: (
        np.ndarray
    )  # (n,) rows of `MutualVisibility`, to a wedge that the point of a sees, that go on to it


@part
def _mark(context: _Context, i: int, meets: np.ndarray, value: bool) -> None:
    """Flag rows of `MutualVisibility` by which sound from point i of a comes to other wedges, reversed."""
    onward = context.onward_a
    for n in range(onward.start[i], onward.start[i + 1]):
        meets[context.mutual.reverse[onward.row[n]]] = value


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
                _mark(context, marked, scratch.meets, False)
            _mark(context, i, scratch.meets, True)
            marked = i
        p, q = row(context.points_a, i), row(context.points_b, j)
        if distance(p, q) <= context.geometry.epsilon:
            continue
        for n in range(onward_b.start[j], onward_b.start[j + 1]):
            other = onward_b.row[n]
            if not scratch.meets[other]:
                continue
            e, f = mutual.wedge[other], mutual.wedge[mutual.reverse[other]]
            if context.keys_a[i] > context.keys_b[j]:  # so that a pair gives the same bits both ways
                found, path = _solve(context, f, e, q, p, scratch.energy)
                path = FoundPath(path.length, path.at_a, path.at_b, path.planes, path.kind, (e, f))
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
