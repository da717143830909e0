"""Tiles that one process simulates as one: what radiance transfer makes of a point is then made once for them all.

What subpaths leave is kept from tile to tile (`transport.kept_traces`). Patch histograms and their transforms are
not: those of a point take some 100 MB. So tiles that have blocks in common are put together, as many as memory
allows, simulated as one and cut apart. A pair's result depends on its two points alone, so the bytes are those of
tiles that are made one by one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from soundspaces_sim.build.plan import JobPlan, PointBlocks, Range, Span
from soundspaces_sim.echogram.assembly import cut
from soundspaces_sim.echogram.echogram import Echograms

_WANTED = 0.75  # least share of wanted pairs among those simulated, else tiles are made one by one


@dataclass(frozen=True)
class Square:
    """Tiles of these `numbers`, of all pairs of the blocks `rows` with the blocks `columns`; None: with `rows`."""

    numbers: tuple[int, ...]
    rows: tuple[Range, ...]
    columns: tuple[Range, ...] | None

    @property
    def cost(self) -> int:
        """Points whose subpaths are traced."""
        return sum(end - first for first, end in (*self.rows, *(self.columns or ())))

    @property
    def pairs(self) -> int:
        """That are simulated, there and back."""
        rows, columns = _size(self.rows), self.columns
        return rows**2 if columns is None else 2 * rows * _size(columns)

    def points(self, of_job: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Those of the rows and of the columns, of a job's (N, 3)."""
        a, b = self.rows, self.columns
        return _points(of_job, a), None if b is None else _points(of_job, b)

    def echograms(self, span: Span, there: Echograms, back: Echograms | None) -> Echograms:
        """Those of a span, of echograms from rows to columns and back."""
        sources, listeners = span
        if len(self.rows) == 1 and self.columns is None:
            return there  # all of them
        if self.columns is None:
            return cut(there, _place(sources, self.rows), _place(listeners, self.rows))
        if sources in self.rows:
            return cut(there, _place(sources, self.rows), _place(listeners, self.columns))
        assert back is not None
        return cut(back, _place(sources, self.columns), _place(listeners, self.rows))


def squares(plan: JobPlan, numbers: Sequence[int], side: int) -> list[Square]:
    """Tiles in groups that are simulated as one, of at most `side` points on a side. A group comes where its first
    tile does. Tiles of a size that the user has set are made one by one."""
    points, blocks = len(plan.draft.points), max(side // plan.block, 1)
    if side >= points:
        blocks = points  # all of them: the last one may be smaller
    if plan.draft.config.dataset.tile is not None:
        blocks = 1
    groups: dict[tuple[int, int], list[int]] = {}
    for number in numbers:
        tile = plan.tiles[number]
        place = tile.a[0] // plan.block // blocks, tile.b[0] // plan.block // blocks
        groups.setdefault(place, []).append(number)
    return [square for group in groups.values() for square in _of_group(plan.tiles, group)]


def _of_group(tiles: Sequence[PointBlocks], numbers: Sequence[int]) -> list[Square]:
    """All of a group as one, or one by one where much of it is there already."""
    whole = _square(tiles, numbers)
    wanted = sum(tiles[number].pairs for number in numbers)
    if len(numbers) == 1 or wanted >= _WANTED * whole.pairs:
        return [whole]
    return [_square(tiles, [number]) for number in numbers]


def _square(tiles: Sequence[PointBlocks], numbers: Sequence[int]) -> Square:
    rows, columns = {tiles[n].a for n in numbers}, {tiles[n].b for n in numbers}
    if rows & columns:
        return Square(tuple(numbers), tuple(sorted(rows | columns)), None)
    return Square(tuple(numbers), tuple(sorted(rows)), tuple(sorted(columns)))


def _size(blocks: Iterable[Range]) -> int:
    return sum(end - first for first, end in blocks)


def _points(of_job: np.ndarray, blocks: Iterable[Range]) -> np.ndarray:
    return np.concatenate([of_job[slice(*block)] for block in blocks])


def _place(block: Range, blocks: Sequence[Range]) -> slice:
    """Where a block's points are among those of `blocks`."""
    ends = dict(zip(blocks, accumulate(end - first for first, end in blocks), strict=True))
    return slice(ends[block] - (block[1] - block[0]), ends[block])
