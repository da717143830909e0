"""Responses as the files of a dataset hold them: echograms and waveforms of pairs, and the table.

Light: neither the renderer nor the tracer is imported.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable
from functools import cached_property
from operator import index
from pathlib import Path
from typing import SupportsIndex, TypeVar

import numpy as np

from soundspaces_sim.core.errors import DatasetError, PairIndexError
from soundspaces_sim.core.platforms import at_fork
from soundspaces_sim.core.registry import Entry, of_neighbour
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.manifest import Manifest, ShardEntry, read_manifest, rebuild_command
from soundspaces_sim.dataset.format.schema import Form
from soundspaces_sim.dataset.format.shard import Shard
from soundspaces_sim.dataset.format.table import concatenate_tables, shard_table
from soundspaces_sim.dataset.format.waveform_shard import WaveformShard
from soundspaces_sim.dataset.materials import ChangeableMaterials, Furnishing, changeable
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.low_response import LowResponse
from soundspaces_sim.echogram.reflection_counts import MaterialGroups
from soundspaces_sim.echogram.refurnish import Materials, absorption_of

_OPEN_SHARDS = 32
_all: weakref.WeakSet[ShardHandles] = weakref.WeakSet()
_all_lock = threading.Lock()
_held: list[ShardHandles] = []  # by the thread that forks, while it forks


def _before_fork() -> None:
    """Wait until no thread reads: a lock that another thread holds would never be released in the child."""
    _all_lock.acquire()
    _held[:] = list(_all)
    for handles in _held:
        handles._lock.acquire()


def _after_fork() -> None:
    for handles in reversed(_held):
        handles._lock.release()
    _held.clear()
    _all_lock.release()


at_fork(_before_fork, _after_fork, _after_fork)
_T = TypeVar("_T")


class ShardHandles:
    """The shards of a dataset's folder: a resource that opens them when they are first read.

    Safe in threads and in forks: a lock is held while a shard is read and while the process forks, and every
    process opens its own files. A shard that is opened is checked to be the one that the manifest names.
    `fetch` is called before a file is opened, for datasets that lie elsewhere.
    """

    def __init__(
        self, folder: Path, manifest: Manifest, fetch: Callable[[ShardEntry], None] | None = None
    ) -> None:
        self._folder, self._fetch = folder, fetch
        self._air, self._bands = manifest.config.simulation.air, manifest.config.simulation.bands
        self._rows: dict[Form, np.ndarray] = {}
        self._columns: dict[Form, np.ndarray] = {}
        for form in ("echogram", "waveform"):
            entries = [e for e in manifest.shards if e.form == form]
            self._rows[form] = np.unique([e.sources[0] for e in entries])
            self._columns[form] = np.unique([e.listeners[0] for e in entries])
        self._file = {(e.form, e.sources[0], e.listeners[0]): e for e in manifest.shards}
        self._points = np.array(manifest.points, float).reshape(-1, 3)
        self._open: OrderedDict[str, Shard] = OrderedDict()
        self._process = os.getpid()
        self._lock = threading.RLock()
        with _all_lock:
            _all.add(self)

    def has(self, form: Form) -> bool:
        """Whether the dataset stores this form."""
        return len(self._rows[form]) > 0

    def echogram(self, s: int, l: int, read: Callable[[EchogramShard, int, int], _T]) -> _T:
        """`read(shard, row, column)` of the echogram shard that holds the pair, and its place there."""
        with self._lock:
            entry, i, j = self._locate("echogram", s, l)
            shard = self._shard(entry)
            assert isinstance(shard, EchogramShard)
            return read(shard, i, j)

    def waveform(self, s: int, l: int, read: Callable[[WaveformShard, int, int], _T]) -> _T:
        """The same of waveform shards."""
        with self._lock:
            entry, i, j = self._locate("waveform", s, l)
            shard = self._shard(entry)
            assert isinstance(shard, WaveformShard)
            return read(shard, i, j)

    def of_every_shard(self, form: Form, read: Callable[[Shard], _T]) -> list[_T]:
        """`read(shard)` of all shards of a form, in the manifest's order."""
        with self._lock:
            return [read(self._shard(entry)) for entry in self._file.values() if entry.form == form]

    def close(self) -> None:
        """Close the files; the next read opens them again."""
        with self._lock:
            if self._process == os.getpid():
                for shard in self._open.values():
                    shard.close()
            self._open.clear()

    def _locate(self, form: Form, s: int, l: int) -> tuple[ShardEntry, int, int]:
        """The shard of a pair, and the pair's place in it."""
        rows, columns = self._rows[form], self._columns[form]
        row = int(rows[np.searchsorted(rows, s, "right") - 1])
        column = int(columns[np.searchsorted(columns, l, "right") - 1])
        return self._file[form, row, column], s - row, l - column

    def _shard(self, entry: ShardEntry) -> Shard:
        if self._process != os.getpid():  # forked: the parent's handles are not ours to use
            self._open, self._process = OrderedDict(), os.getpid()
        shard = self._open.pop(entry.file, None)
        if shard is None:
            path = self._folder / entry.file
            if self._fetch is not None:
                self._fetch(entry)
            echogram = entry.form == "echogram"
            shard = EchogramShard(path, self._air) if echogram else WaveformShard(path)
            try:
                shard.check_identity(entry, self._points, self._bands)
            except BaseException:
                shard.close()
                raise
        self._open[entry.file] = shard
        if len(self._open) > _OPEN_SHARDS:
            self._open.popitem(last=False)[1].close()
        return shard


_REMOTE = Entry("soundspaces_remote.remote:Remote", "a dataset behind a URL", "remote")
_PAIRS = 8  # whose counts decide the ranges of materials


class StoredResponses:
    """The files of a finished dataset: a resource that opens them lazily. Raises `DatasetError`."""

    def __init__(
        self, where: str | Path, materials: Materials | None = None, force: bool = False
    ) -> None:
        fetch = None
        self._remote = isinstance(where, str) and "://" in where
        if isinstance(where, str) and "://" in where:
            remote = of_neighbour(f"{where}: a dataset behind a URL", _REMOTE)(where)
            where, fetch = remote.folder, remote.fetch
        self.path = Path(where)
        self.manifest: Manifest = read_manifest(self.path)
        if not self.manifest.complete:
            raise DatasetError(
                f"{self.path}: this dataset is not finished; run the same `make rirs` again to go on"
            )
        self.points = np.array(self.manifest.points, float).reshape(-1, 3)
        self.shards = ShardHandles(self.path, self.manifest, fetch)
        self._furnishing = self.furnishing(materials, force)

    @property
    def plain(self) -> bool:
        """Whether another process that opens `path` reads the same: files on this machine, materials as stored."""
        return not self._remote and self._furnishing is None

    @property
    def plain_echograms(self) -> bool:
        """Whether echograms are read as they are stored, and there are no waves beside them."""
        if self._furnishing is not None or not self.shards.has("echogram"):
            return False
        return self.shards.echogram(0, 0, lambda shard, i, j: shard.low.of_pair(i, j)) is None

    def close(self) -> None:
        """Close the files; the next read opens them again."""
        self.shards.close()

    def row(self, point: SupportsIndex, what: str) -> int:
        """The number of a point. Raises `PairIndexError` unless there is such a point."""
        try:
            row = index(point)
        except TypeError:
            raise PairIndexError(f"{what}: expected the number of a point, got {point!r}") from None
        if not 0 <= row < len(self.points):
            raise PairIndexError(
                f"{what} {row} is out of range: {self.path} has points 0 to {len(self.points) - 1}"
            )
        return row

    def furnishing(self, materials: Materials | None, force: bool) -> Furnishing | None:
        """What `materials` ask of this dataset, checked. Raises `DatasetError`, `MaterialError`."""
        if materials is None:
            return None
        command = rebuild_command(self.manifest)
        groups = self.groups
        if groups is None:
            again = f", as by `{command}`," if command else ""
            raise DatasetError(
                f"{self.path}: holds no counts of reflections, so its materials cannot change; make it anew{again} "
                "with --materials-on-reading (`[simulation.materials] enabled = true`), in another folder"
            )
        absorption_of(groups, self.manifest.config.simulation.bands, materials)
        return Furnishing(materials, force, command)

    @property
    def groups(self) -> MaterialGroups | None:
        """The materials whose reflections were counted; None if none were."""
        if not self.shards.has("echogram"):
            return None
        return self.shards.echogram(0, 0, lambda shard, *_: shard.counts.groups)

    @cached_property
    def materials(self) -> ChangeableMaterials:
        """Those of which the absorption can be chosen, with ranges that hold for some pairs."""
        groups = self.groups
        if groups is None:
            return ChangeableMaterials()
        n = len(self.points)
        pairs = {
            (k % n, (7 * k + 1) % n) for k in np.linspace(0, n - 1, min(n, _PAIRS)).astype(int).tolist()
        }
        found = [
            self.shards.echogram(s, l, lambda shard, i, j: shard.echogram(i, j, counts=True))
            for s, l in sorted(pairs)
        ]
        return changeable(groups, found)

    def echogram(
        self, s: SupportsIndex, l: SupportsIndex, materials: Materials | None = None, force: bool = False
    ) -> Echogram:
        """The echogram of a pair; with `materials`, these instead of those of the dataset. Raises `PairIndexError`,
        `DatasetError`, `MaterialError`."""
        s, l = self.row(s, "source"), self.row(l, "listener")
        if not self.shards.has("echogram"):
            raise DatasetError(
                f"{self.path} stores waveforms alone; build it with STORE=both for echograms"
            )
        chosen = self._furnishing if materials is None else self.furnishing(materials, force)
        if chosen is None:
            return self.shards.echogram(s, l, lambda shard, i, j: shard.echogram(i, j))
        return self.shards.echogram(s, l, chosen.echogram)

    def counted(self, s: SupportsIndex, l: SupportsIndex) -> Echogram:
        """The echogram of a pair as simulated, with its counts of reflections. Raises `PairIndexError`,
        `DatasetError` if there are none."""
        s, l = self.row(s, "source"), self.row(l, "listener")
        if self.groups is None:
            raise DatasetError(
                f"{self.path}: holds no counts of reflections; make it anew with `[simulation.materials] enabled = "
                "true`"
            )
        return self.shards.echogram(s, l, lambda shard, i, j: shard.echogram(i, j, counts=True))

    def low(self, s: SupportsIndex, l: SupportsIndex) -> LowResponse:
        """The waves of a pair. Raises `PairIndexError`, `DatasetError` if there are none."""
        s, l = self.row(s, "source"), self.row(l, "listener")
        found = None
        if self.shards.has("echogram"):
            found = self.shards.echogram(s, l, lambda shard, i, j: shard.low.of_pair(i, j))
        if found is None:
            raise DatasetError(
                f'{self.path}: holds no waves; make it anew with `[simulation.low] method = "waves"`'
            )
        return found

    def measure_error(self, s: int, l: int) -> np.ndarray:
        """(M, bands) standard errors of `MEASURES` of a pair."""
        return self.shards.echogram(s, l, lambda shard, i, j: shard.pairs["measure_error"][i, j])

    def has_waveforms(self, rate: int, renderer: str) -> bool:
        """Whether waveforms at this rate by this renderer are stored. Raises `DatasetError` if waveforms alone
        are stored, at another rate."""
        if not self.shards.has("waveform") or self._furnishing is not None:
            return False
        own = self.manifest.config.dataset
        if rate != own.rate and not self.shards.has("echogram"):
            raise DatasetError(
                f"{self.path} stores waveforms at {own.rate} Hz alone, {rate} Hz was asked for; resample them, "
                "or build the dataset with STORE=both"
            )
        return rate == own.rate and renderer == own.renderer

    def ambisonic(self, s: int, l: int) -> np.ndarray:
        """(9, n) the stored response of a pair."""
        return self.shards.waveform(s, l, lambda shard, i, j: shard.ambisonic(i, j))

    def binaural(self, s: int, l: int, headings_deg: np.ndarray) -> np.ndarray:
        """(k, 2, n) the stored responses of a pair, for k of the headings of the dataset."""
        return self.shards.waveform(
            s, l, lambda shard, i, j: np.stack([shard.binaural(i, j, h) for h in headings_deg])
        )

    def table(self, collocated: bool) -> np.ndarray:
        """One row per pair: see `RirDataset.table`."""
        form: Form = "echogram" if self.shards.has("echogram") else "waveform"

        def rows(shard: Shard) -> np.ndarray:
            if self._furnishing is None or not isinstance(shard, EchogramShard):
                return shard_table(shard)
            return shard_table(shard, self._furnishing.columns(shard))

        return concatenate_tables(self.shards.of_every_shard(form, rows), collocated)
