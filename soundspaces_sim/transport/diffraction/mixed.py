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
    find_paths,
)
from soundspaces_sim.transport.diffraction.image_wedges import image_side
from soundspaces_sim.transport.diffraction.pair_energies import pair_energies
from soundspaces_sim.transport.diffraction.points import edges_of_scene
from soundspaces_sim.transport.diffraction.spectrum import make_spectrum
from soundspaces_sim.transport.image_source.reflections import (
    first_order_reflections,
    scale_reflections,
)
from soundspaces_sim.transport.path_table import WAVE_POINTS, PathTable
from soundspaces_sim.transport.tile import Tile

_HEARD = 1e-3  # of a pair's energy in the lowest band


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
        a=tile.a.once(image_side),
        b=tile.b.once(image_side),
        paths=OF_IMAGES,
        walls=tile.walls,
        heard=np.ascontiguousarray(_HEARD * pair_energies(tile, 1)[:, :, 0]),
        reflections=reflections,
        factor=np.ones(shape),
        wave=np.ones((*shape, WAVE_POINTS), np.complex128),
        passed=np.empty(shape[0]),
    )
    paths = find_paths(tile, context)
    scale_reflections(tile, reflections, context.factor, context.wave)
    return paths
