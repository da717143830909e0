"""Sound out of sight: the shortest ways round edges, up to eight.

A point's ways are found once for all its pairs, as navigation meshes and visibility graphs do it: edges that see
each other are the nodes (`scene_edges`), and the shortest way to each goes on from the shortest way to another one.
From the last edge that the other point sees, the way goes straight. Rays have found every leg free.

A way is pulled taut: every edge in turn has its shortest path between the places before and after. By two edges or
more sound comes as over two screens, each with half of the detour. With l the way's length and r that of a straight
line, by what ISO 9613-2 (1996, eq. 14) leaves behind one screen, reflections apart,

    |P|^2 = 1 / l^2 * (3 + 20 (l - r) / lambda)^-2.                                                        (T34e)

It depends on how far round the way is and not on which edges a mesh has there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, dot, row, subtract
from soundspaces_sim.scene.rays.geometry import unoccluded
from soundspaces_sim.transport.arrivals.field import Spectrum
from soundspaces_sim.transport.arrivals.images import View
from soundspaces_sim.transport.arrivals.scene_edges import Edges, Links, is_free
from soundspaces_sim.transport.arrivals.two_edges import MIN_RADIUS
from soundspaces_sim.transport.arrivals.wedges import (
    Wedges,
    clear_point,
    edge_point,
    line_coordinates,
    met_point,
    wedge_coordinates,
)

_MOST_EDGES = 8  # of a way
_TRIED = 4  # ways to a point, by different last edges, until one is free
_OF_THREAD = 8  # points whose ways are worth a thread
_SHORTER = 1e-3  # m, by which a way must be, to be another
_PLACES = 5  # of an edge that are tried where its nearest place is not seen
_SWEEPS = 12  # by which a way is pulled taut
_NEAR_SHADOW = 0.5  # rad, from the boundary of its shadow, up to which an end counts as in it


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
    edge: np.ndarray  # (_MOST_EDGES,)
    z: np.ndarray  # (_MOST_EDGES,) m
    found: np.ndarray  # (_MOST_EDGES,) m, where rays have found the way free


def make_way_scratch() -> WayScratch:
    """Empty."""
    return WayScratch(
        total=np.empty((2, _TRIED)),
        last=np.empty((2, _TRIED), np.int64),
        edge=np.empty(_MOST_EDGES, np.int64),
        z=np.empty(_MOST_EDGES),
        found=np.empty(_MOST_EDGES),
    )


# Of a point


@part
def _seen_place(view: View, wedges: Wedges, e: int, p: Vec3, z: float) -> float:
    """The place of an edge, m, that a point sees: the nearest one, or of some along it that which is nearest."""
    far, best = wedges.length[e], math.nan
    if unoccluded(view.geometry, p, met_point(wedges, e, z)):
        return min(max(z, 0.0), far)
    for k in range(_PLACES):
        tried = (k + 0.5) / _PLACES * far
        nearer = not abs(best - z) <= abs(tried - z)
        if nearer and unoccluded(view.geometry, p, clear_point(wedges, e, tried)):
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
def _turn_at(wedges: Wedges, ways: Ways, i: int, e: int, phi: float) -> float:
    """By how much the way of point i turns at an edge towards what is at the angle phi about it."""
    return abs(phi - _in_sector(wedges, e, ways.phi[i, e]))


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
    if not unoccluded(view.geometry, p, at):
        return False
    for n in range(1, count):
        to = met_point(wedges, edge[n], z[n])
        if not is_free(view.geometry, wedges, (edge[n - 1], edge[n]), (at, to)):
            return False
        at = to
    return unoccluded(view.geometry, q, at)


@part
def _leave_out(n: int, count: int, scratch: WayScratch) -> None:
    for m in range(n, count - 1):
        scratch.edge[m], scratch.found[m] = scratch.edge[m + 1], scratch.found[m + 1]


@part
def solve_way(
    view: View, edges: Edges, count: int, p: Vec3, q: Vec3, scratch: WayScratch
) -> tuple[int, float]:
    """Pull the way at hand taut, or leave it as rays have found it, and leave out edges in whose light it passes:
    (how many edges it has, its length, m); 0 if something is in the way."""
    wedges = edges.wedges
    while count > 0:
        for n in range(count):
            scratch.z[n] = scratch.found[n]
        _pull_taut(wedges, count, p, q, scratch)
        if not _all_free(view, wedges, count, p, q, scratch):
            for n in range(count):
                scratch.z[n] = scratch.found[n]
            if not _all_free(view, wedges, count, p, q, scratch):
                return 0, math.inf
        slack = _slack(view, wedges, count, p, q, scratch)
        if slack < 0:
            break
        _leave_out(slack, count, scratch)
        count -= 1
    total = 0.0
    for n in range(count + 1):
        total += distance(
            _place(wedges, scratch, n - 1, count, p, q), _place(wedges, scratch, n, count, p, q)
        )
    return count, total


@part
def _slack(view: View, wedges: Wedges, count: int, p: Vec3, q: Vec3, scratch: WayScratch) -> int:
    """An edge in whose light the way passes, and without which it is free; -1 for none."""
    edge, z = scratch.edge, scratch.z
    for n in range(count if count > 1 else 0):
        one = wedge_coordinates(wedges, edge[n], _place(wedges, scratch, n - 1, count, p, q))
        other = wedge_coordinates(wedges, edge[n], _place(wedges, scratch, n + 1, count, p, q))
        turn = abs(_in_sector(wedges, edge[n], one.phi) - _in_sector(wedges, edge[n], other.phi))
        if min(one.r, other.r) > MIN_RADIUS and turn > math.pi:
            continue
        before = met_point(wedges, edge[n - 1], z[n - 1]) if n > 0 else p
        after = met_point(wedges, edge[n + 1], z[n + 1]) if n < count - 1 else q
        if n == 0:
            free = unoccluded(view.geometry, p, after)
        elif n == count - 1:
            free = unoccluded(view.geometry, q, before)
        else:
            free = is_free(view.geometry, wedges, (edge[n - 1], edge[n + 1]), (before, after))
        if free:
            return n
    return -1


@part(forceinline=True)
def _in_sector(wedges: Wedges, e: int, phi: float) -> float:
    """An angle about an edge, or that of the face behind which it is."""
    sector = math.pi * wedges.n[e]
    return 0.0 if phi > 0.5 * sector + math.pi else min(phi, sector)


@part
def are_linked(links: Links, e: int, f: int) -> bool:
    """Whether a face connects two edges."""
    for n in range(links.start[e], links.start[e + 1]):
        if links.wedge[n] == f:
            return True
    return False


@part
def way_field(
    length: float, straight: float, spectrum: Spectrum, least: np.ndarray, field: np.ndarray
) -> bool:
    """(T34e) of a way of this length, m, for ends this far apart: 1/m, into `field` (b, g). Whether it has at least
    `least` (b,) of |p|² in some band."""
    detour, loud = max(length - straight, 0.0), False
    for b in range(field.shape[0]):
        for g in range(field.shape[1]):
            field[b, g] = 1.0 / (length * (3.0 + 20.0 * detour * spectrum.k[b, g] / (2.0 * math.pi)))
        loud = loud or field[b, 0].real ** 2 > least[b]
    return loud
