"""The reader: `open_dataset(path)` and then any pair, as echogram, ambisonic or binaural response.

Echograms become waveforms on reading, deterministically: the noise of a response hangs on the dataset's
seed and the pair alone. Waveforms that are stored are read where they fit what is asked for.

Safe in threads and in forked or spawned workers: a pickle is a path and settings, and every process
opens its own files.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal

import networkx
import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.base.errors import ConfigError, DatasetError, PairIndexError
from soundspaces_sim.echo.echogram import Echogram
from soundspaces_sim.places.records import WalkGraph, to_networkx
from soundspaces_sim.sound import auralise as listening
from soundspaces_sim.sound.ambisonics import ambisonic_rir, pair_seed
from soundspaces_sim.sound.binaural import binaural_rirs
from soundspaces_sim.sound.seed_paper import paper_rir
from soundspaces_sim.storage.echogram_shard import EchogramShard
from soundspaces_sim.storage.manifest import Manifest, read_manifest
from soundspaces_sim.storage.schema import Form
from soundspaces_sim.storage.shard import Shard
from soundspaces_sim.storage.table import shard_table
from soundspaces_sim.storage.waveform_shard import WaveformShard

Kind = Literal["binaural", "ambisonic", "echogram"]
_OPEN_SHARDS = 32


class RirDataset:
    """Room impulse responses between all points of a scene: a resource that opens files lazily.

    `points` (N, 3) m; `rate` Hz; `len(ds)` pairs. Sources and listeners are rows of `points`. `hrtf`:
    path of a SOFA file for binaural responses, KEMAR by default.
    """

    def __init__(
        self, path: str | Path, rate: int | None = None, hrtf: str | Path | None = None
    ) -> None:
        self.path = Path(path)
        self.manifest: Manifest = read_manifest(self.path)
        if not self.manifest.complete:
            raise DatasetError(
                f"{self.path}: this dataset is not finished; run the same `make rirs` again to go on"
            )
        self.scene = self.manifest.scene
        self.points = np.array(self.manifest.points, float).reshape(-1, 3)
        self.rate = int(rate or self.manifest.config.dataset.rate)
        self.hrtf = hrtf
        self._rows: dict[Form, np.ndarray] = {}
        self._columns: dict[Form, np.ndarray] = {}
        for form in ("echogram", "waveform"):
            entries = [e for e in self.manifest.shards if e.form == form]
            self._rows[form] = np.unique([e.sources[0] for e in entries])
            self._columns[form] = np.unique([e.listeners[0] for e in entries])
        self._shard_of = {(e.form, e.sources[0], e.listeners[0]): e.file for e in self.manifest.shards}
        self._open: OrderedDict[str, Shard] = OrderedDict()
        self._process = os.getpid()
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self.points) ** 2

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Every (source, listener)."""
        n = len(self.points)
        return ((s, l) for s in range(n) for l in range(n))

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "rate": self.rate, "hrtf": self.hrtf}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def __enter__(self) -> RirDataset:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; the next read opens them again."""
        with self._lock:
            for shard in self._open.values():
                shard.close()
            self._open.clear()

    # One pair

    def echogram(self, source: int, listener: int) -> Echogram:
        """Energy against delay, per band. Raises `PairIndexError`, `DatasetError`."""
        s, l = self._check(source, "source"), self._check(listener, "listener")
        if not len(self._rows["echogram"]):
            raise DatasetError(
                f"{self.path} stores waveforms alone; build it with STORE=both for echograms"
            )
        with self._lock:
            shard, i, j = self._locate("echogram", s, l)
            assert isinstance(shard, EchogramShard)
            return shard.echogram(i, j)

    def ambisonic(self, source: int, listener: int, rate: int | None = None) -> np.ndarray:
        """(9, n) float32 response, ACN/SN3D, world axes."""
        s, l = self._check(source, "source"), self._check(listener, "listener")
        rate = rate or self.rate
        if self._stored(rate):
            with self._lock:
                shard, i, j = self._locate("waveform", s, l)
                assert isinstance(shard, WaveformShard)
                return shard.ambisonic(i, j)
        config = self.manifest.config.dataset
        make = paper_rir if config.renderer == "paper" else ambisonic_rir
        return make(self.echogram(s, l), rate, pair_seed(config.seed, s, l))

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
        return self.binaurals(source, listener, [(heading_deg, pitch_deg, roll_deg)], rate)[0]

    def binaurals(
        self, source: int, listener: int, orientations_deg: ArrayLike, rate: int | None = None
    ) -> np.ndarray:
        """(k, 2, n) float32: the same for k heads (k, 3) of heading, pitch and roll, at less cost."""
        rate = rate or self.rate
        turns = np.asarray(orientations_deg, float).reshape(-1, 3)
        headings = self.manifest.config.dataset.headings
        level = not turns[:, 1:].any()
        if (
            self.hrtf is None
            and self._stored(rate)
            and level
            and all(h % 360.0 in headings for h in turns[:, 0])
        ):
            s, l = self._check(source, "source"), self._check(listener, "listener")
            with self._lock:
                shard, i, j = self._locate("waveform", s, l)
                assert isinstance(shard, WaveformShard)
                return np.stack([shard.binaural(i, j, h) for h in turns[:, 0]])
        return binaural_rirs(self.ambisonic(source, listener, rate), rate, turns, self.hrtf)

    # Many pairs

    def get_batch(
        self,
        pairs: ArrayLike,
        kind: Kind = "binaural",
        headings_deg: ArrayLike = 0.0,
        rate: int | None = None,
        workers: int | None = None,
    ) -> tuple[Any, np.ndarray]:
        """Responses of (k, 2) pairs, made in `workers` threads (one per core): (k, channels, n) float32,
        padded with zeros, and their lengths (k,). For ``echogram`` a list, and numbers of bins.

        `headings_deg`: one, or (k,).
        """
        rows = np.atleast_2d(np.asarray(pairs, np.int64))
        if rows.shape[1] != 2:
            raise PairIndexError(f"pairs: expected shape (k, 2), got {rows.shape}")
        turns = np.broadcast_to(np.asarray(headings_deg, float), len(rows))
        if kind not in ("binaural", "ambisonic", "echogram"):
            raise ConfigError(f"kind: expected binaural, ambisonic or echogram, got {kind!r}")

        def one(k: int) -> Any:
            s, l = (int(i) for i in rows[k])
            if kind == "echogram":
                return self.echogram(s, l)
            if kind == "ambisonic":
                return self.ambisonic(s, l, rate)
            return self.binaural(s, l, float(turns[k]), rate)

        with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
            found = list(pool.map(one, range(len(rows))))
        if kind == "echogram":
            return found, np.array([len(e.energy) for e in found])
        lengths = np.array([r.shape[1] for r in found])
        out = np.zeros((len(found), 2 if kind == "binaural" else 9, lengths.max(initial=0)), np.float32)
        for response, into in zip(found, out, strict=True):
            into[:, : response.shape[1]] = response
        return out, lengths

    def sample(self, count: int, seed: int = 0, **limits: tuple[float, float]) -> np.ndarray:
        """(count, 2) random pairs, the same for the same seed. `limits`: ranges of columns of `table`,
        e.g. ``distance=(1.0, 5.0)``, ``visible=(1, 1)``, ``geodesic=(0, 20)``.

        Raises `ConfigError` if no pair is within the limits.
        """
        rng = np.random.default_rng(seed)
        if not limits:
            return rng.integers(0, len(self.points), (count, 2))
        table = self.table()
        keep = np.ones(len(table), bool)
        for name, (low, high) in limits.items():
            if name not in (table.dtype.names or ()):
                raise ConfigError(
                    f"sample: no column '{name}'; there are {', '.join(table.dtype.names or ())}"
                )
            keep &= (table[name] >= low) & (table[name] <= high)
        if not keep.any():
            raise ConfigError(f"sample: none of {len(table)} pairs of {self.path} is within {limits}")
        chosen = table[keep][rng.integers(0, int(keep.sum()), count)]
        return np.stack([chosen["source"], chosen["listener"]], axis=1).astype(np.int64)

    def nearest(self, position: ArrayLike) -> int:
        """The point nearest to a position (3,) in m."""
        place = np.asarray(position, float)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise ConfigError(f"position: expected three finite coordinates in m, got {position!r}")
        return int(np.linalg.norm(self.points - place, axis=1).argmin())

    def table(self) -> np.ndarray:
        """One row per pair, by source and listener: see `table.pair_dtype`."""
        form: Form = "echogram" if len(self._rows["echogram"]) else "waveform"
        with self._lock:
            files = [file for (kind, *_), file in self._shard_of.items() if kind == form]
            rows = np.concatenate([shard_table(self._shard(form, file)) for file in files])
        return rows[np.lexsort((rows["listener"], rows["source"]))]

    def graph(self) -> networkx.Graph:
        """The walking graph: nodes are rows of `points`."""
        found = self.manifest
        edges = np.array(found.edges, np.int64).reshape(-1, 2)
        walk = WalkGraph(np.array(found.nodes, int), edges, np.array(found.components), np.empty((0, 0)))
        return to_networkx(walk, self.points)

    # Sound

    def render(
        self, audio: ArrayLike, source: int, listener: int, heading_deg: float = 0.0
    ) -> np.ndarray:
        """(2, n) float32: a dry mono signal (m,) at the dataset's rate, as heard at the listener."""
        return listening.convolve(listening.as_mono(audio), self.binaural(source, listener, heading_deg))

    def mix(
        self, sounds: Sequence[tuple[ArrayLike, int]], listener: int, heading_deg: float = 0.0
    ) -> np.ndarray:
        """(2, n) float32: several dry mono signals at once, each (signal, source)."""
        if not sounds:
            raise ConfigError("sounds: expected at least one (signal, source)")
        return listening.add_up([self.render(audio, s, listener, heading_deg) for audio, s in sounds])

    def render_path(
        self,
        audio: ArrayLike,
        sources: ArrayLike,
        listeners: ArrayLike,
        orientations_deg: ArrayLike = (0.0, 0.0, 0.0),
    ) -> np.ndarray:
        """(2, n) float32: a dry sound whose source, or whose listener, moves along points at even times.

        One of `sources` and `listeners` is a sequence of points, the other one point; or both are one
        point and `orientations_deg` (k, 3) turns the head.
        """
        dry = listening.as_mono(audio)
        a, b = (np.atleast_1d(np.asarray(x, np.int64)) for x in (sources, listeners))
        turns = np.atleast_2d(np.asarray(orientations_deg, float))
        if len(a) > 1 and (len(b) > 1 or len(turns) > 1):
            raise ConfigError(
                "render_path: a source that moves needs a listener at rest, and the reverse"
            )
        k = max(len(a), len(b), len(turns))
        if any(len(x) not in (1, k) for x in (b, turns)):
            raise ConfigError(
                f"render_path: {len(b)} listeners and {len(turns)} orientations do not match"
            )
        places = zip(*(np.broadcast_to(x, (k, *x.shape[1:])) for x in (a, b, turns)), strict=True)
        rirs = [self.binaurals(int(s), int(l), [turn])[0] for s, l, turn in places]
        return listening.along_path(dry, rirs, "source" if len(a) > 1 else "listener")

    def spectrogram(
        self, audio: ArrayLike, source: int, listener: int, heading_deg: float = 0.0
    ) -> np.ndarray:
        """(65, frames, 2): `listening.spectrogram` of `render`, as long as the dry sound."""
        dry = listening.as_mono(audio)
        return listening.spectrogram(
            self.render(dry, source, listener, heading_deg)[:, : len(dry)], self.rate
        )

    # Files

    def _check(self, index: int, what: str) -> int:
        if not 0 <= int(index) < len(self.points):
            raise PairIndexError(
                f"{what} {index} is out of range: {self.path} has points 0 to {len(self.points) - 1}"
            )
        return int(index)

    def _stored(self, rate: int) -> bool:
        """Whether waveforms are to be read, not made. Raises if they alone are stored, at another rate."""
        if not len(self._rows["waveform"]):
            return False
        stored = self.manifest.config.dataset.rate
        if rate != stored and not len(self._rows["echogram"]):
            raise DatasetError(
                f"{self.path} stores waveforms at {stored} Hz alone, {rate} Hz was asked for; resample them, "
                "or build the dataset with STORE=both"
            )
        return rate == stored

    def _locate(self, form: Form, s: int, l: int) -> tuple[Shard, int, int]:
        """The shard of a pair, and the pair's place in it."""
        rows, columns = self._rows[form], self._columns[form]
        row = int(rows[np.searchsorted(rows, s, "right") - 1])
        column = int(columns[np.searchsorted(columns, l, "right") - 1])
        return self._shard(form, self._shard_of[form, row, column]), s - row, l - column

    def _shard(self, form: Form, file: str) -> Shard:
        if self._process != os.getpid():  # forked: the parent's handles are not ours to use
            self._open, self._process = OrderedDict(), os.getpid()
        shard = self._open.pop(file, None)
        if shard is None:
            path = self.path / file
            shard = EchogramShard(path) if form == "echogram" else WaveformShard(path)
        self._open[file] = shard
        if len(self._open) > _OPEN_SHARDS:
            self._open.popitem(last=False)[1].close()
        return shard


def open_dataset(
    path: str | Path, rate: int | None = None, hrtf: str | Path | None = None
) -> RirDataset:
    """Open a dataset made by `make rirs`; `rate` in Hz overrides the one it was made for.

    Raises `DatasetError` if there is none, it is unfinished, or of another version.
    """
    return RirDataset(path, rate, hrtf)
