"""The loop over the pairs of a tile that makes discrete paths, for all techniques that make some.

How many paths a pair has is known once they are found. So a kernel counts all that it finds and stores what there
is room for (`path_table.store`); where there was not enough, the block of pairs is done once more with more room.
A pair's paths depend on the pair alone: blocks, slots and threads change nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from soundspaces_sim.core.numerics.kernel import over_rows
from soundspaces_sim.transport.model import air_transmission
from soundspaces_sim.transport.path_table import PathSlots, PathTable, make_slots
from soundspaces_sim.transport.tile import Tile

_BLOCK = 1024  # pairs at a time, which bounds the memory
_SLOTS = 16  # paths per pair that there is room for at first


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
    slots, parts = _SLOTS, []
    for first in range(0, len(pairs), _BLOCK):
        block = np.ascontiguousarray(pairs[first : first + _BLOCK])
        while True:
            found = make_slots(len(block), slots, bands)
            over_rows(kernel, len(block), context, block, found, scratch=scratch)
            most = int(found.number.max())
            if most <= slots:
                break
            slots = most + most // 2  # some more, for the next block
        parts.append(_packed(found, block[:, 0] * columns + block[:, 1]))
    paths = PathTable.concatenate(parts, bands)
    air = air_transmission(tile.model.config, paths.length)
    paths = replace(paths, energy=paths.energy * air)
    return paths.both_directions(columns) if tile.same else paths


def _packed(found: PathSlots, pair: np.ndarray) -> PathTable:
    """The slots that are filled, of pairs of these numbers (n,)."""
    filled = np.arange(found.length.shape[1]) < found.number[:, None]
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
