"""The sequences of planes by which a place may hear a source: those of the source's that images allow.

A tile solves every sequence that 8,192 rays of either end meet (`sequences`). For one listener after another that
is dear. Here the source has so many more rays that those of listeners are not needed, its images are kept, and of a
listener those are left whose reflection points lie within the bounds of their planes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, row, subtract
from soundspaces_sim.transport.image_source.images import image_of, signed_distance
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.sequences import (
    Sequences,
    plane_sequences,
    sequences_by,
)
from soundspaces_sim.transport.image_source.specular_planes import SpecularPlanes, plane_boxes
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.tile import Side

_IN_PLANE = 1e-6  # m, of a place in a plane
_RAYS = 65536  # of a source: planes of which it sees 2e-4 sr or more
_EXACT = 1e-4  # m, margin of a plane up to which reflection points are within its bounds


class SourceImages(NamedTuple):
    """The sequences of planes that a source's rays meet, with its images."""

    planes: np.ndarray  # (n, 2) plane, and the second one or -1
    first: np.ndarray  # (n, 3) m, in the first plane
    last: np.ndarray  # (n, 3) m, in both


def source_images(side: Side) -> SourceImages:
    """Images of a side's one point: `side.once(source_images)`."""
    planes = side.model.prepared.part(prepare_planes)
    # Those of a tile's rays as well: some graze what none of many others meet.
    seen = sequences_by(side, _RAYS).seen[0] | side.once(plane_sequences).seen[0]
    rows = np.argwhere(seen)
    rows[rows[:, 1] == seen.shape[0], 1] = -1
    images = SourceImages(rows, np.empty((len(rows), 3)), np.empty((len(rows), 3)))
    _fill_images(planes, side.ends.points[0], images)
    return images


@kernel
def _fill_images(planes: SpecularPlanes, point: np.ndarray, images: SourceImages) -> None:
    for n in range(len(images.planes)):
        first = image_of(planes, images.planes[n, 0], (point[0], point[1], point[2]))
        last = first
        if images.planes[n, 1] >= 0:
            last = image_of(planes, images.planes[n, 1], first)
        for c in range(3):
            images.first[n, c], images.last[n, c] = first[c], last[c]


def _bounds(model: Model) -> np.ndarray:
    """(P, 2, 3) m, bounds of each plane's triangles; endless for one that its triangles stray from:
    `model.once(_bounds)`."""
    planes = model.prepared.part(prepare_planes)
    boxes = plane_boxes(model.world.geometry.plane, model.scene.corners - model.scene.center, planes)
    stray = planes.margin > _EXACT
    boxes[stray, 0], boxes[stray, 1] = -np.inf, np.inf
    return boxes


@part(forceinline=True)
def _inside(boxes: np.ndarray, a: int, x: Vec3) -> bool:
    for c in range(3):
        if not boxes[a, 0, c] <= x[c] <= boxes[a, 1, c]:
            return False
    return True


@part(forceinline=True)
def _crossing(planes: SpecularPlanes, a: int, image: Vec3, q: Vec3) -> tuple[bool, Vec3]:
    """`reflection_point`, but a place in a plane is on either side: a path by a corner has two orders, and rounding
    tells which is one."""
    s_image, s_q = -signed_distance(planes, a, image), signed_distance(planes, a, q)
    if s_image * s_q < 0.0 and min(abs(s_image), abs(s_q)) > _IN_PLANE:
        return False, q
    total = s_image + s_q
    t = s_image / total if abs(total) > _IN_PLANE else 1.0
    return True, along(image, t, subtract(q, image))


@kernel
def _may_reach(
    planes: SpecularPlanes, boxes: np.ndarray, images: SourceImages, place: np.ndarray, out: np.ndarray
) -> None:
    """Flags `out` (n,): the sequences by which images allow a path to a place (3,)."""
    q = place[0], place[1], place[2]
    for n in range(len(images.planes)):
        a, b = images.planes[n, 0], images.planes[n, 1]
        last = a if b < 0 else b
        ok, x = _crossing(planes, last, row(images.last, n), q)
        ok = ok and _inside(boxes, last, x)
        if ok and b >= 0:
            ok, x = _crossing(planes, a, row(images.first, n), x)
            ok = ok and _inside(boxes, a, x)
        out[n] = ok


def reflections_between(source: Side, listener: Side) -> Sequences:
    """The sequences that a pair of places may have, as those of the listener."""
    model, images = source.model, source.once(source_images)
    planes, found = model.prepared.part(prepare_planes), np.empty(len(images.planes), np.bool_)
    _may_reach(planes, model.once(_bounds), images, listener.ends.points[0], found)
    rows = images.planes[found]
    rows = np.where(rows[:, 1:] >= 0, rows[:, ::-1], rows)  # in order from the listener
    return Sequences(source.once(no_sequences).seen, np.array([0, len(rows)]), rows)


def no_sequences(side: Side) -> Sequences:
    """None, for a side of one point: `side.once(no_sequences)`."""
    count = len(side.model.prepared.part(prepare_planes).offset)
    seen = np.zeros((1, count, count + 1), np.bool_)
    return Sequences(seen, np.zeros(2, np.int64), np.empty((0, 2), np.int64))
