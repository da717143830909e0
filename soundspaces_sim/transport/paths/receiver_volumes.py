"""Receiver volumes: subpaths pass detectors. The vertices that they leave on the way serve connections.

This estimator alone makes every path with a scattering event, since it needs nothing of the other end; the others
take over what they make with less noise.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from soundspaces_sim.core.numerics.kernel import over_rows
from soundspaces_sim.transport.paths.subpath import count_tallies, make_work, trace_subpaths
from soundspaces_sim.transport.state import Tables, Vertices, emitters_of
from soundspaces_sim.transport.technique import TraceRows
from soundspaces_sim.transport.tile import Side


def trace(own: Side, other: Side) -> TraceRows:
    """Subpaths of `own`, deposited at the points of `other`; they leave vertices."""
    return partial(_trace_rows, own, other)


def _trace_rows(own: Side, other: Side, rows: slice, tables: Tables, vertices: Vertices) -> None:
    world, detectors = own.model.world, other.ends.detectors
    emitters = emitters_of(own.ends, rows)
    vertices.count[:] = 0
    tallies: list[np.ndarray] = []
    over_rows(
        trace_subpaths,
        len(emitters.points),
        world,
        emitters,
        detectors,
        vertices,
        tables,
        chunk=1,
        scratch=lambda: make_work(world, detectors, tallies),
    )
    count_tallies(tallies)
