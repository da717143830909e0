"""Points' images in specular planes, and the wedges that they see by way of these planes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.transport.diffraction.ends import End, View, image_end, sees
from soundspaces_sim.transport.diffraction.mirrored_edges import MIN_DISTANCE, real_wedges
from soundspaces_sim.transport.diffraction.passed_edges import EdgesOfScene
from soundspaces_sim.transport.diffraction.points import (
    EdgePoints,
    edge_points,
    edges_of_scene,
    large_planes,
)
from soundspaces_sim.transport.diffraction.seen_ends import Onward, SeenEnd, find_onward
from soundspaces_sim.transport.diffraction.visible_wedges import VisibleWedges, see_in_blocks
from soundspaces_sim.transport.diffraction.wedges import (
    Wedges,
    clear_point,
    edge_point,
    wedge_coordinates,
)
from soundspaces_sim.transport.image_source.images import reflection_point, signed_distance
from soundspaces_sim.transport.image_source.sequences import plane_sequences
from soundspaces_sim.transport.tile import Side

_ROUNDING = 1e-9  # m
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


class ImageSide(NamedTuple):
    """The points of a side and their images; sound goes on from both across faces."""

    points: EdgePoints
    images: Images


@part(forceinline=True)
def seen_image(view: View, images: Images, u: int) -> SeenEnd:
    """Image u as an end."""
    end = image_end(view, images.plane[u], row(images.at, images.point[u]))
    return SeenEnd(end, u, images.visible, images.onward)


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
    if max(abs(ends[0]), abs(ends[1])) < MIN_DISTANCE + planes.margin[a]:
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
        end = image_end(view, plane[i], row(points, i))
        for e in range(len(wedges.length)):
            if _not_by_plane(view, end, wedges, e):
                continue
            c = wedge_coordinates(wedges, e, end.at)
            if c.phi > math.pi * wedges.n[e] or c.r < view.geometry.epsilon:
                continue
            coordinates[i, e, 0], coordinates[i, e, 1], coordinates[i, e, 2] = c
            count = max(int(math.ceil(wedges.length[e] / _SPACING)), 2)
            for k in range(count):
                if sees(view, end, clear_point(wedges, e, (k + 0.5) / count * wedges.length[e])):
                    seen[i, e] = True
                    break


def no_images(at: np.ndarray) -> Images:
    """Of points `at` (N, 3) m, none."""
    start, none, place = np.zeros(len(at) + 1, np.int64), np.empty(0, np.int64), np.empty(0)
    visible = VisibleWedges(np.zeros(1, np.int64), none, place, place, place)
    return Images(start, none, none, at, visible, Onward(np.zeros(1, np.int64), none))


def find_images(scene: EdgesOfScene, at: np.ndarray, met: np.ndarray) -> Images:
    """The images of points `at` (N, 3) m in the planes that they meet, `met` (N, P); sound goes on from them across
    faces."""
    view, wedges = scene.sight, real_wedges(scene.wedges, scene.mirrored)
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


def image_side(side: Side) -> ImageSide:
    """The points and images of a side: `side.once(image_side)`."""
    scene, points = side.model.once(edges_of_scene), side.once(edge_points)
    assert scene is not None  # `connect` has asked
    points = points._replace(onward=find_onward(scene.mutual, points.visible, scene.strip))
    met = side.once(plane_sequences).seen[:, :, -1] & side.model.once(large_planes)
    return ImageSide(points, find_images(scene, points.at, met))
