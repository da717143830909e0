"""Specular reflections and edges on one path: paths by edges from image sources.

An end of a path by one edge or two may be the image of a point in a large specular plane that rays from the point
meet: of one end, or of both in the same plane, as when sound goes from the floor over a cupboard and back to the
floor. What `single` and `double` do for two points (`by_edges`) is done for such ends, with what the planes
reflect. A reflection of the pair takes the interference factor of the edges that it passes closely, as the direct
sound does. The edges of the plane itself are `finite_reflectors`' matter.

Restricted to what is audible: the two edges are of one face, as those of a wall's top or of a pillar; paths fade
where they are 30 dB below all that a pair has of its own in the lowest band; and planes fill a Fresnel zone.
"""

from __future__ import annotations

import numpy as np

from soundspaces_sim.transport.diffraction.edge_kernel import (
    OF_IMAGES,
    EdgeContext,
    EdgeSide,
    find_paths,
)
from soundspaces_sim.transport.diffraction.image_wedges import find_images
from soundspaces_sim.transport.diffraction.passed_edges import EdgesOfScene
from soundspaces_sim.transport.diffraction.points import EdgePoints, edge_points, edges_of_scene
from soundspaces_sim.transport.diffraction.seen_ends import find_onward
from soundspaces_sim.transport.diffraction.spectrum import make_spectrum
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.reflections import (
    first_order_reflections,
    scale_reflections,
)
from soundspaces_sim.transport.image_source.sequences import plane_sequences
from soundspaces_sim.transport.image_source.specular_planes import plane_areas
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.path_table import WAVE_POINTS, PathTable
from soundspaces_sim.transport.tile import Side, Tile

_MIN_AREA = 4.0  # m², of a plane: about the first Fresnel zone of 4 m + 4 m at 500 Hz
_HEARD = 1e-3  # of a pair's energy in the lowest band


def large_planes(model: Model) -> np.ndarray:
    """(P,) the planes in which points have images: `model.once(large_planes)`."""
    planes, of_face = model.prepared.part(prepare_planes), model.world.geometry.plane
    return plane_areas(of_face, model.scene.corners, planes) >= _MIN_AREA


def points_of(side: Side, scene: EdgesOfScene) -> EdgePoints:
    """The points of a side, whose sound goes on across faces."""
    points = side.once(edge_points)
    return points._replace(onward=find_onward(scene.mutual, points.visible, scene.strip))


def edge_side(side: Side) -> EdgeSide:
    """A side: `side.once(edge_side)`."""
    scene = side.model.once(edges_of_scene)
    assert scene is not None  # `connect` has asked
    points = points_of(side, scene)
    met = side.once(plane_sequences).seen[:, :, -1] & side.model.once(large_planes)
    return EdgeSide(points, find_images(scene, points.at, met))


def heard_beside(tile: Tile) -> np.ndarray:
    """(A, B) J/m²: `_HEARD` of a pair's direct sound and discrete paths, summed by size: both ways to the bit."""
    tables = tile.discrete.values()
    pair = np.concatenate([np.arange(tile.walls.size), *(paths.pair for paths in tables)])
    energy = np.concatenate([tile.direct[:, :, 0].ravel(), *(paths.energy[:, 0] for paths in tables)])
    order = np.lexsort((energy, pair))
    total = np.bincount(pair[order], energy[order], tile.walls.size)
    return np.asarray(_HEARD * total.reshape(tile.walls.shape))


def connect(tile: Tile) -> PathTable | None:
    """Paths by planes and edges of every pair, and what edges take from its reflections."""
    model, scene = tile.model, tile.model.once(edges_of_scene)
    if scene is None or len(scene.sight.planes.offset) == 0:
        return None
    reflections = first_order_reflections(tile)
    shape = len(reflections.row), len(model.config.bands) - 1
    context = EdgeContext(
        scene=scene,
        spectrum=make_spectrum(model.config.bands, model.config.c),
        a=tile.a.once(edge_side),
        b=tile.b.once(edge_side),
        paths=OF_IMAGES,
        walls=tile.walls,
        heard=heard_beside(tile),
        reflections=reflections,
        factor=np.ones(shape),
        wave=np.ones((*shape, WAVE_POINTS), np.complex128),
    )
    paths = find_paths(tile, context)
    scale_reflections(tile, reflections, context.factor, context.wave)
    return paths
