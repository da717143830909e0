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
_FIRST_SLOTS, _SLOTS = (
    128,
    16,
)  # paths per pair that there is room for in the first block, and at least in others


def for_each_pair(
    tile: Tile, kernel: Any, context: Any, pairs: np.ndarray, scratch: Callable[[], Any]
) -> PathTable:
    """The paths that `kernel(first, last, context, pairs, slots, scratch)` finds for rows of `pairs`.

    `pairs` (n, 2): rows of sides a and b, of pairs i <= j alone if the tile has one side; the table then has
    both directions. `context`: what the kernel reads, and beside the slots what it fills, by assignment, as it
    may do a pair twice. `scratch` makes what a thread works in. Rows are in the order of pairs, then of
    finding.
    """
    columns, bands = len(tile.b.ends.points), tile.model.world.air.shape[1]
    slots, parts, done = _FIRST_SLOTS, [], [np.empty(0, np.int64)]
    for first, last in pairwise([0, *range(min(_FIRST, len(pairs)), len(pairs), _BLOCK), len(pairs)]):
        rows, needed = np.arange(first, last), 0
        while len(rows):
            block = np.ascontiguousarray(pairs[rows])
            found = make_slots(len(block), slots, bands)
            over_rows(kernel, len(block), context, block, found, scratch=scratch)
            fits = found.number <= slots
            parts.append(_packed(found, fits, block[:, 0] * columns + block[:, 1]))
            done.append(np.repeat(rows[fits], found.number[fits]))
            rows, needed = rows[~fits], max(needed, int(found.number.max()))
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
        wave=found.wave[filled],
    )
