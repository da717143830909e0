"""What subpaths of a side leave for techniques that join both sides: room for vertices, and the whole of it."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.core.profile import stage
from soundspaces_sim.transport.bsdf.surface import group_count
from soundspaces_sim.transport.radiance_transfer.first_reflections import gather_reflections
from soundspaces_sim.transport.radiance_transfer.prepared import late_decay
from soundspaces_sim.transport.state import VERTEX, ReflectionBlock, Vertices
from soundspaces_sim.transport.tables import CHANNELS
from soundspaces_sim.transport.tile import Side, Walks


def make_vertices(side: Side) -> Vertices:
    """Room for those of all points of a side; none before they are traced."""
    settings, bands = side.model.world.settings, side.model.world.air.shape[1]
    depth = settings.connection_depth if settings.connection_length > 0.0 else 1
    shape, surfaces = (len(side.ends.points), settings.connected), side.model.world.surfaces
    return Vertices(
        np.empty((*shape, depth), VERTEX),
        np.empty((*shape, depth, bands)),
        np.zeros(shape, np.int64),
        np.empty((*shape, CHANNELS)),
        np.empty((*shape, depth, group_count(surfaces)), np.uint16),
    )


def make_walks(side: Side, vertices: Vertices, reflections: list[ReflectionBlock]) -> Walks:
    """Vertices, and first diffuse reflections of consecutive points in one piece; these are used up."""
    if not reflections:
        return Walks(side, vertices, None)
    decay = side.model.once(late_decay)
    with stage("first reflections"):
        return Walks(side, vertices, gather_reflections(reflections, decay.rate, decay.reach))
