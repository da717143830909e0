"""Where points' images in specular planes are about the wedges that the points see."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.transport.diffraction.visible_wedges import VisibleWedges
from soundspaces_sim.transport.diffraction.wedges import (
    WedgeCoordinates,
    Wedges,
    edge_point,
    wedge_coordinates,
)
from soundspaces_sim.transport.image_source.images import image_of, signed_distance
from soundspaces_sim.transport.image_source.specular_planes import SpecularPlanes

_MIN_DISTANCE = 0.06  # m: an edge nearer to a plane is part of it


class Images(NamedTuple):
    """Coordinates of N points' images about the wedges that the points see: rows start[k]:start[k + 1] are those of
    row k of their `VisibleWedges`."""

    start: np.ndarray  # (n + 1,)
    plane: np.ndarray  # (m,)
    z: np.ndarray  # (m,) m
    r: np.ndarray  # (m,) m
    phi: np.ndarray  # (m,) rad


@part(forceinline=True)
def _near_plane(planes: SpecularPlanes, a: int, wedges: Wedges, e: int) -> bool:
    """Whether an edge is part of a plane."""
    start = signed_distance(planes, a, row(wedges.start, e))
    end = signed_distance(planes, a, edge_point(wedges, e, wedges.length[e]))
    return max(abs(start), abs(end)) < _MIN_DISTANCE + planes.margin[a]


class Search(NamedTuple):
    """The points of which images are looked up."""

    geometry: Geometry
    planes: SpecularPlanes
    wedges: Wedges
    at: np.ndarray  # (N, 3) m
    met: np.ndarray  # (N, P) whether rays from a point meet a plane that is large enough
    visible: VisibleWedges


@kernel
def _find_images(first: int, last: int, search: Search, count: np.ndarray, images: Images) -> None:
    """Counts (n,) images for each row of `VisibleWedges`; fills `images` unless there is no room for any."""
    planes, wedges, visible = search.planes, search.wedges, search.visible
    for i in range(first, last):
        p = row(search.at, i)
        for k in range(visible.start[i], visible.start[i + 1]):
            e, found = visible.wedge[k], 0
            for a in range(search.met.shape[1]):
                if not search.met[i, a] or _near_plane(planes, a, wedges, e):
                    continue
                c = wedge_coordinates(wedges, e, image_of(planes, a, p))
                if c.phi > math.pi * wedges.n[e] or c.r < search.geometry.epsilon:
                    continue
                if len(images.plane) > 0:
                    at = images.start[k] + found
                    images.plane[at] = a
                    images.z[at], images.r[at], images.phi[at] = c
                found += 1
            count[k] = found


@part(forceinline=True)
def image_coordinates(images: Images, k: int) -> WedgeCoordinates:
    return WedgeCoordinates(images.z[k], images.r[k], images.phi[k])


def find_images(search: Search) -> Images:
    """The images of all points of a search."""
    rows = len(search.visible.wedge)
    count, start = np.zeros(rows, np.int64), np.zeros(rows + 1, np.int64)

    def find(room: int) -> Images:
        z, r, phi = np.empty((3, room))
        images = Images(start, np.empty(room, np.int64), z, r, phi)
        over_rows(_find_images, len(search.at), search, count, images)
        return images

    find(0)  # how many
    np.cumsum(count, out=start[1:])
    return find(int(start[-1]))
