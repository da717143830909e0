"""Hits: walks pass detectors. What they leave on the way serves joins and merges.

Hits alone make every path with a scattering event, since they need nothing of the other end; the other
techniques take over what they make with less noise.
"""

from __future__ import annotations

import numpy as np

from soundspaces_sim.base.kernel import over_rows
from soundspaces_sim.transport.emit import first_harmonics
from soundspaces_sim.transport.state import Halves, SortedHalves, Tables, Vertices
from soundspaces_sim.transport.tables import CHANNELS
from soundspaces_sim.transport.techniques.merge import sort_halves
from soundspaces_sim.transport.tile import Side, Tile
from soundspaces_sim.transport.walk import make_walks, trace_walks

_EVENTS = 32  # halves of a walk that there is room for at first: events on patches in typical rooms


def trace(tile: Tile, own: Side, other: Side, rows: slice, early: np.ndarray, tables: Tables) -> None:
    """Walks of `rows` of `own`, deposited at the points of `other`."""
    world = tile.model.world
    points, keys = own.ends.points[rows], own.ends.keys[rows]
    section = own.ends.detectors.section[rows]
    vertices = Vertices(*(v[rows] for v in own.vertices))

    def walk(halves: Halves, into: Tables) -> None:
        vertices.count[:] = 0
        over_rows(
            trace_walks, len(points), world, points, keys, section, other.ends.detectors, early, vertices,
            halves, into, chunk=1, scratch=lambda: make_walks(world, other.ends.detectors),
        )  # fmt: skip

    bands = world.air.shape[1]
    if world.settings.merging and own.capacity == 0:
        own.capacity = world.settings.walks * _EVENTS
    halves = _empty_halves(len(points), own.capacity, bands)
    walk(halves, tables)
    most = int(halves.count.max())
    if most > own.capacity:  # once more, with room enough, and without a second deposit
        own.capacity = most + most // 8
        halves = _empty_halves(len(points), own.capacity, bands)
        walk(
            halves,
            Tables(tables.arrive[:, :, :0], tables.leave[:, :, :0], np.zeros_like(tables.batches)),
        )
    own.halves.append(_sort(tile, keys, halves))


def _empty_halves(points: int, capacity: int, bands: int) -> Halves:
    return Halves(
        np.empty((points, capacity), np.int32), np.empty((points, capacity), np.float32),
        np.empty((points, capacity), np.float32), np.empty((points, capacity), np.int32),
        np.empty((points, capacity, bands), np.float32), np.zeros(points, np.int64),
    )  # fmt: skip


def _sort(tile: Tile, keys: np.ndarray, halves: Halves) -> SortedHalves:
    """The halves of a few points by patch, without the unused room."""
    world = tile.model.world
    order, start = sort_halves(halves, len(world.patches.weight))
    chosen = [(i, order[i, :n]) for i, n in enumerate(halves.count)]

    def pick(column: np.ndarray) -> np.ndarray:
        return np.concatenate([column[i, rows] for i, rows in chosen])

    before = np.concatenate([[0], np.cumsum(halves.count)[:-1]])
    first = np.empty(
        (len(keys), world.settings.walks if world.settings.merging else 0, CHANNELS), np.float32
    )
    over_rows(first_harmonics, len(keys), keys, first)
    return SortedHalves(
        keys, start + before[:, None], first, pick(halves.length), pick(halves.previous),
        pick(halves.walk), pick(halves.beta),
    )  # fmt: skip
