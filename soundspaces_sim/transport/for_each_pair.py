"""The loop over the pairs of a tile that makes discrete paths, for all techniques that make some.

How many paths a pair has is known once they are found. So a kernel counts all that it finds and stores what there
is room for (`path_table.store`); pairs that have not had enough are done once more with more room. The first block
is small, as it tells how much others need. A pair's paths depend on the pair alone: blocks, slots and threads
change nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from soundspaces_sim.core.numerics.kernel import over_rows
from soundspaces_sim.transport.model import air_transmission
from soundspaces_sim.transport.path_table import PathSlots, PathTable, make_slots
from soundspaces_sim.transport.tile import Tile

_FIRST, _BLOCK = 32, 1024  # pairs at a time, which bounds the memory
_SLOTS = 16  # paths per pair that there is room for at first
_SLOTS_OF_ONE = 64  # the same, of a tile of one pair


def for_each_pair(
    tile: Tile, kernel: Any, context: Any, pairs: np.ndarray, scratch: Callable[[], Any]
) -> PathTable:
    """The paths that `kernel(first, last, context, pairs, slots, scratch)` finds for rows of `pairs`.

    `pairs` (n, 2): rows of sides a and b, of pairs i <= j alone if the tile has one side; the table then has
    both directions. `context`: what the kernel reads, and beside the slots what it fills, by assignment, as it
    may do a pair twice. `scratch` makes what a thread works in. Rows are in the order of pairs, then of
    finding.
    """
    if tile.walls.size == 1 and not tile.same:
        return _for_one_pair(tile, kernel, context, pairs, scratch)
    columns, bands = len(tile.b.ends.points), tile.model.world.air.shape[1]
    slots, parts, done = _SLOTS, [], [np.empty(0, np.int64)]
    for first, last in pairwise([0, *range(min(_FIRST, len(pairs)), len(pairs), _BLOCK), len(pairs)]):
        rows = np.arange(first, last)
        while len(rows):
            block = np.ascontiguousarray(pairs[rows])
            found = make_slots(len(block), slots, bands)
            over_rows(kernel, len(block), context, block, found, scratch=scratch)
            fits = found.number <= slots
            parts.append(_packed(found, fits, block[:, 0] * columns + block[:, 1]))
            done.append(np.repeat(rows[fits], found.number[fits]))
            rows, most = rows[~fits], int(found.number.max())
            if most > slots:
                slots = most + most // 2  # some more, for other pairs
    paths = PathTable.concatenate(parts, bands).rows(np.argsort(np.concatenate(done), kind="stable"))
    air = air_transmission(tile.model.config, paths.length)
    paths = replace(paths, energy=paths.energy * air)
    return paths.both_directions(columns) if tile.same else paths


def _for_one_pair(
    tile: Tile, kernel: Any, context: Any, pairs: np.ndarray, scratch: Callable[[], Any]
) -> PathTable:
    """`for_each_pair` for a tile of one pair, which keeps what its kernels work in."""
    bands = tile.model.world.air.shape[1]
    if "none" not in tile.scratch:
        tile.scratch["none"] = PathTable.concatenate([], bands)
    none: PathTable = tile.scratch["none"]
    if len(pairs) == 0:
        return none
    if kernel not in tile.scratch:
        tile.scratch[kernel] = make_slots(1, _SLOTS_OF_ONE, bands), scratch()
    slots, own = tile.scratch[kernel]
    slots.number[0] = 0
    kernel(0, 1, context, pairs, slots, own)
    number = int(slots.number[0])
    if number > slots.length.shape[1]:
        tile.scratch[kernel] = make_slots(1, number, bands), own
        return _for_one_pair(tile, kernel, context, pairs, scratch)
    if number == 0:
        return none
    length, at_b, at_a, energy, *others = (column[0, :number].copy() for column in slots[1:])
    energy *= air_transmission(tile.model.config, length)
    return PathTable(np.zeros(number, np.int64), length, at_b, at_a, energy, *others)


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
        wave=found.wave[filled],
    )
