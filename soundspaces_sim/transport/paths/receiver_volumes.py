"""Receiver volumes: subpaths pass detectors. The vertices that they leave on the way serve connections.

This estimator alone makes every path with a scattering event, since it needs nothing of the other end; the others
take over what they make with less noise.
"""

from __future__ import annotations

import numpy as np

from soundspaces_sim.core.numerics.kernel import over_rows
from soundspaces_sim.transport.bsdf.scores import score_count
from soundspaces_sim.transport.bsdf.surface import group_count
from soundspaces_sim.transport.paths.subpath import count_tallies, make_work, trace_subpaths
from soundspaces_sim.transport.state import VERTEX, Tables, Vertices, emitters_of
from soundspaces_sim.transport.tables import CHANNELS
from soundspaces_sim.transport.tile import Side, Tile


def vertices(side: Side) -> Vertices:
    """Where the connected subpaths of a side's points leave their vertices: `side.once(vertices)`."""
    settings, bands = side.model.world.settings, side.model.world.air.shape[1]
    depth = settings.connection_depth if settings.connection_length > 0.0 else 1
    shape, surfaces = (len(side.ends.points), settings.connected), side.model.world.surfaces
    return Vertices(
        np.empty((*shape, depth), VERTEX),
        np.empty((*shape, depth, bands)),
        np.zeros(shape, np.int64),
        np.empty((*shape, CHANNELS)),
        np.empty((*shape, depth, group_count(surfaces)), np.uint16),
        np.empty((*shape, depth, score_count(surfaces), bands)),
    )


def trace(tile: Tile, own: Side, other: Side, rows: slice, tables: Tables) -> None:
    """Subpaths of `rows` of `own`, deposited at the points of `other`."""
    world, detectors = tile.model.world, other.ends.detectors
    emitters = emitters_of(own.ends, rows)
    left = Vertices(*(v[rows] for v in own.once(vertices)))
    left.count[:] = 0
    tallies: list[np.ndarray] = []
    over_rows(
        trace_subpaths,
        len(emitters.points),
        world,
        emitters,
        detectors,
        left,
        tables,
        chunk=1,
        scratch=lambda: make_work(world, detectors, tallies),
    )
    count_tallies(tallies)
