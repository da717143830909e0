"""Ends with the wedges that they see, and how sound goes on from there."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.transport.diffraction.ends import End
from soundspaces_sim.transport.diffraction.mutual_visibility import MutualVisibility
from soundspaces_sim.transport.diffraction.visible_wedges import VisibleWedges

_ON_BOUNDARY = 0.02  # rad, within which rays decide what is in the light (`two_edge_sight`)


class Onward(NamedTuple):
    """How paths go on from wedges that N ends see: rows start[i]:start[i + 1] of end i are rows of
    `MutualVisibility`, ascending, from a wedge that it sees to one that is partly in the shadow of the first."""

    start: np.ndarray  # (N + 1,)
    row: np.ndarray  # (n,)


class SeenEnd(NamedTuple):
    """An end, row `row` of what ends see of the wedges and of how sound goes on."""

    end: End
    row: int
    visible: VisibleWedges
    onward: Onward


@part(forceinline=True)
def sees_edges(seen: SeenEnd) -> bool:
    """Whether an end sees any wedge."""
    return seen.visible.start[seen.row + 1] > seen.visible.start[seen.row]


@part(forceinline=True)
def set_rows(seen: SeenEnd, rows: np.ndarray) -> None:
    """Note, by wedge, the rows of what an end sees; other rows (E,) are -1."""
    for k in range(seen.visible.start[seen.row], seen.visible.start[seen.row + 1]):
        rows[seen.visible.wedge[k]] = k


@part(forceinline=True)
def clear_rows(seen: SeenEnd, rows: np.ndarray) -> None:
    """Undo `set_rows`."""
    for k in range(seen.visible.start[seen.row], seen.visible.start[seen.row + 1]):
        rows[seen.visible.wedge[k]] = -1


@part(forceinline=True)
def fewer_wedges(first: SeenEnd, second: SeenEnd) -> tuple[bool, np.ndarray, int, int]:
    """Of two ends that which sees fewer wedges: (whether it is the first, wedges, rows begin, end)."""
    own, end = first.visible.start[first.row], first.visible.start[first.row + 1]
    other, stop = second.visible.start[second.row], second.visible.start[second.row + 1]
    if end - own <= stop - other:
        return True, first.visible.wedge, own, end
    return False, second.visible.wedge, other, stop


@kernel
def _find_onward(
    first: int,
    last: int,
    mutual: MutualVisibility,
    visible: VisibleWedges,
    wanted: np.ndarray,
    count: np.ndarray,
    onward: Onward,
) -> None:
    """Counts (N,) rows of `Onward` among those of `MutualVisibility` that are `wanted` (n,); fills them unless
    there is no room for any."""
    for i in range(first, last):
        found = 0
        for seen in range(visible.start[i], visible.start[i + 1]):
            e = visible.wedge[seen]
            for other in range(mutual.start[e], mutual.start[e + 1]):
                if not wanted[other]:
                    continue
                low, high = mutual.phi[other, 0], mutual.phi[other, 1]
                if max(high - visible.phi[seen], visible.phi[seen] - low) > math.pi - _ON_BOUNDARY:
                    if len(onward.row) > 0:
                        onward.row[onward.start[i] + found] = other
                    found += 1
        count[i] = found


def find_onward(mutual: MutualVisibility, visible: VisibleWedges, wanted: np.ndarray) -> Onward:
    """How sound goes on from what ends see, by rows of `mutual` that are `wanted` (n,)."""
    points = len(visible.start) - 1
    count, start = np.zeros(points, np.int64), np.zeros(points + 1, np.int64)

    def find(row: np.ndarray) -> Onward:
        onward = Onward(start, row)
        over_rows(_find_onward, points, mutual, visible, wanted, count, onward)
        return onward

    if len(visible.wedge) == 0:
        return Onward(start, np.empty(0, np.int64))
    find(np.empty(0, np.int64))  # how many
    np.cumsum(count, out=start[1:])
    return find(np.empty(start[-1], np.int64))


@part
def mark(mutual: MutualVisibility, seen: SeenEnd, continues: np.ndarray, value: bool) -> None:
    """Flag rows of `MutualVisibility` by which sound from an end comes to other wedges, reversed."""
    onward = seen.onward
    for n in range(onward.start[seen.row], onward.start[seen.row + 1]):
        continues[mutual.reverse[onward.row[n]]] = value
