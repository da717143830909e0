"""The open files of a dataset: a few at a time, shared by threads, never by processes."""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from soundspaces_sim.storage.echogram_shard import EchogramShard
from soundspaces_sim.storage.manifest import Manifest
from soundspaces_sim.storage.schema import Form
from soundspaces_sim.storage.shard import Shard
from soundspaces_sim.storage.waveform_shard import WaveformShard

_OPEN_SHARDS = 32
_T = TypeVar("_T")


class ShardHandles:
    """The shards of a dataset's folder: a resource that opens them when they are first read.

    Safe in threads and after a fork: a lock is held while a shard is read, and every process opens its own
    files.
    """

    def __init__(self, folder: Path, manifest: Manifest) -> None:
        self._folder = folder
        self._rows: dict[Form, np.ndarray] = {}
        self._columns: dict[Form, np.ndarray] = {}
        for form in ("echogram", "waveform"):
            entries = [e for e in manifest.shards if e.form == form]
            self._rows[form] = np.unique([e.sources[0] for e in entries])
            self._columns[form] = np.unique([e.listeners[0] for e in entries])
        self._file = {(e.form, e.sources[0], e.listeners[0]): e.file for e in manifest.shards}
        self._open: OrderedDict[str, Shard] = OrderedDict()
        self._process = os.getpid()
        self._lock = threading.RLock()

    def has(self, form: Form) -> bool:
        """Whether the dataset stores this form."""
        return len(self._rows[form]) > 0

    def echogram(self, s: int, l: int, read: Callable[[EchogramShard, int, int], _T]) -> _T:
        """`read(shard, row, column)` of the echogram shard that holds the pair, and its place there."""
        with self._lock:
            file, i, j = self._locate("echogram", s, l)
            shard = self._shard("echogram", file)
            assert isinstance(shard, EchogramShard)
            return read(shard, i, j)

    def waveform(self, s: int, l: int, read: Callable[[WaveformShard, int, int], _T]) -> _T:
        """The same of waveform shards."""
        with self._lock:
            file, i, j = self._locate("waveform", s, l)
            shard = self._shard("waveform", file)
            assert isinstance(shard, WaveformShard)
            return read(shard, i, j)

    def of_every_shard(self, form: Form, read: Callable[[Shard], _T]) -> list[_T]:
        """`read(shard)` of all shards of a form, in the manifest's order."""
        with self._lock:
            files = [file for (kind, *_), file in self._file.items() if kind == form]
            return [read(self._shard(form, file)) for file in files]

    def close(self) -> None:
        """Close the files; the next read opens them again."""
        with self._lock:
            if self._process == os.getpid():
                for shard in self._open.values():
                    shard.close()
            self._open.clear()

    def _locate(self, form: Form, s: int, l: int) -> tuple[str, int, int]:
        """The file of a pair, and the pair's place in it."""
        rows, columns = self._rows[form], self._columns[form]
        row = int(rows[np.searchsorted(rows, s, "right") - 1])
        column = int(columns[np.searchsorted(columns, l, "right") - 1])
        return self._file[form, row, column], s - row, l - column

    def _shard(self, form: Form, file: str) -> Shard:
        if self._process != os.getpid():  # forked: the parent's handles are not ours to use
            self._open, self._process = OrderedDict(), os.getpid()
        shard = self._open.pop(file, None)
        if shard is None:
            path = self._folder / file
            shard = EchogramShard(path) if form == "echogram" else WaveformShard(path)
        self._open[file] = shard
        if len(self._open) > _OPEN_SHARDS:
            self._open.popitem(last=False)[1].close()
        return shard
