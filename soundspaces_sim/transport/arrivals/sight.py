"""What each point of a side sees, once for all its pairs: planes, wedges, and wedges by way of planes.

An *end* is a point or its image in a plane, from which sound comes by that plane. Those of a point follow each
other, the point itself first. Tables are compressed rows: those of end i are start[i]:start[i + 1].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, reflect, row
from soundspaces_sim.scene.rays.directions import sample_sphere
from soundspaces_sim.scene.rays.geometry import cast_ray, material_met, surface_point
from soundspaces_sim.transport.arrivals.images import (
    End,
    View,
    end_at,
    leg_to,
    reflection_point,
    signed_distance,
)
from soundspaces_sim.transport.arrivals.scene_edges import Edges
from soundspaces_sim.transport.arrivals.ways import Ways, find_ways
from soundspaces_sim.transport.arrivals.wedges import (
    WedgeCoordinates,
    Wedges,
    clear_point,
    edge_point,
    wedge_coordinates,
)
from soundspaces_sim.transport.bsdf.surface import specular_albedo

_RAYS = (
    8192  # from every point: a Fibonacci lattice, so that a pair's sequences are the same in any tile
)
_GOLDEN = 0.6180339887498949
_SPACING = 0.4  # m, between the points of an edge that are tried
_FLAGS = 2**26  # of sequences of two planes, at a time
_BLOCK = 256  # ends that are tried against all wedges at a time
_OF_THREAD = 32  # ends whose links are worth a thread
_ROUNDING = 1e-9  # m
_MIN_DISTANCE = 0.06  # m, of an edge from a plane by which it is seen: more is not part of it


class Seen(NamedTuple):
    """The wedges that n ends see, and where the ends are about them."""

    start: np.ndarray  # (n + 1,)
    wedge: np.ndarray  # (m,) ascending for an end
    z: np.ndarray  # (m,) m
    r: np.ndarray  # (m,) m
    phi: np.ndarray  # (m,) rad
    turn: np.ndarray  # (m, 4) cosine and sine of phi / 2n, and of phi / 2
    link_start: np.ndarray  # (n + 1,)
    link: np.ndarray  # (l,) rows of `Links`, from a wedge that the end sees
    link_row: np.ndarray  # (l,) row of that wedge above
    # (l,) 1/m, square of (T30) towards the other wedge, times k and what distances make of it
    link_size: np.ndarray


class Sequences(NamedTuple):
    """Planes worth trying from N points: those that rays meet."""

    start: np.ndarray  # (N + 1,)
    planes: np.ndarray  # (n, 2) plane, and the second one or the number of planes, in order


class Sight(NamedTuple):
    """N points and what they see, themselves and by their images."""

    points: np.ndarray  # (N, 3) m
    keys: np.ndarray  # (N,) of `point_keys`, of no seed: of a pair the smaller one's point comes first
    sequences: Sequences
    ends: np.ndarray  # (N + 1,) first end of each point
    plane: np.ndarray  # (n,) of each end, -1 of a point itself
    seen: Seen
    ways: Ways


@part(forceinline=True)
def coordinates_in(seen: Seen, n: int) -> WedgeCoordinates:
    """Coordinates of a row's end about the row's wedge."""
    return WedgeCoordinates(seen.z[n], seen.r[n], seen.phi[n])


@part(forceinline=True)
def row_of(seen: Seen, end: int) -> tuple[int, int]:
    """The rows of what an end sees."""
    return seen.start[end], seen.start[end + 1]


# Planes


@part
def _specular_plane(view: View, triangle: int, direction: Vec3) -> int:
    """Plane of a triangle that reflects sound of this direction specularly in any band, else -1."""
    if specular_albedo(view.surfaces, material_met(view.geometry, triangle, direction)) > 0.0:
        return view.geometry.plane[triangle]
    return -1


@kernel
def _find_sequences(first: int, last: int, sight: View, points: np.ndarray, seen: np.ndarray) -> None:
    """Set flags `seen` (N, P, P + 1): rays meet plane a alone, [a, P], or a and then b, [a, b]."""
    geometry, planes = sight.geometry, sight.planes
    count = len(planes.offset)
    for i in range(first, last):
        if count == 0:
            continue
        p = row(points, i)
        for k in range(_RAYS):
            v = k * _GOLDEN
            d = sample_sphere((k + 0.5) / _RAYS, v - math.floor(v))
            t, triangle = cast_ray(geometry, p, d, math.inf)
            if triangle < 0:
                continue
            a = _specular_plane(sight, triangle, d)
            if a < 0:
                continue
            seen[i, a, count] = True
            x, n = surface_point(geometry, triangle, p, d, t)
            x = along(x, geometry.epsilon + planes.margin[a], n)
            d = reflect(d, row(planes.normal, a))
            t, triangle = cast_ray(geometry, x, d, math.inf)
            if triangle < 0:
                continue
            b = _specular_plane(sight, triangle, d)
            if b >= 0 and b != a:
                seen[i, a, b] = True


def find_sequences(view: View, points: np.ndarray) -> Sequences:
    """The planes that rays from points (N, 3) m meet."""
    count, found = len(view.planes.offset), [np.empty((0, 3), np.int64)]
    some = max(_FLAGS // max(count * (count + 1), 1), 1)
    for begin in range(0, len(points), some):
        seen = np.zeros((len(points[begin : begin + some]), count, count + 1), np.bool_)
        over_rows(_find_sequences, len(seen), view, points[begin : begin + some], seen)
        found.append(np.argwhere(seen) + np.array([begin, 0, 0]))
    rows = np.concatenate(found)
    start = np.searchsorted(rows[:, 0], np.arange(len(points) + 1))
    return Sequences(start, rows[:, 1:].copy())


@part
def meets(sequences: Sequences, i: int, one: int, two: int) -> bool:
    """Whether rays from a point meet plane `one` and then `two`; `one` alone where `two` is how many planes there
    are."""
    low, high = sequences.start[i], sequences.start[i + 1]
    while low < high:
        middle = (low + high) // 2
        a, b = sequences.planes[middle, 0], sequences.planes[middle, 1]
        if a < one or (a == one and b < two):
            low = middle + 1
        else:
            high = middle
    return (
        low < sequences.start[i + 1]
        and sequences.planes[low, 0] == one
        and sequences.planes[low, 1] == two
    )


# Wedges


@part
def _not_by_plane(view: View, end: End, wedges: Wedges, e: int) -> bool:
    """Whether no place of an edge can be seen from an image: the edge is behind the plane or part of it, or its
    places of reflection, which lie between those of both ends, are beside the plane."""
    planes, a, far = view.planes, end.plane, wedges.length[e]
    ends = (
        signed_distance(planes, a, row(wedges.start, e)),
        signed_distance(planes, a, edge_point(wedges, e, far)),
    )
    side = signed_distance(planes, a, end.point)
    if max(ends[0] * side, ends[1] * side) <= 0.0:
        return True
    if max(abs(ends[0]), abs(ends[1])) < _MIN_DISTANCE + planes.margin[a]:
        return True
    before_first, first = reflection_point(planes, a, end.at, clear_point(wedges, e, 0.0))
    before_last, last = reflection_point(planes, a, end.at, clear_point(wedges, e, far))
    if not (before_first and before_last):
        return False
    low, high = view.boxes[a, 0], view.boxes[a, 1]
    for c in range(3):
        if max(first[c], last[c]) < low[c] - _ROUNDING or min(first[c], last[c]) > high[c] + _ROUNDING:
            return True
    return False


@kernel
def _try_ends(
    first: int,
    last: int,
    view: View,
    wedges: Wedges,
    points: np.ndarray,
    plane: np.ndarray,
    seen: np.ndarray,
    coordinates: np.ndarray,
) -> None:
    """Flags `seen` (n, E): some place of edge e is seen from the end of point i and plane i; `coordinates`
    (n, E, 3) of the end about e."""
    for i in range(first, last):
        end = end_at(view, plane[i], row(points, i))
        for e in range(len(wedges.length)):
            if end.plane >= 0 and _not_by_plane(view, end, wedges, e):
                continue
            c = wedge_coordinates(wedges, e, end.at)
            if c.phi > math.pi * wedges.n[e] or c.r < view.geometry.epsilon:
                continue
            coordinates[i, e, 0], coordinates[i, e, 1], coordinates[i, e, 2] = c
            count = max(int(math.ceil(wedges.length[e] / _SPACING)), 2)
            for k in range(count):
                if leg_to(view, end, clear_point(wedges, e, (k + 0.5) / count * wedges.length[e])).free:
                    seen[i, e] = True
                    break


@part
def _cot_sum(n: float, minus: float, plus: float) -> float:
    """Of the four terms of (T30), far from their boundaries."""
    total = 0.0
    for psi in (minus, -minus, plus, -plus):
        total += 1.0 / math.tan((math.pi + psi) / (2.0 * n) + _ROUNDING)
    return abs(total)


@part
def _towards(n: float, phi: float, low: float, high: float) -> float:
    """Most of the cotangents' sum from an end at phi to a wedge between two angles."""
    if (high - phi > math.pi > low - phi) or (phi - low > math.pi > phi - high):
        return math.inf
    return max(_cot_sum(n, low - phi, low + phi), _cot_sum(n, high - phi, high + phi))


@kernel
def _fill_links(first: int, last: int, edges: Edges, seen: Seen) -> None:
    """The links of the edges that each end sees."""
    links, wedges = edges.links, edges.wedges
    for i in range(first, last):
        at = seen.link_start[i]
        for n in range(seen.start[i], seen.start[i + 1]):
            e = seen.wedge[n]
            for m in range(links.start[e], links.start[e + 1]):
                cot = _towards(wedges.n[e], seen.phi[n], links.phi[m, 0], links.phi[m, 1])
                seen.link[at], seen.link_row[at] = m, n
                seen.link_size[at] = cot * cot / (8.0 * math.pi * wedges.n[e] ** 2 * seen.r[n])
                at += 1


def find_sight(view: View, edges: Edges, points: np.ndarray, keys: np.ndarray) -> Sight:
    """What points (N, 3) m of these keys see; images are those in the planes that are large."""
    sequences, wedges = find_sequences(view, points), edges.wedges
    met = np.zeros((len(points), len(view.large)), bool)
    if len(wedges.length):
        alone = np.flatnonzero(sequences.planes[:, 1] == len(view.large))
        plane = sequences.planes[alone, 0]
        met[np.searchsorted(sequences.start, alone, "right") - 1, plane] = view.large[plane]
    # A point itself comes before its images. Columns of one array are of another layout where there is one row.
    own, plane = np.nonzero(np.concatenate([np.ones((len(points), 1), bool), met], axis=1))
    own, plane = np.ascontiguousarray(own), np.ascontiguousarray(plane - 1)
    rows, found, places = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty((0, 3))]
    for begin in range(0, len(plane), _BLOCK):
        some = slice(begin, begin + _BLOCK)
        flags = np.zeros((len(plane[some]), len(wedges.length)), np.bool_)
        coordinates = np.empty((*flags.shape, 3))
        of = np.ascontiguousarray(points[own[some]])
        over_rows(_try_ends, len(flags), view, wedges, of, plane[some], flags, coordinates, chunk=1)
        i, e = np.nonzero(flags)
        rows.append(begin + i)
        found.append(e)
        places.append(coordinates[i, e])
    start = np.searchsorted(np.concatenate(rows), np.arange(len(plane) + 1))
    ends = np.searchsorted(own, np.arange(len(points) + 1))
    wedge = np.concatenate(found)
    seen = _with_links(edges, start, wedge, np.concatenate(places))
    first = np.flatnonzero(plane < 0)  # ends that are the points themselves
    spans, at = np.stack([start[first], start[first + 1]], axis=1), np.stack([seen.z, seen.phi], axis=1)
    ways = find_ways(view, edges, points, spans, wedge, at)
    return Sight(points, keys, sequences, ends, plane, seen, ways)


def _with_links(edges: Edges, start: np.ndarray, wedge: np.ndarray, places: np.ndarray) -> Seen:
    """What ends see of the edges, (m, 3) their coordinates about them, and the links from there."""
    z, r, phi = np.ascontiguousarray(places.T)
    turn, links = 0.5 * phi / edges.wedges.n[wedge], edges.links
    turns = np.stack([np.cos(turn), np.sin(turn), np.cos(0.5 * phi), np.sin(0.5 * phi)], axis=1)
    before = np.concatenate([[0], np.cumsum(np.diff(links.start)[wedge])])
    count = before[-1]
    seen = Seen(
        start, wedge, z, r, phi, turns, before[start], np.empty(count, np.int32),
        np.empty(count, np.int32), np.empty(count, np.float32),
    )  # fmt: skip
    over_rows(_fill_links, len(start) - 1, edges, seen, least=_OF_THREAD)
    return seen
