"""The loop over the pairs of a tile, and room in which its kernel stores what it finds.

How many paths a pair has is known once they are found. So a kernel counts all that it finds and stores what there
is room for (`store`); pairs that have not had enough are done once more with more room. The first block is
small, as it tells how much others need. A pair's paths depend on the pair alone: blocks, slots and threads
change nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.transport.model import air_transmission
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.tile import Tile

_FIRST, _BLOCK = 32, 1024  # pairs at a time, which bounds the memory
_FIRST_SLOTS, _SLOTS = (
    128,
    16,
)  # paths of a pair that there is room for in the first block, and at least in others


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
    slots, parts, done = _FIRST_SLOTS, [], [np.empty(0, np.int64)]
    for first, last in pairwise([0, *range(min(_FIRST, len(pairs)), len(pairs), _BLOCK), len(pairs)]):
        rows, needed = np.arange(first, last), 0
        while len(rows):
            block = np.ascontiguousarray(pairs[rows])
            found = make_slots(len(block), slots, bands)
            over_rows(kernel, len(block), context, block, found, scratch=partial(scratch, room))
            fits = (found.number >= 0) & (found.number <= slots)
            parts.append(_packed(found, fits, block[:, 0] * columns + block[:, 1]))
            done.append(np.repeat(rows[fits], found.number[fits]))
            rows, needed = rows[~fits], max(needed, int(found.number.max()))
            room = max(room, -int(found.number.min()))
            if needed > slots:
                slots = needed + needed // 2  # some more, for other pairs
        if first == 0:
            slots = max(_SLOTS, needed + needed // 2)
    paths = PathTable.concatenate(parts, bands).rows(np.argsort(np.concatenate(done), kind="stable"))
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
