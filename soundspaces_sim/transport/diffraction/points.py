"""A scene's edges and a side's points with what they see of them, as the kernels of paths by edges read them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.transport.diffraction.ends import View, point_end
from soundspaces_sim.transport.diffraction.mirrored_edges import with_mirrored
from soundspaces_sim.transport.diffraction.mutual_visibility import strip_rows
from soundspaces_sim.transport.diffraction.passed_edges import EdgesOfScene
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.seen_ends import Onward, SeenEnd, find_onward
from soundspaces_sim.transport.diffraction.spectrum import make_spectrum
from soundspaces_sim.transport.diffraction.visible_wedges import VisibleWedges, visible_wedges
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.specular_planes import plane_areas, plane_boxes
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.tile import Side

_MIN_AREA = 4.0  # m², of a plane: about the first Fresnel zone of 4 m + 4 m at 500 Hz


class EdgePoints(NamedTuple):
    """N points of a side."""

    at: np.ndarray  # (N, 3) m
    keys: np.ndarray  # (N,) of `point_keys`: of a pair the smaller one's point comes first
    visible: VisibleWedges
    onward: Onward


@part(forceinline=True)
def seen_point(points: EdgePoints, i: int) -> SeenEnd:
    """Point i as an end."""
    return SeenEnd(point_end(row(points.at, i)), i, points.visible, points.onward)


def edge_points(side: Side) -> EdgePoints:
    """The points of a side: `side.once(edge_points)`."""
    visible = side.once(visible_wedges)
    mutual = side.model.prepared.part(prepare_wedges).mutual
    onward = find_onward(mutual, visible, np.ones(len(mutual.wedge), np.bool_))
    return EdgePoints(side.ends.points, side.ends.keys, visible, onward)


def large_planes(model: Model) -> np.ndarray:
    """(P,) the planes in which points have images: `model.once(large_planes)`."""
    planes, of_face = model.prepared.part(prepare_planes), model.world.geometry.plane
    return plane_areas(of_face, model.scene.corners, planes) >= _MIN_AREA


def edges_of_scene(model: Model) -> EdgesOfScene | None:
    """A scene's edges, None if it has none: `model.once(edges_of_scene)`."""
    wedges, mutual = model.prepared.part(prepare_wedges)
    if len(wedges.length) == 0:
        return None
    planes, geometry = model.prepared.part(prepare_planes), model.world.geometry
    boxes = plane_boxes(geometry.plane, model.scene.corners - model.scene.center, planes)
    view = View(geometry, model.world.surfaces, planes, boxes)
    lowest = float(make_spectrum(model.config.bands, model.config.c).shadow.k[0, 0])
    strip = strip_rows(wedges, mutual)
    wedges, mirrored = with_mirrored(geometry, wedges, planes, model.once(large_planes))
    return EdgesOfScene(view, wedges, mirrored, mutual, strip, lowest)
