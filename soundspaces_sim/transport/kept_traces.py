"""What subpaths of points have left, kept for tiles that are still to come: every point of a job is traced once.

A job's tiles pair blocks of points, and a block is in as many tiles as there are blocks. The first time that a
block is traced, its subpaths are detected at the points of all blocks with which it is still to be paired. What
they leave there is kept until the tile is made that it is for. A pair's energies depend on its two points alone, so
the bits are those of tiles that are made one by one.

Tables are kept in memory up to a limit, and beyond it in unnamed files of a folder, which go with the process.
Where neither has room, a block is traced again.
"""

from __future__ import annotations

import logging
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.state import Tables
from soundspaces_sim.transport.tables import CHANNELS
from soundspaces_sim.transport.tile import Side, Walks, batch_rows, make_side

MEMORY = 1e9  # bytes of tables that are kept in memory
_SPARE = 2.0  # times what is written that must be free on the disk
_log = logging.getLogger(__name__)

Add = Callable[[slice, Tables], None]
#: The walks of the first side; what they deposit at the second is added.
TraceSide = Callable[[Side, Side, Add], Walks]
_Key = bytes


def _key(points: np.ndarray) -> _Key:
    return points.tobytes()


class KeptTraces:
    """Of one model. `folder`: where there is room beside `memory` bytes; None: nowhere."""

    def __init__(self, model: Model, folder: Path | None = None, memory: float = MEMORY) -> None:
        self.model = model
        self._folder, self._memory = folder, memory
        self._coming: set[frozenset[_Key]] = set()
        self._points: dict[_Key, np.ndarray] = {}
        self._sides: dict[_Key, Side] = {}
        self._walks: dict[_Key, Walks] = {}
        self._parts: dict[tuple[_Key, _Key], Tables] = {}

    def expect(self, tiles: Sequence[tuple[np.ndarray, np.ndarray | None]]) -> None:
        """These tiles are to come: pairs of blocks of points, or all pairs of one where the second is None. What
        others would need is dropped."""
        blocks = [(a, a if b is None else b) for a, b in tiles]
        self._coming = {frozenset((_key(a), _key(b))) for a, b in blocks}
        self._points = {_key(p): p for pair in blocks for p in pair}
        self._sides = {k: side for k, side in self._sides.items() if k in self._points}
        self._walks = {k: walks for k, walks in self._walks.items() if k in self._points}
        self._parts = {k: t for k, t in self._parts.items() if frozenset(k) in self._coming}

    def side(self, points: np.ndarray) -> Side:
        """The side of a block, the same one in all tiles."""
        key = _key(points)
        if key not in self._sides:
            self._sides[key] = make_side(self.model, points)
        return self._sides[key]

    def trace(self, own: np.ndarray, other: np.ndarray, trace: TraceSide, add: Add) -> Walks:
        """The walks of a block, whose deposits at the points of another `add` gets; `trace` traces them."""
        key, wanted = _key(own), _key(other)
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
        partners = [k for k in self._points if frozenset((key, k)) in self._coming and k != wanted]
        later = [k for k in partners if (key, k) not in self._parts]
        done = []
        for k in later:
            part = self._empty(len(self._points[key]), len(self._points[k]))
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
        held = sum(
            table.nbytes
            for part in self._parts.values()
            for table in part
            if not isinstance(table, np.memmap)
        )
        if held + size <= self._memory:
            return Tables(*(np.empty(shape, np.float32) for shape in shapes))
        if self._folder is None or not _SPARE * size <= shutil.disk_usage(self._folder).free:
            return None
        return Tables(*(self._on_disk(shape) for shape in shapes))

    def _on_disk(self, shape: tuple[int, ...]) -> np.ndarray:
        with tempfile.TemporaryFile(dir=self._folder) as file:
            return np.memmap(file, np.float32, "w+", shape=shape)
