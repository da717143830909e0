"""What subpaths of a side leave for techniques that join both sides: room for it, and the whole of it."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.core.profile import stage
from soundspaces_sim.transport.bsdf.scores import score_count
from soundspaces_sim.transport.bsdf.surface import group_count
from soundspaces_sim.transport.radiance_transfer.first_reflections import gather_reflections
from soundspaces_sim.transport.radiance_transfer.prepared import late_decay
from soundspaces_sim.transport.state import VERTEX, Vertices
from soundspaces_sim.transport.tables import CHANNELS
from soundspaces_sim.transport.tile import Left, Side, Walks


def make_left(side: Side) -> Left:
    """Room for what subpaths of a side's points will leave."""
    settings, bands = side.model.world.settings, side.model.world.air.shape[1]
    depth = settings.connection_depth if settings.connection_length > 0.0 else 1
    shape, surfaces = (len(side.ends.points), settings.connected), side.model.world.surfaces
    return Left(
        Vertices(
            np.empty((*shape, depth), VERTEX),
            np.empty((*shape, depth, bands)),
            np.zeros(shape, np.int64),
            np.empty((*shape, CHANNELS)),
            np.empty((*shape, depth, group_count(surfaces)), np.uint16),
            np.empty((*shape, depth, score_count(surfaces), bands)),
        )
    )


def make_walks(side: Side, left: Left) -> Walks:
    """What was left, in one piece. Uses it up."""
    if not left.reflections:
        return Walks(side, left.vertices, None)
    left.room, decay = None, side.model.once(late_decay)
    with stage("first reflections"):
        reflections = gather_reflections(left.reflections, decay.rate, decay.reach)
    return Walks(side, left.vertices, reflections)
