"""The images of a listener, and of the edges that they see those that a path from one source may need.

A tile tries every image of a point against every edge (`image_wedges`), for it may be asked for any of them.
Between an image and one other end, a point or its image in the same plane, few edges matter: those of a path by one
edge, which the other end sees as well and of which there is such a path (`single_path`); all that these edges see,
for the path may pass them; and those of a path by two edges of one face of which the other end sees one
(`two_edge_path`). All others may be left out: no path changes by it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.transport.diffraction.ends import End, image_end
from soundspaces_sim.transport.diffraction.image_wedges import Images, image_sees_edge, seen_image
from soundspaces_sim.transport.diffraction.passed_edges import EdgePair, EdgesOfScene, single_path
from soundspaces_sim.transport.diffraction.paths import beyond_tolerance, offset_length
from soundspaces_sim.transport.diffraction.points import EdgePoints, seen_point
from soundspaces_sim.transport.diffraction.seen_ends import SeenEnd, find_onward, goes_on
from soundspaces_sim.transport.diffraction.two_edges import most_energy, two_edge_path
from soundspaces_sim.transport.diffraction.visible_wedges import VisibleWedges, coordinates_in
from soundspaces_sim.transport.diffraction.wedges import edge_point, wedge_coordinates
from soundspaces_sim.transport.image_source.images import reflection_point, signed_distance
from soundspaces_sim.transport.image_source.sequences import rays_meet
from soundspaces_sim.transport.moving_listener.edge_planes import EdgePlanes, edge_sees_plane

_UNKNOWN, _HIDDEN, _SEEN = 0, 1, 2


class Other(NamedTuple):
    """The source, as the other end of paths from images of the listener."""

    points: EdgePoints
    images: Images
    swapped: bool  # between two images the listener's comes first
    lit: np.ndarray  # (P,) whether there is a reflection by a plane
    heard: float  # J/m², below which paths fade


class Found(NamedTuple):
    """What images in m planes see of E edges, as far as it was asked for."""

    state: np.ndarray  # (m, E) of `_UNKNOWN`, `_HIDDEN`, `_SEEN`
    coordinates: np.ndarray  # (m, E, 3) of the image about an edge
    met: np.ndarray  # (m,) whether rays of the listener meet the plane, as an image needs in a tile


class _Image(NamedTuple):
    """An image of the listener."""

    scene: EdgesOfScene
    edge_planes: EdgePlanes
    plane: int
    end: End
    side: float  # m, of the listener from the plane
    state: np.ndarray  # (E,)
    coordinates: np.ndarray  # (E, 3)


@part(forceinline=True)
def _may_see(image: _Image, e: int) -> bool:
    """Whether the edge sees the image's plane."""
    sight = image.scene.sight
    return edge_sees_plane(image.edge_planes, sight.geometry, image.scene.wedges, e, image.plane)


@part
def _sees(image: _Image, e: int) -> bool:
    """Whether an image sees an edge; found once."""
    if image.state[e] == _UNKNOWN:
        image.state[e] = _HIDDEN
        if not _may_see(image, e):
            return False
        seen, c = image_sees_edge(
            image.scene.sight, image.scene.wedges, image.plane, image.end, image.side, e
        )
        image.state[e] = _SEEN if seen else _HIDDEN
        image.coordinates[e, 0], image.coordinates[e, 1], image.coordinates[e, 2] = c
    return image.state[e] == _SEEN


@part
def _one_edge(image: _Image, other: SeenEnd, k: int, lit: bool, rows: np.ndarray, heard: float) -> bool:
    """Whether there may be a path by the edge of row `k` of what the other end sees."""
    scene, e = image.scene, other.visible.wedge[k]
    s = wedge_coordinates(scene.wedges, e, image.end.at)
    if s.phi > math.pi * scene.wedges.n[e] or s.r < scene.sight.geometry.epsilon:
        return False
    r = coordinates_in(other.visible, k)
    if lit:
        pair = EdgePair(image.end, other.end, rows, rows, True)
        if single_path(scene, e, s, r, pair, heard)[0]:
            return True
    if beyond_tolerance(s, r, offset_length(scene.wedges, e)):
        return False
    pair = EdgePair(image.end, other.end, rows, rows, False)
    return single_path(scene, e, s, r, pair, heard)[0]


@part
def _two_edges(image: _Image, other: SeenEnd, e: int, f: int, first: bool, heard: float) -> bool:
    """Whether there may be a path by edge f, which the image is to see, and edge e, which the other end sees;
    `first`: the image is the first end."""
    wedges, p, q = image.scene.wedges, image.end.at, other.end.at
    if first:
        inside, x = two_edge_path(wedges, f, e, p, q)
    else:
        inside, x = two_edge_path(wedges, e, f, q, p)
    return inside and not (heard > 0.0 and most_energy(wedges, x, image.scene.lowest) < heard)


@part
def _look(image: _Image, other: SeenEnd, lit: bool, first: bool, heard: float, rows: np.ndarray) -> None:
    """Find out of all edges that paths between an image and another end may need whether the image sees them."""
    mutual, wedges = image.scene.mutual, image.scene.wedges
    for k in range(other.visible.start[other.row], other.visible.start[other.row + 1]):
        e = other.visible.wedge[k]
        if _may_see(image, e) and _one_edge(image, other, k, lit, rows, heard) and _sees(image, e):
            for m in range(mutual.start[e], mutual.start[e + 1]):
                _sees(image, mutual.wedge[m])
    for n in range(other.onward.start[other.row], other.onward.start[other.row + 1]):
        m = other.onward.row[n]
        e, f = mutual.wedge[mutual.reverse[m]], mutual.wedge[m]
        if image.state[f] != _UNKNOWN or not _may_see(image, f):
            continue
        c = wedge_coordinates(wedges, f, image.end.at)
        if c.phi > math.pi * wedges.n[f] or not goes_on(mutual, mutual.reverse[m], c.phi):
            continue
        if _two_edges(image, other, e, f, first, heard):
            _sees(image, f)


@kernel
def _look_all(
    scene: EdgesOfScene,
    edge_planes: EdgePlanes,
    place: np.ndarray,
    planes: np.ndarray,
    other: Other,
    found: Found,
    rows: np.ndarray,
) -> None:
    """Fill `found` for the images of a listener at `place` (3,) in `planes` (m,); `rows` (E,): scratch."""
    q = place[0], place[1], place[2]
    for n in range(len(planes)):
        a = planes[n]
        side = signed_distance(scene.sight.planes, a, q)
        end = image_end(scene.sight, a, q)
        image = _Image(scene, edge_planes, a, end, side, found.state[n], found.coordinates[n])
        _look(image, seen_point(other.points, 0), other.lit[a], True, other.heard, rows)
        for u in range(other.images.start[0], other.images.start[1]):
            if other.images.plane[u] == a:
                end_of = seen_image(scene.sight, other.images, u)
                _look(image, end_of, False, other.swapped, other.heard, rows)
        for e in range(len(image.state)):
            if image.state[e] == _SEEN:
                found.met[n] = _meets(image, q, e)
                break


@part
def _meets(image: _Image, q: Vec3, e: int) -> bool:
    """Whether rays of the listener meet the plane, by which it sees edge e."""
    sight, wedges = image.scene.sight, image.scene.wedges
    target = edge_point(wedges, e, 0.5 * wedges.length[e])
    ok, x = reflection_point(sight.planes, image.plane, image.end.at, target)
    return rays_meet(sight.geometry, sight.surfaces, sight.boxes, q, image.plane, x if ok else target)


def images_for(
    scene: EdgesOfScene, edge_planes: EdgePlanes, at: np.ndarray, planes: np.ndarray, other: Other
) -> Images:
    """The images of a listener `at` (1, 3) m in `planes` (m,), with the edges that matter."""
    edges = len(scene.wedges.length)
    found = Found(
        np.zeros((len(planes), edges), np.int8),
        np.empty((len(planes), edges, 3)),
        np.zeros(len(planes), np.bool_),
    )
    _look_all(scene, edge_planes, at[0], planes, other, found, np.full(edges, -1))
    i, e = np.nonzero((found.state == _SEEN) & found.met[:, None])
    z, r, phi = np.ascontiguousarray(found.coordinates[i, e].T)
    start = np.searchsorted(i, np.arange(len(planes) + 1))
    visible = VisibleWedges(start, np.ascontiguousarray(e), z, r, phi)
    onward = find_onward(scene.mutual, visible, scene.strip)
    count = np.array([0, len(planes)])
    return Images(count, planes, np.zeros(len(planes), np.int64), at, visible, onward)
