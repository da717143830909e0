"""The shortest ways round edges, up to eight: first arrivals of points far out of sight of each other.

A point's ways are found once for all its pairs, as navigation meshes and visibility graphs do it: edges that see
each other are the nodes (`scene_edges`), and the shortest way to each goes on from the shortest way to another one.
From the last edge that the other point sees, the way goes straight. Rays have found every leg free.

A way by m edges is pulled taut (every edge in turn has its shortest path between the places before and after), and
its field is Pierce's product for any number of edges, as Deygout orders them (1966, Multiple knife-edge
diffraction of microwaves, IEEE Trans. AP 14 (4)): the edge that turns the sound most has the whole way for its
distances, the next one its part of the way up to that edge, and so on,

    P = 1 / l * product over i of (a_i + b_i) D_i(phi, phi'; a_i, b_i).                                     (T34e)

Two parallel edges of one face, as those of a wall, are one factor, which is exact (T34).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, distance, dot, length, row, subtract
from soundspaces_sim.scene.rays.geometry import unoccluded
from soundspaces_sim.transport.arrivals.double_wedge import (
    DoubleWedgeScratch,
    Ends,
    double_wedge_field,
    set_terms,
)
from soundspaces_sim.transport.arrivals.field import (
    EdgePath,
    Spectrum,
    beyond_end,
    detours_of_ends,
    field_at,
    front_of,
    of_end,
    terms_of,
)
from soundspaces_sim.transport.arrivals.images import View
from soundspaces_sim.transport.arrivals.scene_edges import Edges, beside, is_free
from soundspaces_sim.transport.arrivals.two_edges import MIN_RADIUS, on_faces, on_one_side, sense_of
from soundspaces_sim.transport.arrivals.wedges import (
    BOUNDARY_OFFSET,
    ON_FACE,
    Wedges,
    clear_point,
    cosine_taper,
    edge_point,
    line_coordinates,
    met_point,
    parallel,
    wedge_coordinates,
)

_MOST_EDGES = 8  # of a way: by more, sound is some 60 dB below a free field
_TRIED = 4  # ways to a point, by different last edges, until one is free
_MOST_WAYS = 8  # of a pair: the shortest one, and those by an edge more in whose light an end is
_OF_THREAD = 8  # points whose ways are worth a thread
_SHORTER = 1e-3  # m, by which a way must be, to be another
_PLACES = 5  # of an edge that are tried where its nearest place is not seen
_SWEEPS = 12  # by which a way is pulled taut
_ALONG = 0.25  # rad, from a face, along which a way goes, or from an edge's light
_NEAR_SHADOW = 0.5  # rad, from the boundary of its shadow, up to which an end counts as in it
_FALLS = 0.5  # of what is heard


class Ways(NamedTuple):
    """The shortest ways from N points to E edges; infinite where there is none."""

    length: np.ndarray  # (N, E) m
    before: np.ndarray  # (N, E) the edge before, -1: the point sees this one
    z: np.ndarray  # (N, E) m, place on the edge
    phi: np.ndarray  # (N, E) rad, about the edge, from where the way comes
    round: np.ndarray  # (N, E) edges before it when it was found


class WayScratch(NamedTuple):
    """What a thread works in: ways that are tried, and the one at hand, from p by m edges to q."""

    total: np.ndarray  # (2, _TRIED) m, of what is tried from p, and from q
    last: np.ndarray  # (2, _TRIED) edge that the other point sees
    done: np.ndarray  # (_MOST_WAYS, _MOST_EDGES) edges of the ways that are solved, from p
    edge: np.ndarray  # (_MOST_EDGES,)
    z: np.ndarray  # (_MOST_EDGES,) m
    found: np.ndarray  # (_MOST_EDGES,) m, where rays have found the way free
    leg: np.ndarray  # (_MOST_EDGES + 1,) m
    angle: np.ndarray  # (_MOST_EDGES, 2) rad, about each edge, of the places before and after
    sine: np.ndarray  # (_MOST_EDGES,) of the angle between the way and the edge
    common: np.ndarray  # (_MOST_EDGES,) a face connects this edge with the next one
    unit: np.ndarray  # (_MOST_EDGES,) edges of the factor that begins here: 1, 2; 0: it began one before
    size: np.ndarray  # (_MOST_EDGES,) how much a factor matters
    set: np.ndarray  # (_MOST_EDGES,) whether its factor is there
    needed: np.ndarray  # (2,) it is not free without its first edge, its last one, in whose light it is


def make_way_scratch() -> WayScratch:
    """Empty."""
    m = _MOST_EDGES
    return WayScratch(
        total=np.empty((2, _TRIED)),
        last=np.empty((2, _TRIED), np.int64),
        done=np.empty((_MOST_WAYS, m), np.int64),
        edge=np.empty(m, np.int64),
        z=np.empty(m),
        found=np.empty(m),
        leg=np.empty(m + 1),
        angle=np.empty((m, 2)),
        sine=np.empty(m),
        common=np.empty(m, np.bool_),
        unit=np.empty(m, np.int64),
        size=np.empty(m),
        set=np.empty(m, np.bool_),
        needed=np.empty(2, np.bool_),
    )


# Of a point


@part
def _reaches(view: View, wedges: Wedges, p: Vec3, e: int, at: Vec3) -> bool:
    """Whether sound gets from a point to a place off an edge."""
    geometry = view.geometry
    return unoccluded(geometry, p, at) or unoccluded(geometry, p, beside(geometry, wedges, e, at))


@part
def _seen_place(view: View, wedges: Wedges, e: int, p: Vec3, z: float) -> float:
    """The place of an edge, m, that a point sees: the nearest one, or of some along it that which is nearest."""
    far, best = wedges.length[e], math.nan
    if _reaches(view, wedges, p, e, met_point(wedges, e, z)):
        return min(max(z, 0.0), far)
    for k in range(_PLACES):
        tried = (k + 0.5) / _PLACES * far
        nearer = not abs(best - z) <= abs(tried - z)
        if nearer and _reaches(view, wedges, p, e, clear_point(wedges, e, tried)):
            best = tried
    return best


@kernel
def _find_ways(
    first: int,
    last: int,
    view: View,
    edges: Edges,
    points: np.ndarray,
    rows: np.ndarray,
    seen: np.ndarray,
    at: np.ndarray,
    ways: Ways,
) -> None:
    """Ways of points, whose edges in sight are rows[i, 0] to rows[i, 1] of `seen`, their places and angles `at`."""
    wedges, mutual = edges.wedges, edges.mutual
    for i in range(first, last):
        p = row(points, i)
        for e in range(len(wedges.length)):
            ways.length[i, e], ways.before[i, e], ways.round[i, e] = math.inf, -1, -1
        for n in range(rows[i, 0], rows[i, 1]):
            e = seen[n]
            z = _seen_place(view, wedges, e, p, at[n, 0])
            if z >= 0.0:
                ways.length[i, e], ways.round[i, e] = distance(p, edge_point(wedges, e, z)), 0
                ways.z[i, e], ways.phi[i, e] = z, at[n, 1]
        for done in range(1, _MOST_EDGES):
            for e in range(len(wedges.length)):
                if ways.round[i, e] != done - 1:
                    continue
                place = edge_point(wedges, e, ways.z[i, e])
                for m in range(mutual.start[e], mutual.start[e + 1]):
                    f = mutual.wedge[m]
                    z = dot(subtract(place, row(wedges.start, f)), row(wedges.along, f))
                    z = min(max(z, 0.0), wedges.length[f])
                    way = ways.length[i, e] + distance(place, edge_point(wedges, f, z))
                    if way > ways.length[i, f] - _SHORTER:
                        continue
                    if not is_free(
                        view.geometry,
                        wedges,
                        (e, f),
                        (met_point(wedges, e, ways.z[i, e]), met_point(wedges, f, z)),
                    ):
                        continue
                    ways.length[i, f], ways.before[i, f], ways.z[i, f] = way, e, z
                    ways.phi[i, f], ways.round[i, f] = wedge_coordinates(wedges, f, place).phi, done


def find_ways(
    view: View, edges: Edges, points: np.ndarray, rows: np.ndarray, seen: np.ndarray, at: np.ndarray
) -> Ways:
    """The ways from points (N, 3) m to all edges; arguments as those of `_find_ways`."""
    shape = len(points), len(edges.wedges.length)
    ways = Ways(
        np.empty(shape, np.float32), np.empty(shape, np.int32), np.zeros(shape, np.float32),
        np.zeros(shape, np.float32), np.empty(shape, np.int8),
    )  # fmt: skip
    if shape[1] > 0:
        over_rows(_find_ways, len(points), view, edges, points, rows, seen, at, ways, least=_OF_THREAD)
    return ways


# Of a pair


@part(forceinline=True)
def _light(n: int, scratch: WayScratch) -> float:
    """How far a way passes in the light of an edge, rad from the boundary of its shadow."""
    return math.pi - abs(scratch.angle[n, 1] - scratch.angle[n, 0])


@part(forceinline=True)
def _is_needed(n: int, count: int, scratch: WayScratch) -> bool:
    """Whether the way is not free without an edge: in its light sound passes it, and is diffracted beside that."""
    if n == 0:
        return scratch.needed[0]
    return n < count - 1 or scratch.needed[1]


@part(forceinline=True)
def _near_shadow(light: float, reach: float) -> float:
    """1 in the shadow and up to half of `reach` rad in the light, from there down to 0."""
    return cosine_taper(2.0 * max(light / reach - 0.5, 0.0))


@part
def weight_of(count: int, scratch: WayScratch) -> float:
    """Of the way at hand: what is left of it in the light of its first edge and of its last one."""
    weight = 1.0
    for n in (0, count - 1):
        if not _is_needed(n, count, scratch):
            weight *= _near_shadow(_light(n, scratch), _NEAR_SHADOW)
    return math.sqrt(weight)


@part(forceinline=True)
def _turn_at(wedges: Wedges, ways: Ways, i: int, e: int, phi: float) -> float:
    """By how much the way of point i turns at an edge towards what is at the angle phi about it."""
    return abs(phi - _in_sector(ways.phi[i, e], math.pi * wedges.n[e], 0.0))


@part
def choose_ways(
    wedges: Wedges,
    ways: Ways,
    i: int,
    rows: tuple[int, int],
    wedge: np.ndarray,
    phi: np.ndarray,
    q: Vec3,
    tree: int,
    scratch: WayScratch,
) -> int:
    """The shortest ways from point i to q by their last edges, rows of `wedge` and of q's angles `phi` about them,
    where q is in their shadow or near it: into `total` and `last` of a tree, the shortest first; how many."""
    count, total, last = 0, scratch.total[tree], scratch.last[tree]
    for n in range(rows[0], rows[1]):
        e = wedge[n]
        way = ways.length[i, e] + distance(edge_point(wedges, e, ways.z[i, e]), q)
        if not way < math.inf or _turn_at(wedges, ways, i, e, phi[n]) < math.pi - _NEAR_SHADOW:
            continue
        k = count
        while k > 0 and total[k - 1] > way:
            if k < _TRIED:
                total[k], last[k] = total[k - 1], last[k - 1]
            k -= 1
        if k < _TRIED:
            total[k], last[k] = way, e
            count = min(count + 1, _TRIED)
    return count


@part
def in_light_of(wedges: Wedges, ways: Ways, i: int, e: int, f: int, phi: float) -> bool:
    """Whether the way of point i by edge f goes on to e, and an end at the angle phi about e is in its light, but
    near its shadow."""
    if ways.before[i, e] != f:
        return False
    return math.pi - _NEAR_SHADOW < _turn_at(wedges, ways, i, e, phi) < math.pi


@part
def set_way(ways: Ways, i: int, last: int, reverse: bool, scratch: WayScratch) -> int:
    """The way of point i to an edge, into `edge` and `found`; `reverse`: from there. How many edges it has, 0 for
    one of too many."""
    count, e = 0, last
    while e >= 0:
        if count == _MOST_EDGES:
            return 0
        scratch.edge[count], scratch.found[count] = e, ways.z[i, e]
        count, e = count + 1, ways.before[i, e]
    if not reverse:
        for n in range(count // 2):
            m = count - 1 - n
            scratch.edge[n], scratch.edge[m] = scratch.edge[m], scratch.edge[n]
            scratch.found[n], scratch.found[m] = scratch.found[m], scratch.found[n]
    return count


@part
def is_new(count: int, solved: int, scratch: WayScratch) -> bool:
    """Whether the way at hand is none of those solved; it is then row `solved` of them. No if there is no room."""
    if solved == _MOST_WAYS:
        return False
    for k in range(solved):
        same = count == _MOST_EDGES or scratch.done[k, count] < 0
        for n in range(count):
            same &= scratch.done[k, n] == scratch.edge[n]
        if same:
            return False
    for n in range(_MOST_EDGES):
        scratch.done[solved, n] = scratch.edge[n] if n < count else -1
    return True


@part
def _place(wedges: Wedges, scratch: WayScratch, n: int, count: int, p: Vec3, q: Vec3) -> Vec3:
    """Where the way is at its edge n; p before the first and q after the last."""
    if n < 0:
        return p
    return q if n >= count else edge_point(wedges, scratch.edge[n], scratch.z[n])


@part(forceinline=True)
def _keller(wedges: Wedges, e: int, p: Vec3, q: Vec3) -> float:
    """z of the shortest path between two points by way of a line."""
    (z_p, r_p), (z_q, r_q) = line_coordinates(wedges, e, p), line_coordinates(wedges, e, q)
    return z_p + (z_q - z_p) * r_p / max(r_p + r_q, MIN_RADIUS)


@part
def _pull_taut(wedges: Wedges, count: int, p: Vec3, q: Vec3, scratch: WayScratch) -> None:
    for _ in range(_SWEEPS):
        for n in range(count):
            e = scratch.edge[n]
            before = _place(wedges, scratch, n - 1, count, p, q)
            z = _keller(wedges, e, before, _place(wedges, scratch, n + 1, count, p, q))
            scratch.z[n] = min(max(z, 0.0), wedges.length[e])


@part
def _all_free(view: View, wedges: Wedges, count: int, p: Vec3, q: Vec3, scratch: WayScratch) -> bool:
    edge, z = scratch.edge, scratch.z
    at = met_point(wedges, edge[0], z[0])
    if not _reaches(view, wedges, p, edge[0], at):
        return False
    for n in range(1, count):
        to = met_point(wedges, edge[n], z[n])
        if not is_free(view.geometry, wedges, (edge[n - 1], edge[n]), (at, to)):
            return False
        at = to
    return _reaches(view, wedges, q, edge[count - 1], at)


@part
def _leave_out(n: int, count: int, scratch: WayScratch) -> None:
    for m in range(n, count - 1):
        scratch.edge[m], scratch.found[m] = scratch.edge[m + 1], scratch.found[m + 1]


@part
def _insert(n: int, count: int, e: int, z: float, scratch: WayScratch) -> None:
    for m in range(count, n, -1):
        scratch.edge[m], scratch.z[m] = scratch.edge[m - 1], scratch.z[m - 1]
    scratch.edge[n], scratch.z[n] = e, z


@part
def _measure(wedges: Wedges, count: int, p: Vec3, q: Vec3, scratch: WayScratch) -> tuple[int, float]:
    """Legs and angles of the way at hand: (`_set_angles`, its length, m)."""
    total = 0.0
    for n in range(count + 1):
        at = _place(wedges, scratch, n, count, p, q)
        scratch.leg[n] = distance(_place(wedges, scratch, n - 1, count, p, q), at)
        total += scratch.leg[n]
    return _set_angles(wedges, count, p, q, scratch), total


@part
def solve_way(
    view: View, edges: Edges, count: int, p: Vec3, q: Vec3, scratch: WayScratch
) -> tuple[int, float]:
    """Pull the way at hand taut, or leave it as rays have found it; leave out edges in whose light it passes, or
    one of two that it meets at once, and add those of narrow faces along which it goes: (how many edges it has, its
    length, m); 0 if something is in the way."""
    wedges, total = edges.wedges, math.inf
    while count > 0:
        for n in range(count):
            scratch.z[n] = scratch.found[n]
        _pull_taut(wedges, count, p, q, scratch)
        if not _all_free(view, wedges, count, p, q, scratch):
            for n in range(count):
                scratch.z[n] = scratch.found[n]
            if not _all_free(view, wedges, count, p, q, scratch):
                return 0, math.inf
        needless, total = _measure(wedges, count, p, q, scratch)
        if needless < 0:
            needless = _slack(view, wedges, count, p, q, scratch)
        if needless < 0:
            break
        _leave_out(needless, count, scratch)
        count -= 1
    before = count
    for n in range(_MOST_EDGES - 1):
        if n < count - 1:
            count = _add_face(edges, n, count, p, q, scratch)
    if count > before:
        _pull_taut(wedges, count, p, q, scratch)
        needless, total = _measure(wedges, count, p, q, scratch)
        if needless >= 0:
            return 0, math.inf
    return count, total


@part
def _slack(view: View, wedges: Wedges, count: int, p: Vec3, q: Vec3, scratch: WayScratch) -> int:
    """An edge in whose light the way passes, and without which it is free; -1 for none. The first and the last one
    stay near their shadow, where the way by them fades."""
    edge, z = scratch.edge, scratch.z
    scratch.needed[:] = False
    for n in range(count if count > 1 else 0):
        inner, light = 0 < n < count - 1, _light(n, scratch)
        if light < (_ALONG if inner else 0.0):
            continue
        before = met_point(wedges, edge[n - 1], z[n - 1]) if n > 0 else p
        after = met_point(wedges, edge[n + 1], z[n + 1]) if n < count - 1 else q
        if n == 0:
            free = _reaches(view, wedges, p, edge[1], after)
        elif n == count - 1:
            free = _reaches(view, wedges, q, edge[n - 1], before)
        else:
            free = is_free(view.geometry, wedges, (edge[n - 1], edge[n + 1]), (before, after))
        if free and (inner or light > _NEAR_SHADOW):
            return n
        if not (inner or free):
            scratch.needed[0 if n == 0 else 1] = True
    return -1


@part
def _add_face(edges: Edges, n: int, count: int, p: Vec3, q: Vec3, scratch: WayScratch) -> int:
    """Add the other edge of a face along which the way leaves its edge n or comes to the next one, where that face
    ends on the way: how many edges it then has."""
    wedges, links, edge = edges.wedges, edges.links, scratch.edge
    for end in range(2):
        e, other = (edge[n], edge[n + 1]) if end == 0 else (edge[n + 1], edge[n])
        own, to = (
            _place(wedges, scratch, n + end, count, p, q),
            _place(wedges, scratch, n + 1 - end, count, p, q),
        )
        about, sector = wedge_coordinates(wedges, e, to), math.pi * wedges.n[e]
        phi, across = about.phi, max(about.r, MIN_RADIUS)
        face = 0 if phi < 0.5 * sector or phi > 0.5 * sector + math.pi else 1
        off = abs(phi - sector) if face == 1 else min(phi, 2.0 * math.pi - phi)
        if off > _ALONG or count == _MOST_EDGES:
            continue
        for m in range(links.start[e], links.start[e + 1]):
            f, far = links.wedge[m], links.width[m] / across
            if (links.phi[m, 0] > 0.5 * sector) != (face == 1) or f == other or far > 1.0:
                continue
            at = along(own, far, subtract(to, own))
            z = dot(subtract(at, row(wedges.start, f)), row(wedges.along, f))
            if 0.0 < z < wedges.length[f]:
                _insert(n + 1, count, f, z, scratch)
                return count + 1
    return count


@part(forceinline=True)
def _in_sector(phi: float, sector: float, near: float) -> float:
    """An angle about an edge of what rays have found: of its face, if it is near to that, or behind it."""
    if phi < near or phi > 0.5 * sector + math.pi:
        return 0.0
    return sector if phi > sector - near else phi


@part(forceinline=True)
def _is_less(wedges: Wedges, e: int, f: int) -> bool:
    """Whether edge e is shorter than f: an order that does not depend on from where a way is solved."""
    return wedges.length[e] < wedges.length[f] or (wedges.length[e] == wedges.length[f] and e < f)


@part
def _set_angles(wedges: Wedges, count: int, p: Vec3, q: Vec3, scratch: WayScratch) -> int:
    """Angles of the way about its edges: -1; or the lesser of two edges that it meets at once, or one on whose line
    it begins or ends."""
    edge, angle = scratch.edge, scratch.angle
    for n in range(count):
        e, sector, off = edge[n], math.pi * wedges.n[edge[n]], length(row(wedges.offset, edge[n]))
        before = wedge_coordinates(wedges, e, _place(wedges, scratch, n - 1, count, p, q))
        after = wedge_coordinates(wedges, e, _place(wedges, scratch, n + 1, count, p, q))
        if min(before.r, after.r) < MIN_RADIUS:
            other = n - 1 if before.r < MIN_RADIUS else n + 1
            return other if 0 <= other < count and _is_less(wedges, edge[other], e) else n
        scratch.sine[n] = min((before.r + after.r) / (scratch.leg[n] + scratch.leg[n + 1]), 1.0)
        near_p = near_q = 0.0
        if n > 0:
            near_p = ON_FACE + (off + length(row(wedges.offset, edge[n - 1]))) / before.r
        if n < count - 1:
            near_q = ON_FACE + (off + length(row(wedges.offset, edge[n + 1]))) / after.r
        angle[n, 0] = _in_sector(before.phi, sector, near_p)
        angle[n, 1] = _in_sector(after.phi, sector, near_q)
    for n in range(count - 1):
        e, f = edge[n], edge[n + 1]
        leg = on_one_side(wedges, (e, f), (angle[n, 1], angle[n + 1, 0]), (angle[n, 0], angle[n + 1, 1]))
        angle[n, 1], angle[n + 1, 0] = leg
        scratch.common[n] = on_faces(leg, (math.pi * wedges.n[e], math.pi * wedges.n[f]))
    scratch.common[count - 1] = False
    return -1


@part(forceinline=True)
def _is_face(wedges: Wedges, n: int, count: int, scratch: WayScratch) -> bool:
    """Whether the way's edge n and its next one are the parallel edges of a face along which it goes."""
    if n + 1 >= count or max(_light(n, scratch), _light(n + 1, scratch)) > _NEAR_SHADOW:
        return False
    return scratch.common[n] and parallel(wedges, scratch.edge[n], scratch.edge[n + 1])


@part
def _set_units(wedges: Wedges, count: int, scratch: WayScratch) -> None:
    """Which edges are one factor, and how much each factor matters: the square of its turn beyond the boundary of
    its shadow, times what both parts of the way make of it."""
    n = 0
    while n < count:
        both = _is_face(wedges, n, count, scratch)
        # Of two faces with a common edge, that whose edges turn the sound more.
        if both and _is_face(wedges, n + 1, count, scratch):
            both = _light(n, scratch) <= _light(n + 2, scratch)
        scratch.unit[n] = 2 if both else 1
        if both:
            scratch.unit[n + 1] = 0
        n += scratch.unit[n]
    for n in range(count):
        before = after = turn = 0.0
        for m in range(count + 1):
            if m <= n:
                before += scratch.leg[m]
            elif m >= n + scratch.unit[n]:
                after += scratch.leg[m]
        for m in range(n, n + scratch.unit[n]):
            turn += max(-_light(m, scratch), 0.0)
        scratch.size[n] = turn * turn * before * after / (before + after)
        scratch.set[n] = False


@part
def _legs_of(count: int, n: int, scratch: WayScratch) -> tuple[float, float]:
    """Lengths of the way before a factor and after it, up to the next ones that are there."""
    before, m = scratch.leg[n], n - 1
    while m >= 0 and not scratch.set[m]:
        before += scratch.leg[m]
        m -= 1
    m = n + scratch.unit[n]
    after = scratch.leg[m]
    while m < count and not scratch.set[m]:
        m += 1
        after += scratch.leg[m]
    return before, after


@part(forceinline=True)
def _beyond(phi: float, towards: float) -> float:
    """An angle that is not in the light of what is at `towards`."""
    return towards + math.copysign(max(abs(phi - towards), math.pi + BOUNDARY_OFFSET), phi - towards)


@part(forceinline=True)
def _is_passed(n: int, count: int, scratch: WayScratch) -> bool:
    """Whether the way only goes by an edge, well in its light, as where something stands out of a rough wall."""
    return 0 < n < count - 1 and _light(n, scratch) > _ALONG


@part
def _multiply(
    wedges: Wedges,
    count: int,
    n: int,
    spectrum: Spectrum,
    scratch: WayScratch,
    double: DoubleWedgeScratch,
) -> None:
    """Multiply the wave by a factor."""
    (before, after), angle, e = _legs_of(count, n, scratch), scratch.angle, scratch.edge[n]
    half = 0.5 if scratch.common[n] else 1.0
    if scratch.unit[n] == 2:
        f, sine, axis = scratch.edge[n + 1], scratch.sine[n], row(wedges.along, e)
        w = scratch.leg[n + 1] * sine
        ends = Ends(wedges.n[e], wedges.n[f], before * sine, after * sine, 0.0, 0.0, w)
        first = angle[n, 0] if n == 0 else _beyond(angle[n, 0], angle[n, 1])
        last = angle[n + 1, 1] if n + 2 == count else _beyond(angle[n + 1, 1], angle[n + 1, 0])
        set_terms(wedges.n[e], first, angle[n, 1], sense_of(wedges, e, axis), double.p_e)
        set_terms(wedges.n[f], last, angle[n + 1, 0], sense_of(wedges, f, axis), double.q_f)
        root = math.sqrt((before + after) * sine + w)
        half = 0.5 if scratch.common[n + 1] else 1.0
        for m in range(len(spectrum.node)):
            double.wave[m] *= half * root * double_wedge_field(ends, spectrum.node[m] * sine, double)
        return
    light, passes, goes_by = _light(n, scratch), 0.0, _is_passed(n, count, scratch)
    if light > 0.0 and _is_needed(n, count, scratch):
        passes = _near_shadow(light, 2.0 * _NEAR_SHADOW)
    if goes_by and passes == 1.0:
        return
    one, other, sector, on = angle[n, 0], angle[n, 1], math.pi * wedges.n[e], math.inf
    plus, on_face = one + other, min(one, other) == 0.0 or max(one, other) == sector
    waves = 2.0 if on_face else 1.0  # what the face reflects passes too
    path = EdgePath(
        wedges.n[e], abs(other - one), plus, 2.0 * sector - plus, before, after, scratch.sine[n], 0.5, 1.0,
        on, on, 1.0,
    )  # fmt: skip
    front = front_of(path, terms_of(path))
    for m in range(len(spectrum.node)):
        turned = (before + after) * field_at(path, front, spectrum.node[m], (1.0, 1.0))
        if goes_by:
            double.wave[m] *= passes + (1.0 - passes) * half * turned
        else:
            double.wave[m] *= half * (waves * passes + turned)


@part
def _narrowest(
    wedges: Wedges, count: int, p: Vec3, q: Vec3, total: float, scratch: WayScratch
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Of the edge whose end is nearest to the way, or farthest from it where the way is drawn to an end: detours by
    both its ends, m, beyond the shortest path by its line, the rest of the way unfolded; -1 for an end beyond which
    that path is, else 1."""
    least, before = math.inf, 0.0
    found, sides = (math.inf, math.inf), (1.0, 1.0)
    for n in range(count):
        before += scratch.leg[n]
        e, z, after = scratch.edge[n], scratch.z[n], total - before
        z_p, r_p = line_coordinates(wedges, e, _place(wedges, scratch, n - 1, count, p, q))
        z_q, r_q = line_coordinates(wedges, e, _place(wedges, scratch, n + 1, count, p, q))
        s, t = before / scratch.leg[n], after / scratch.leg[n + 1]
        ends, legs = (z + s * (z_p - z), z + t * (z_q - z)), (s * r_p, t * r_q)
        apex = ends[0] + (ends[1] - ends[0]) * legs[0] / (legs[0] + legs[1])
        shortest = math.hypot(legs[0] + legs[1], ends[1] - ends[0])
        both = detours_of_ends(wedges.length[e], legs, ends, shortest)
        side = -1.0 if apex < 0.0 else 1.0, -1.0 if apex > wedges.length[e] else 1.0
        by = (
            math.inf if wedges.stands[e, 0] and min(ends) > 0.0 else both[0],
            math.inf if wedges.stands[e, 1] and max(ends) < wedges.length[e] else both[1],
        )
        nearest = min(by[0] * side[0], by[1] * side[1])
        if nearest < least and not _is_passed(n, count, scratch):
            least, found, sides = nearest, by, side
    return found, sides


@part
def way_field(
    wedges: Wedges,
    count: int,
    p: Vec3,
    q: Vec3,
    total: float,
    spectrum: Spectrum,
    least: np.ndarray,
    scratch: WayScratch,
    double: DoubleWedgeScratch,
    field: np.ndarray,
) -> bool:
    """(T34e) of the way at hand, of this length, 1/m, into `field` (b, g), without the phase of its length; at most
    twice the free field. Whether it has at least `least` (b,) of |p|² in some band."""
    _set_units(wedges, count, scratch)
    for m in range(len(spectrum.node)):
        double.wave[m] = 1.0 / total
    for _ in range(count):
        chosen, most = -1, -1.0
        for n in range(count):
            if scratch.unit[n] > 0 and not scratch.set[n] and scratch.size[n] > most:
                chosen, most = n, scratch.size[n]
        if chosen < 0:
            break
        _multiply(wedges, count, chosen, spectrum, scratch, double)
        scratch.set[chosen] = True
        if scratch.unit[chosen] == 2:
            scratch.set[chosen + 1] = True
    weight = weight_of(count, scratch)
    (start, end), sides = _narrowest(wedges, count, p, q, total, scratch)
    drawn = start if sides[0] < 0.0 else end if sides[1] < 0.0 else 0.0  # to an end, by so much
    boundary, loud = max(total - distance(p, q), 0.0), False
    for b in range(field.shape[0]):
        first, number = spectrum.first[b], spectrum.between.shape[2]
        for g in range(field.shape[1]):
            k, u = spectrum.k[b, g], 0j
            for n in range(number):
                u += spectrum.between[b, g, n] * double.wave[first + n]
            share = sides[0] * of_end(beyond_end(k, start), start, boundary)
            share += sides[1] * of_end(beyond_end(k, end), end, boundary)
            u *= 0.5 * weight * share * complex(math.cos(k * drawn), math.sin(k * drawn))
            size = 0.5 * total * math.sqrt(u.real**2 + u.imag**2)
            field[b, g] = u / size if size > 1.0 else u
        own = field[b, 0].real ** 2 + field[b, 0].imag ** 2
        loud = loud or own > least[b]
        if not loud and own < _FALLS * least[b]:
            return False
    return loud
