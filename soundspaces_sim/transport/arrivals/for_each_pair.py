"""The loop over the pairs of a tile, and room in which its kernel stores what it finds.

How many paths a pair has is known once they are found. So a kernel counts all that it finds and stores what there
is room for (`store`); pairs that have not had enough are done once more with more room. A pair's paths depend on
the pair alone: blocks, slots and threads change nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.transport.model import air_transmission
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.tile import Tile

_BLOCK = 32  # pairs that one thread does, and packs, at a time
_SLOTS = 256  # paths of a pair that there is room for at first


class PathSlots(NamedTuple):
    """Room for some paths of each of n pairs, which kernels fill by `store`. Columns as in `PathTable`."""

    number: np.ndarray  # (n,) paths that were found; below 0: waves that there was no room for
    length: np.ndarray  # (n, slots) m
    at_b: np.ndarray  # (n, slots, 3)
    at_a: np.ndarray  # (n, slots, 3)
    energy: np.ndarray  # (n, slots, b), without air
    planes: np.ndarray  # (n, slots, 2)
    kind: np.ndarray  # (n, slots)
    wedges: np.ndarray  # (n, slots, 2)
    groups: np.ndarray  # (n, slots, 3)


def make_slots(pairs: int, slots: int, bands: int) -> PathSlots:
    """Empty room for `slots` paths of each pair."""
    shape = pairs, slots
    return PathSlots(
        number=np.zeros(pairs, np.int64),
        length=np.empty(shape),
        at_b=np.empty((*shape, 3)),
        at_a=np.empty((*shape, 3)),
        energy=np.empty((*shape, bands)),
        planes=np.empty((*shape, 2), np.int64),
        kind=np.empty(shape, np.int64),
        wedges=np.empty((*shape, 2), np.int64),
        groups=np.empty((*shape, 3), np.int64),
    )


class FoundPath(NamedTuple):
    """A path as kernels find it, its energy apart. Columns as in `PathTable`."""

    length: float
    at_b: Vec3
    at_a: Vec3
    planes: tuple[int, int]
    kind: int
    wedges: tuple[int, int]
    groups: tuple[int, int, int]


@part
def store(slots: PathSlots, pair: int, path: FoundPath, energy: np.ndarray) -> None:
    """Add a path and its energy (b,) to those of row `pair`; if there is no room, only count it."""
    s = slots.number[pair]
    slots.number[pair] = s + 1
    if s >= slots.length.shape[1]:
        return
    slots.length[pair, s], slots.kind[pair, s] = path.length, path.kind
    for axis in range(3):
        slots.at_b[pair, s, axis], slots.at_a[pair, s, axis] = path.at_b[axis], path.at_a[axis]
    for order in range(2):
        slots.planes[pair, s, order] = path.planes[order]
        slots.wedges[pair, s, order] = path.wedges[order]
    for order in range(3):
        slots.groups[pair, s, order] = path.groups[order]
    for b in range(len(energy)):
        slots.energy[pair, s, b] = energy[b]


def for_each_pair(
    tile: Tile, kernel: Any, context: Any, pairs: np.ndarray, scratch: Callable[[int], Any], room: int
) -> PathTable:
    """The paths that `kernel(first, last, context, pairs, slots, scratch)` finds for rows of `pairs`.

    `pairs` (n, 2): rows of sides a and b, of pairs i <= j alone if the tile has one side; the table then has
    both directions. `context`: what the kernel reads, and beside the slots what it fills, by assignment, as it
    may do a pair twice. `scratch` makes what a thread works in, with so much room for waves. Rows are in the
    order of pairs, then of finding.
    """
    columns, bands = len(tile.b.ends.points), tile.model.world.air.shape[1]
    parts: list[PathTable] = [PathTable.concatenate([], bands)] * -(-len(pairs) // _BLOCK)

    def call(first: int, last: int) -> None:
        slots, waves, rows = _SLOTS, room, np.arange(first, last)
        done, found_rows = [], []
        while len(rows):
            block = np.ascontiguousarray(pairs[rows])
            found = make_slots(len(block), slots, bands)
            kernel(0, len(block), context, block, found, scratch(waves))
            fits = (found.number >= 0) & (found.number <= slots)
            done.append(_packed(found, fits, block[:, 0] * columns + block[:, 1]))
            found_rows.append(np.repeat(rows[fits], found.number[fits]))
            rows, slots = rows[~fits], max(slots, int(found.number.max()))
            waves = max(waves, -int(found.number.min()))
        table = PathTable.concatenate(done, bands)
        if len(done) > 1:
            table = table.rows(np.argsort(np.concatenate(found_rows), kind="stable"))
        parts[first // _BLOCK] = table

    over_rows(call, len(pairs), chunk=_BLOCK)
    paths = PathTable.concatenate(parts, bands)
    air = air_transmission(tile.model.config, paths.length)
    paths = replace(paths, energy=paths.energy * air)
    return paths.both_directions(tile.distance) if tile.same else paths


def _packed(found: PathSlots, fits: np.ndarray, pair: np.ndarray) -> PathTable:
    """The slots that are filled of pairs (n,) of these numbers, of which all paths fit."""
    filled = (np.arange(found.length.shape[1]) < found.number[:, None]) & fits[:, None]
    return PathTable(
        pair=pair[np.nonzero(filled)[0]],
        length=found.length[filled],
        at_b=found.at_b[filled],
        at_a=found.at_a[filled],
        energy=found.energy[filled],
        planes=found.planes[filled],
        kind=found.kind[filled],
        wedges=found.wedges[filled],
        groups=found.groups[filled],
    )
