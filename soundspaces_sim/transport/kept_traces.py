"""What subpaths of points have left, kept for tiles that are still to come: every point of a job is traced once.

A job's tiles pair blocks of points, and a block is in as many tiles as there are blocks. The first time that a
block is traced, its subpaths are detected at the points of all blocks with which it is still to be paired. What
they leave there is kept until the tile is made that it is for. A pair's energies depend on its two points alone, so
the bits are those of tiles that are made one by one.

Tables are kept in memory up to a limit, and beyond it in unnamed files of a folder, which go with the process.
Where neither has room, or none is left for its subpaths themselves, a block is traced again.
"""

from __future__ import annotations

import logging
import math
import shutil
import tempfile
from collections.abc import Callable, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from soundspaces_sim.core.memory import free_memory
from soundspaces_sim.core.platforms import reserve
from soundspaces_sim.transport.memory import SUBPATHS_ALONE
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.state import Tables
from soundspaces_sim.transport.tables import CHANNELS
from soundspaces_sim.transport.tile import Side, Walks, batch_rows, make_side

MEMORY = 1e9  # bytes of tables that are kept in memory
_OF_FREE = 0.2  # of the free memory, for sides and walks, which are kept nowhere else
_SPARE = 2.0  # times what is written that must be free on the disk
_log = logging.getLogger(__name__)

Add = Callable[[slice, Tables], None]
#: The walks of the first side; what they deposit at the second is added.
TraceSide = Callable[[Side, Side, Add], Walks]
_Key = bytes  # of points


class KeptTraces:
    """Of one model. `folder`: where there is room for tables beside `memory` bytes; None: nowhere. `walks`: bytes
    of sides and walks that are kept from tile to tile."""

    def __init__(
        self,
        model: Model,
        folder: Path | None = None,
        memory: float = MEMORY,
        walks: float | None = None,
    ) -> None:
        self.model = model
        self._folder, self._memory = folder, memory
        self._room = _OF_FREE * free_memory() if walks is None else walks
        self._coming: set[frozenset[_Key]] = set()
        self._points: dict[_Key, np.ndarray] = {}
        self._sides: dict[_Key, Side] = {}
        self._walks: dict[_Key, Walks] = {}
        self._parts: dict[tuple[_Key, _Key], Tables] = {}

    def expect(self, tiles: Sequence[tuple[np.ndarray, np.ndarray | None]]) -> None:
        """These tiles are to come: pairs of blocks of points, or all pairs of one where the second is None. What
        others would need is dropped."""
        blocks = [(a, a if b is None else b) for a, b in tiles]
        self._coming = {frozenset((a.tobytes(), b.tobytes())) for a, b in blocks}
        self._points = {p.tobytes(): p for pair in blocks for p in pair}
        self._parts = {k: t for k, t in self._parts.items() if frozenset(k) in self._coming}
        needed = {own for own, _ in self._parts}  # with what they have left for others
        sides, self._sides = self._sides, {}
        for key, side in sorted(sides.items(), key=lambda kept: kept[0] not in needed):
            if key in self._points and self._fit({*self._sides, key}):
                self._sides[key] = side
        self._walks = {k: w for k, w in self._walks.items() if k in needed & self._sides.keys()}
        self._parts = {k: table for k, table in self._parts.items() if k[0] in self._walks}

    def _fit(self, blocks: set[_Key]) -> bool:
        """Whether there is room for the sides and walks of these blocks."""
        return SUBPATHS_ALONE * sum(len(self._points[k]) for k in blocks) <= self._room

    def side(self, points: np.ndarray) -> Side:
        """The side of a block, the same one in all tiles."""
        key = points.tobytes()
        if key not in self._sides:
            self._sides[key] = make_side(self.model, points)
        return self._sides[key]

    def trace(self, own: np.ndarray, other: np.ndarray, trace: TraceSide, add: Add) -> Walks:
        """The walks of a block, whose deposits at the points of another `add` gets; `trace` traces them."""
        key, wanted = own.tobytes(), other.tobytes()
        found = self._parts.pop((key, wanted), None)
        if found is not None:
            add(slice(0, len(own)), found)
            return self._walks[key]
        side = self.side(own)
        later = self._room_for(key, wanted)
        blocks = [other, *(self._points[k] for k in later)]
        detectors = make_side(self.model, np.concatenate(blocks)) if later else self.side(other)
        ends = np.cumsum([len(block) for block in blocks])

        def add_part(rows: slice, tables: Tables) -> None:
            for k, first, last in zip(later, ends[:-1], ends[1:], strict=True):
                for kept, table in zip(self._parts[key, k], tables, strict=True):
                    kept[rows] = table[:, first:last]
            add(rows, Tables(*(table[:, : ends[0]] for table in tables)))

        walks = trace(side, detectors, add_part)
        return self._walks.setdefault(key, walks)  # the same each time that they are traced

    def _room_for(self, key: _Key, wanted: _Key) -> list[_Key]:
        """Blocks beside the one that is `wanted` with which a block is still to be paired, with room for them."""
        fits = self._fit({key, *self._walks})  # so that its walks will be kept
        partners = [k for k in self._points if frozenset((key, k)) in self._coming and k != wanted]
        later = [k for k in partners if (key, k) not in self._parts]
        done = []
        for k in later:
            part = self._empty(len(self._points[key]), len(self._points[k])) if fits else None
            if part is None:
                _log.info("No room to keep what subpaths leave: points are traced again for other tiles")
                break
            self._parts[key, k] = part
            done.append(k)
        return done

    def _empty(self, rows: int, columns: int) -> Tables | None:
        model = self.model
        bands = model.world.air.shape[1]
        table = rows, columns, len(model.time_edges) - 1, CHANNELS, bands
        shapes = table, table, (rows, columns, batch_rows(model), model.windows, bands)
        size = 4.0 * sum(float(np.prod(shape, dtype=float)) for shape in shapes)
        tables = chain(*self._parts.values())
        held = sum(table.nbytes for table in tables if not isinstance(table, np.memmap))
        if held + size <= self._memory:
            return Tables(*(np.empty(shape, np.float32) for shape in shapes))
        if self._folder is None or not _SPARE * size <= shutil.disk_usage(self._folder).free:
            return None
        try:
            return Tables(*(self._on_disk(shape) for shape in shapes))
        except OSError as error:  # others write there, too, or there is a quota
            _log.info("%s: %s", self._folder, error)
            return None

    def _on_disk(self, shape: tuple[int, ...]) -> np.ndarray:
        with tempfile.TemporaryFile(dir=self._folder) as file:
            reserve(file.fileno(), 4 * math.prod(shape))
            return np.memmap(file, np.float32, "w+", shape=shape)
