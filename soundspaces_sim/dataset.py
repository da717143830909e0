"""The reader: `open_dataset(path)` and then any pair, as echogram, ambisonic or binaural response.

Shards hold echograms; waveforms are made from them on reading, deterministically: the noise of a
response hangs on the dataset's seed and the pair alone.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import oaconvolve

from soundspaces_sim.ambisonics import ambisonic_rir
from soundspaces_sim.binaural import binaural_rir
from soundspaces_sim.echogram import Echogram
from soundspaces_sim.errors import DatasetError, PairIndexError
from soundspaces_sim.manifest import Manifest, read_manifest
from soundspaces_sim.shard import ShardReader
from soundspaces_sim.transport.rng import combine

_OPEN_SHARDS = 32


class RirDataset:
    """Room impulse responses between all points of a scene: a resource that opens files lazily.

    `points` (N, 3) m; `rate` Hz; `len(ds)` pairs. Sources and listeners are rows of `points`.
    Pickles as path and settings; each process opens its own files.
    """

    def __init__(self, path: str | Path, rate: int | None = None) -> None:
        self.path = Path(path)
        self.manifest: Manifest = read_manifest(self.path)
        if not self.manifest.complete:
            raise DatasetError(
                f"{self.path}: this dataset is not finished; run the same `make rirs` again to go on"
            )
        self.points = np.array(self.manifest.points, float).reshape(-1, 3)
        self.rate = int(rate or self.manifest.config.dataset.rate)
        self._seed = self.manifest.config.dataset.seed
        first = [e.sources[0] for e in self.manifest.shards]
        self._rows = np.unique(first)
        self._shard_of = {(e.sources[0], e.listeners[0]): e for e in self.manifest.shards}
        self._open: OrderedDict[str, ShardReader] = OrderedDict()
        self._process = os.getpid()

    def __len__(self) -> int:
        return len(self.points) ** 2

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "rate": self.rate}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def __enter__(self) -> RirDataset:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; the next read opens them again."""
        for reader in self._open.values():
            reader.close()
        self._open.clear()

    def echogram(self, source: int, listener: int) -> Echogram:
        """Energy against delay, per band. Raises `PairIndexError`, `DatasetError`."""
        s, l = self._check(source, "source"), self._check(listener, "listener")  # noqa: E741
        row = int(self._rows[np.searchsorted(self._rows, s, "right") - 1])
        column = int(self._rows[np.searchsorted(self._rows, l, "right") - 1])
        reader = self._reader(self._shard_of[row, column].file)
        return reader.echogram(s - row, l - column)

    def ambisonic(self, source: int, listener: int, rate: int | None = None) -> np.ndarray:
        """(9, n) float32 response, ACN/SN3D, world axes."""
        key = combine(np.uint64(combine(np.uint64(self._seed), source)), listener)
        return ambisonic_rir(self.echogram(source, listener), rate or self.rate, int(key))

    def binaural(
        self,
        source: int,
        listener: int,
        heading_deg: float = 0.0,
        rate: int | None = None,
        *,
        pitch_deg: float = 0.0,
        roll_deg: float = 0.0,
    ) -> np.ndarray:
        """(2, n) float32 response at the ears of a head; angles as in `soundfield.head_matrix`."""
        rate = rate or self.rate
        field = self.ambisonic(source, listener, rate)
        return binaural_rir(field, rate, heading_deg, pitch_deg=pitch_deg, roll_deg=roll_deg)

    def render(
        self, audio: ArrayLike, source: int, listener: int, heading_deg: float = 0.0
    ) -> np.ndarray:
        """(2, n) float32: a dry mono signal (m,) at the dataset's rate, as heard at the listener."""
        dry = np.asarray(audio, np.float32)
        if dry.ndim != 1 or len(dry) == 0:
            raise DatasetError(f"audio: expected a mono signal of shape (n,), got {dry.shape}")
        rir = self.binaural(source, listener, heading_deg)
        return np.asarray(oaconvolve(rir, dry[None], axes=1), np.float32)

    def _check(self, index: int, what: str) -> int:
        if not 0 <= int(index) < len(self.points):
            raise PairIndexError(
                f"{what} {index} is out of range: {self.path} has points 0 to {len(self.points) - 1}"
            )
        return int(index)

    def _reader(self, file: str) -> ShardReader:
        if self._process != os.getpid():  # forked: the parent's handles are not ours to use
            self._open, self._process = OrderedDict(), os.getpid()
        reader = self._open.pop(file, None) or ShardReader(self.path / file)
        self._open[file] = reader
        if len(self._open) > _OPEN_SHARDS:
            self._open.popitem(last=False)[1].close()
        return reader


def open_dataset(path: str | Path, rate: int | None = None) -> RirDataset:
    """Open a dataset made by `make rirs`; `rate` in Hz overrides the one it was made for.

    Raises `DatasetError` if there is none, it is unfinished, or of another version.
    """
    return RirDataset(path, rate)
