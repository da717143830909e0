"""Points' images in specular planes, and the wedges that they see by way of these planes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.transport.diffraction.ends import End, View, image_end, sees
from soundspaces_sim.transport.diffraction.passed_edges import EdgesOfScene
from soundspaces_sim.transport.diffraction.seen_ends import Onward, SeenEnd, find_onward
from soundspaces_sim.transport.diffraction.visible_wedges import VisibleWedges, see_in_blocks
from soundspaces_sim.transport.diffraction.wedges import (
    WedgeCoordinates,
    Wedges,
    clear_point,
    edge_point,
    wedge_coordinates,
)
from soundspaces_sim.transport.image_source.images import signed_distance
from soundspaces_sim.transport.image_source.specular_planes import SpecularPlanes

_MIN_DISTANCE = 0.06  # m: an edge nearer to a plane is part of it
_SPACING = 0.4  # m, between the points of an edge that are tried
_OF_THREAD = 32  # images for which it is worth to start a thread
_BLOCK = 256  # images that are tried against all wedges at a time


class Images(NamedTuple):
    """Images of N points: rows start[i]:start[i + 1] are those of point i."""

    start: np.ndarray  # (N + 1,)
    plane: np.ndarray  # (m,)
    point: np.ndarray  # (m,) of which it is the image
    at: np.ndarray  # (N, 3) m, the points
    visible: VisibleWedges  # of images
    onward: Onward  # of images


@part(forceinline=True)
def seen_image(view: View, images: Images, u: int) -> SeenEnd:
    """Image u as an end."""
    end = image_end(view, images.plane[u], row(images.at, images.point[u]))
    return SeenEnd(end, u, images.visible, images.onward)


@part(forceinline=True)
def _near_plane(planes: SpecularPlanes, a: int, wedges: Wedges, e: int) -> bool:
    """Whether an edge is part of a plane."""
    start = signed_distance(planes, a, row(wedges.start, e))
    end = signed_distance(planes, a, edge_point(wedges, e, wedges.length[e]))
    return max(abs(start), abs(end)) < _MIN_DISTANCE + planes.margin[a]


@part(forceinline=True)
def tried_points(wedges: Wedges, e: int) -> int:
    """How many points of an edge are tried."""
    return max(int(math.ceil(wedges.length[e] / _SPACING)), 2)


@part
def image_sees_edge(
    view: View, wedges: Wedges, a: int, end: End, side: float, e: int
) -> tuple[bool, WedgeCoordinates]:
    """(Whether some point of edge e is seen from an image in plane a, of a point `side` m from it; coordinates of
    the image about e)."""
    near, far = row(wedges.start, e), edge_point(wedges, e, wedges.length[e])
    ends = signed_distance(view.planes, a, near), signed_distance(view.planes, a, far)
    if max(ends[0] * side, ends[1] * side) <= 0.0 or _near_plane(view.planes, a, wedges, e):
        return False, WedgeCoordinates(0.0, 0.0, 0.0)
    c = wedge_coordinates(wedges, e, end.at)
    if c.phi > math.pi * wedges.n[e] or c.r < view.geometry.epsilon:
        return False, c
    count = tried_points(wedges, e)
    for k in range(count):
        if sees(view, end, clear_point(wedges, e, (k + 0.5) / count * wedges.length[e])):
            return True, c
    return False, c


@kernel
def _try_images(
    first: int,
    last: int,
    view: View,
    wedges: Wedges,
    images: tuple[np.ndarray, np.ndarray],
    seen: np.ndarray,
    coordinates: np.ndarray,
) -> None:
    """Flags `seen` (n, E): some point of edge e is seen from image i, of a point (n, 3) in a plane (n,);
    `coordinates` (n, E, 3) of i about e."""
    points, plane = images
    for i in range(first, last):
        p, a = row(points, i), plane[i]
        end, side = image_end(view, a, p), signed_distance(view.planes, a, p)
        for e in range(len(wedges.length)):
            found, c = image_sees_edge(view, wedges, a, end, side, e)
            if found:
                seen[i, e] = True
                coordinates[i, e, 0], coordinates[i, e, 1], coordinates[i, e, 2] = c


def no_images(at: np.ndarray) -> Images:
    """Of points `at` (N, 3) m, none."""
    start, none, place = np.zeros(len(at) + 1, np.int64), np.empty(0, np.int64), np.empty(0)
    visible = VisibleWedges(np.zeros(1, np.int64), none, place, place, place)
    return Images(start, none, none, at, visible, Onward(np.zeros(1, np.int64), none))


def find_images(scene: EdgesOfScene, at: np.ndarray, met: np.ndarray) -> Images:
    """The images of points `at` (N, 3) m in the planes that they meet, `met` (N, P); sound goes on from them across
    faces."""
    view, wedges = scene.sight, scene.wedges
    # Columns of one array as `nonzero` has them, so of another layout for one image, another type for kernels.
    point, plane = map(np.ascontiguousarray, np.nonzero(met))
    start = np.searchsorted(point, np.arange(len(at) + 1))

    def look(block: slice, seen: np.ndarray, coordinates: np.ndarray) -> None:
        images = np.ascontiguousarray(at[point[block]]), plane[block]
        over_rows(
            _try_images, len(seen), view, wedges, images, seen, coordinates, chunk=1, least=_OF_THREAD
        )

    visible = see_in_blocks(len(plane), len(wedges.length), _BLOCK, look)
    return Images(start, plane, point, at, visible, find_onward(scene.mutual, visible, scene.strip))
