"""What each point of a side sees, once for all its pairs: planes, wedges, and wedges by way of planes.

An *end* is a point or its image in a plane, from which sound comes by that plane. Tables are compressed rows:
those of end i are start[i]:start[i + 1].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, reflect, row
from soundspaces_sim.scene.rays.directions import sample_sphere
from soundspaces_sim.scene.rays.geometry import cast_ray, material_met, surface_point, unoccluded
from soundspaces_sim.transport.arrivals.images import (
    End,
    View,
    image_end,
    point_end,
    reflection_point,
    sees,
    signed_distance,
)
from soundspaces_sim.transport.arrivals.scene_edges import Edges
from soundspaces_sim.transport.arrivals.two_edges import NEAR_SHADOW
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
_BLOCK = 32  # points that are tried against all wedges at a time
_IMAGES = 256  # images
_OF_THREAD = 32  # images for which it is worth to start a thread
_ROUNDING = 1e-9  # m
_MIN_DISTANCE = 0.06  # m, of an edge from a plane by which it is seen: more is not part of it


class Seen(NamedTuple):
    """The wedges that n ends see, and where the ends are about them."""

    start: np.ndarray  # (n + 1,)
    wedge: np.ndarray  # (m,) ascending for an end
    z: np.ndarray  # (m,) m
    r: np.ndarray  # (m,) m
    phi: np.ndarray  # (m,) rad
    cos: np.ndarray  # (m,) of phi / n
    sin: np.ndarray  # (m,)
    link_start: np.ndarray  # (n + 1,)
    link_split: np.ndarray  # (n,) before it are links of one face, from it on others
    link: np.ndarray  # (l,) rows of `MutualVisibility`, from a wedge that the end sees
    link_row: np.ndarray  # (l,) row of that wedge above
    link_cot: np.ndarray  # (l,) sum of the cotangents of (T30) towards the other wedge, for estimates
    link_shadow: np.ndarray  # (l,) whether the other wedge is partly in the shadow of that one


class SeenEnd(NamedTuple):
    """An end, row `row` of what ends see."""

    end: End
    row: int
    seen: Seen


class Sequences(NamedTuple):
    """Planes worth trying from N points: those that rays meet."""

    seen: (
        np.ndarray
    )  # (N, P, P + 1): from point i, rays meet plane a alone ([a, P]) or a and then b ([a, b])
    start: np.ndarray  # (N + 1,)
    planes: np.ndarray  # (n, 2) plane, and the second one or -1


class Sight(NamedTuple):
    """N points and what they see."""

    points: np.ndarray  # (N, 3) m
    keys: np.ndarray  # (N,) of `point_keys`: of a pair the smaller one's point comes first
    sequences: Sequences
    of_points: Seen
    image_start: np.ndarray  # (N + 1,)
    plane: np.ndarray  # (m,) of each image
    of_images: Seen


@part(forceinline=True)
def seen_point(sight: Sight, i: int) -> SeenEnd:
    """Point i as an end."""
    return SeenEnd(point_end(row(sight.points, i)), i, sight.of_points)


@part(forceinline=True)
def seen_image(view: View, sight: Sight, i: int, u: int) -> SeenEnd:
    """Image u, one of point i's, as an end."""
    return SeenEnd(image_end(view, sight.plane[u], row(sight.points, i)), u, sight.of_images)


@part(forceinline=True)
def coordinates_in(seen: Seen, n: int) -> WedgeCoordinates:
    """Coordinates of a row's end about the row's wedge."""
    return WedgeCoordinates(seen.z[n], seen.r[n], seen.phi[n])


# Planes


@part
def _specular_plane(view: View, triangle: int, direction: Vec3) -> int:
    """Plane of a triangle that reflects sound of this direction specularly in any band, else -1."""
    if specular_albedo(view.surfaces, material_met(view.geometry, triangle, direction)) > 0.0:
        return view.geometry.plane[triangle]
    return -1


@kernel
def _find_sequences(first: int, last: int, sight: View, points: np.ndarray, seen: np.ndarray) -> None:
    """Set flags of `Sequences.seen`."""
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
    count = len(view.planes.offset)
    seen = np.zeros((len(points), count, count + 1), np.bool_)
    over_rows(_find_sequences, len(points), view, points, seen)
    rows = np.argwhere(seen)
    start = np.searchsorted(rows[:, 0], np.arange(len(points) + 1))
    found = rows[:, 1:].copy()
    found[found[:, 1] == count, 1] = -1
    return Sequences(seen, start, found)


# Wedges


@kernel
def _try_points(
    first: int,
    last: int,
    sight: View,
    wedges: Wedges,
    points: np.ndarray,
    seen: np.ndarray,
    coordinates: np.ndarray,
) -> None:
    """Flags `seen` (n, E): some point of edge e is seen from point i; `coordinates` (n, E, 3) of i about e."""
    geometry = sight.geometry
    for i in range(first, last):
        p = row(points, i)
        for e in range(len(wedges.length)):
            c = wedge_coordinates(wedges, e, p)
            if c.phi > math.pi * wedges.n[e] or c.r < geometry.epsilon:
                continue
            coordinates[i, e, 0], coordinates[i, e, 1], coordinates[i, e, 2] = c
            count = max(int(math.ceil(wedges.length[e] / _SPACING)), 2)
            for k in range(count):
                if unoccluded(geometry, p, clear_point(wedges, e, (k + 0.5) / count * wedges.length[e])):
                    seen[i, e] = True
                    break


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
def _try_images(
    first: int,
    last: int,
    sight: View,
    wedges: Wedges,
    points: np.ndarray,
    plane: np.ndarray,
    seen: np.ndarray,
    coordinates: np.ndarray,
) -> None:
    """`_try_points` of the images of points (n, 3) in planes (n,)."""
    for i in range(first, last):
        end = image_end(sight, plane[i], row(points, i))
        for e in range(len(wedges.length)):
            if _not_by_plane(sight, end, wedges, e):
                continue
            c = wedge_coordinates(wedges, e, end.at)
            if c.phi > math.pi * wedges.n[e] or c.r < sight.geometry.epsilon:
                continue
            coordinates[i, e, 0], coordinates[i, e, 1], coordinates[i, e, 2] = c
            count = max(int(math.ceil(wedges.length[e] / _SPACING)), 2)
            for k in range(count):
                if sees(sight, end, clear_point(wedges, e, (k + 0.5) / count * wedges.length[e])):
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
def _towards(n: float, phi: float, low: float, high: float) -> tuple[float, bool]:
    """(Most of the cotangents' sum from an end at phi to a wedge between two angles; whether part of that wedge is
    in the shadow)."""
    shadow = max(high - phi, phi - low) > math.pi - NEAR_SHADOW
    if (high - phi > math.pi > low - phi) or (phi - low > math.pi > phi - high):
        return math.inf, True
    return max(_cot_sum(n, low - phi, low + phi), _cot_sum(n, high - phi, high + phi)), shadow


@kernel
def _find_links(
    first: int, last: int, edges: Edges, seen: Seen, count: np.ndarray, others: bool, fill: bool
) -> None:
    """Counts (n, 2) of each end's links of one face and, with `others`, of others; with `fill` the links."""
    mutual, links = edges.mutual, edges.links
    for i in range(first, last):
        count[i, 0] = count[i, 1] = 0
        for n in range(seen.start[i], seen.start[i + 1]):
            e = seen.wedge[n]
            for m in range(mutual.start[e], mutual.start[e + 1]):
                if not (links.strip[m] or others):
                    continue
                kind = 0 if links.strip[m] else 1
                if fill:
                    at = (seen.link_start[i] if kind == 0 else seen.link_split[i]) + count[i, kind]
                    cot, shadow = _towards(
                        edges.wedges.n[e], seen.phi[n], mutual.phi[m, 0], mutual.phi[m, 1]
                    )
                    seen.link[at], seen.link_row[at] = m, n
                    seen.link_cot[at], seen.link_shadow[at] = cot, shadow
                count[i, kind] += 1


def _see(
    edges: Edges,
    ends: int,
    block: int,
    look: Callable[[slice, np.ndarray, np.ndarray], None],
    others: bool,
) -> Seen:
    """What so many ends see of the edges, `block` of them at a time: `look` fills flags (n, E) and coordinates
    (n, E, 3) of a slice of the ends."""
    count = len(edges.wedges.length)
    rows, found, places = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty((0, 3))]
    for begin in range(0, ends, block):
        some = slice(begin, min(begin + block, ends))
        flags = np.zeros((some.stop - begin, count), np.bool_)
        coordinates = np.empty((*flags.shape, 3))
        look(some, flags, coordinates)
        i, e = np.nonzero(flags)
        rows.append(begin + i)
        found.append(e)
        places.append(coordinates[i, e])
    start = np.searchsorted(np.concatenate(rows), np.arange(ends + 1))
    z, r, phi = np.ascontiguousarray(np.concatenate(places).T)
    none, number = np.empty(0, np.int32), np.zeros((ends, 2), np.int64)
    starts = np.zeros(ends + 1, np.int64)
    wedge = np.concatenate(found)
    turn = phi / edges.wedges.n[wedge]
    seen = Seen(
        start, wedge, z, r, phi, np.cos(turn), np.sin(turn), starts, starts[1:], none, none,
        np.empty(0, np.float32), np.empty(0, np.bool_),
    )  # fmt: skip
    over_rows(_find_links, ends, edges, seen, number, others, False, least=_OF_THREAD)
    starts = np.append(0, np.cumsum(number.sum(axis=1)))
    seen = seen._replace(
        link_start=starts,
        link_split=starts[:-1] + number[:, 0],
        link=np.empty(starts[-1], np.int32),
        link_row=np.empty(starts[-1], np.int32),
        link_cot=np.empty(starts[-1], np.float32),
        link_shadow=np.empty(starts[-1], np.bool_),
    )
    over_rows(_find_links, ends, edges, seen, number, others, True, least=_OF_THREAD)
    return seen


def find_sight(view: View, edges: Edges, points: np.ndarray, keys: np.ndarray) -> Sight:
    """What points (N, 3) m of these keys see; images are those in the planes that are large."""
    sequences = find_sequences(view, points)

    def from_points(some: slice, flags: np.ndarray, coordinates: np.ndarray) -> None:
        over_rows(_try_points, len(flags), view, edges.wedges, points[some], flags, coordinates, chunk=1)

    of_points = _see(edges, len(points), _BLOCK, from_points, others=True)
    met = sequences.seen[:, :, -1] & edges.large
    if len(edges.wedges.length) == 0:
        met = np.zeros_like(met)
    # Columns of one array as `nonzero` has them, so of another layout for one image, another type for kernels.
    point, plane = map(np.ascontiguousarray, np.nonzero(met))

    def from_images(some: slice, flags: np.ndarray, coordinates: np.ndarray) -> None:
        at = np.ascontiguousarray(points[point[some]])
        over_rows(
            _try_images, len(flags), view, edges.wedges, at, plane[some], flags, coordinates,
            chunk=1, least=_OF_THREAD,
        )  # fmt: skip

    of_images = _see(edges, len(plane), _IMAGES, from_images, others=False)
    start = np.searchsorted(point, np.arange(len(points) + 1))
    return Sight(points, keys, sequences, of_points, start, plane, of_images)
