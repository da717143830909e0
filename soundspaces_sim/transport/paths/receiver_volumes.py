"""Hits: walks pass detectors. The vertices that they leave on the way serve joins.

Hits alone make every path with a scattering event, since they need nothing of the other end; the other
techniques take over what they make with less noise.
"""

from __future__ import annotations

from soundspaces_sim.core.numerics.kernel import over_rows
from soundspaces_sim.transport.paths.subpath import make_walks, trace_walks
from soundspaces_sim.transport.state import Tables, Vertices
from soundspaces_sim.transport.tile import Side, Tile


def trace(tile: Tile, own: Side, other: Side, rows: slice, tables: Tables) -> None:
    """Walks of `rows` of `own`, deposited at the points of `other`."""
    world, ends, detectors = tile.model.world, own.ends, other.ends.detectors
    vertices = Vertices(*(v[rows] for v in own.vertices))
    vertices.count[:] = 0
    over_rows(
        trace_walks, len(ends.points[rows]), world, ends.points[rows], ends.keys[rows],
        ends.detectors.section[rows], detectors, vertices, tables, chunk=1,
        scratch=lambda: make_walks(world, detectors),
    )  # fmt: skip
