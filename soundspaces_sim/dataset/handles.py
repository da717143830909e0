"""The open files of a dataset: a few at a time, shared by threads, never by processes."""

from __future__ import annotations

import os
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from soundspaces_sim.core.platforms import at_fork
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.manifest import Manifest, ShardEntry
from soundspaces_sim.dataset.format.schema import Form
from soundspaces_sim.dataset.format.shard import Shard
from soundspaces_sim.dataset.format.waveform_shard import WaveformShard

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
        self._air = manifest.config.simulation.air_within_bands
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
                shard.check_identity(entry, self._points)
            except BaseException:
                shard.close()
                raise
        self._open[entry.file] = shard
        if len(self._open) > _OPEN_SHARDS:
            self._open.popitem(last=False)[1].close()
        return shard
