"""All that arrives discretely, as a technique."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.transport.arrivals.connect import Context, Edges, Scratch, find_arrivals
from soundspaces_sim.transport.arrivals.field import make_spectrum
from soundspaces_sim.transport.arrivals.waves import make_waves
from soundspaces_sim.transport.diffraction.double_wedge import make_double_wedge_scratch
from soundspaces_sim.transport.diffraction.edge_kernel import _without_images
from soundspaces_sim.transport.diffraction.ends import View
from soundspaces_sim.transport.diffraction.image_wedges import image_side
from soundspaces_sim.transport.diffraction.mutual_visibility import strip_rows
from soundspaces_sim.transport.diffraction.plane_edges import find_plane_edges
from soundspaces_sim.transport.diffraction.points import edges_of_scene
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.for_each_pair import for_each_pair
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.sequences import plane_sequences
from soundspaces_sim.transport.image_source.specular_planes import plane_boxes
from soundspaces_sim.transport.model import Model, air_transmission
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.paths.direct import direct_sound
from soundspaces_sim.transport.technique import Technique
from soundspaces_sim.transport.tile import Tile

_ROOM = 16384


def _edges(model: Model) -> Edges:
    """`model.once(_edges)`."""
    wedges, mutual = model.prepared.part(prepare_wedges)
    geometry = model.world.geometry
    strips = strip_rows(wedges, mutual)
    found = find_plane_edges(geometry, model.scene.corners - model.scene.center, wedges, mutual, strips)
    triangle = found.triangle
    sector = np.pi * wedges.n[:, None]
    second = np.sin(sector) * wedges.face - np.cos(sector) * wedges.normal
    normals = np.stack([wedges.normal, second], axis=1)
    behind = (geometry.normal[triangle] * normals).sum(axis=2) < 0.0
    material = geometry.material[triangle, behind.astype(int)]
    return Edges(wedges, found.plane, material, mutual, strips)


def _view(model: Model) -> View:
    planes, geometry = model.prepared.part(prepare_planes), model.world.geometry
    boxes = plane_boxes(geometry.plane, model.scene.corners - model.scene.center, planes)
    return View(geometry, model.world.surfaces, planes, boxes)


def connect(tile: Tile) -> PathTable | None:
    """Direct sound, reflections and diffracted sound of every pair."""
    model = tile.model
    direct_sound(tile)
    has = model.once(edges_of_scene) is not None
    edges = model.once(_edges)
    spectrum = make_spectrum(model.config.bands, model.config.c)
    sides = [side.once(image_side if has else _without_images) for side in (tile.a, tile.b)]
    context = Context(
        model.once(_view), edges, spectrum, sides[0], sides[1],
        tile.a.once(plane_sequences), tile.b.once(plane_sequences), tile.walls, tile.direct, np.empty_like(tile.direct),
    )  # fmt: skip
    shape = spectrum.k.shape

    def scratch() -> Scratch:
        count = len(edges.wedges.length)
        return Scratch(
            make_waves(_ROOM, spectrum), np.empty(shape, np.complex128), np.empty(shape[0]), np.empty(shape[0]),
            np.empty((2, shape[0])), np.full(count, -1), np.full(count, -1),
            np.zeros(len(edges.mutual.wedge), np.bool_), make_double_wedge_scratch(),
        )  # fmt: skip

    paths = for_each_pair(tile, find_arrivals, context, tile.pairs, scratch)
    tile.direct[:] = context.joined
    if tile.same:
        upper = np.tri(len(tile.a.ends.points), dtype=bool).T[:, :, None]
        tile.direct[:] = np.where(upper, tile.direct, tile.direct.transpose(1, 0, 2))
    tile.direct *= air_transmission(model.config, tile.distance)
    return paths


ARRIVALS = Technique("arrivals", "direct sound, image sources, edges", prepare=prepare_wedges, connect=connect)
