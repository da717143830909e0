"""The reader: `open_dataset(path)` and then any pair, as echogram, ambisonic or binaural response.

Echograms become waveforms on reading, deterministically: the noise of a response hangs on the dataset's
seed and the pair alone. Waveforms that are stored are read where they fit what is asked for.

Safe in threads and in forked or spawned workers: a pickle is a path and settings, and every process
opens its own files. Who reads echograms and tables alone never loads what makes sound, nor the tracer.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex, get_args, overload

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.config import check_rate
from soundspaces_sim.core.errors import ConfigError, DatasetError, PairIndexError
from soundspaces_sim.core.numerics.axes import check_degrees
from soundspaces_sim.dataset import representation as show
from soundspaces_sim.dataset import sampling
from soundspaces_sim.dataset.format.manifest import Manifest, read_manifest
from soundspaces_sim.dataset.format.table import (
    Metadata,
    as_frame,
    column_metadata,
    join_tables,
    shard_table,
)
from soundspaces_sim.dataset.handles import ShardHandles
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.layout.records import WalkGraph, to_networkx

if TYPE_CHECKING:
    import networkx
    import pandas

    from soundspaces_sim.dataset import sound
    from soundspaces_sim.echogram.endpoints import Directivity
    from soundspaces_sim.rendering.ears import Ears
    from soundspaces_sim.rendering.microphones import MicrophoneArray

Kind = Literal["binaural", "ambisonic", "monaural", "echogram"]
_CHANNELS = {"binaural": 2, "ambisonic": 9, "monaural": 1}


class RirDataset:
    """Room impulse responses between all points of a scene: a resource that opens files lazily.

    `points` (N, 3) m; `rate` Hz; `len(ds)` pairs. Sources and listeners are rows of `points`. `hrtf`:
    path of a SOFA file for binaural responses, KEMAR by default, or `Ears`; `renderer`: see `rendering.renderers`.

    `source` in the methods below: a directivity in world axes, ``ss.Talker(heading_deg=90.0)``, or its name;
    None is omnidirectional. It needs echograms, and reads those of the way back.
    """

    def __init__(
        self,
        path: str | Path,
        rate: int | None = None,
        hrtf: str | Path | Ears | None = None,
        renderer: str | None = None,
    ) -> None:
        self._given, fetch = path, None
        if isinstance(path, str) and "://" in path:
            from soundspaces_sim.dataset.remote import Remote

            remote = Remote(path)
            path, fetch = remote.folder, remote.fetch
        self.path = Path(path)
        self.manifest: Manifest = read_manifest(self.path)
        if not self.manifest.complete:
            raise DatasetError(
                f"{self.path}: this dataset is not finished; run the same `make rirs` again to go on"
            )
        self.scene = self.manifest.scene
        self.points = np.array(self.manifest.points, float).reshape(-1, 3)
        self.rate = self.manifest.config.dataset.rate if rate is None else check_rate(rate)
        self.hrtf = hrtf
        if not (hrtf is None or isinstance(hrtf, str | Path)):
            from soundspaces_sim.rendering.ears import as_ears

            self.hrtf = as_ears(hrtf)
        self.renderer = self.manifest.config.dataset.renderer if renderer is None else renderer
        if renderer is not None:
            from soundspaces_sim.rendering.renderers import check_renderer

            check_renderer(renderer)
        self._shards = ShardHandles(self.path, self.manifest, fetch)

    def __repr__(self) -> str:
        return show.text(self)

    def _repr_html_(self) -> str:
        return show.picture(self)

    def __len__(self) -> int:
        return len(self.points) ** 2

    def __getitem__(self, pair: tuple[SupportsIndex, SupportsIndex]) -> Echogram:
        """`ds[source, listener]` is `ds.echogram(source, listener)`."""
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise PairIndexError(f"expected ds[source, listener], got ds[{pair!r}]")
        return self.echogram(self._check(pair[0], "source"), self._check(pair[1], "listener"))

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Every (source, listener)."""
        n = len(self.points)
        return ((s, l) for s in range(n) for l in range(n))

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self._given, "rate": self.rate, "hrtf": self.hrtf, "renderer": self.renderer}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def __enter__(self) -> RirDataset:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; the next read opens them again."""
        self._shards.close()

    # One pair

    def echogram(
        self,
        s: int,
        l: int,
        /,
        source: Directivity | str | None = None,
        listener: Directivity | str | None = None,
    ) -> Echogram:
        """Energy against delay, per band, from point `s` to point `l`; with a `source` or a `listener` that is
        directive, see `directed.directed`. Raises `PairIndexError`, `DatasetError`."""
        if source is not None or listener is not None:
            from soundspaces_sim.dataset import directive

            c = self.manifest.config.simulation.c
            return directive.echogram(self.echogram, s, l, source, listener, c)
        s, l = self._check(s, "source"), self._check(l, "listener")
        if not self._shards.has("echogram"):
            raise DatasetError(
                f"{self.path} stores waveforms alone; build it with STORE=both for echograms"
            )
        return self._shards.echogram(s, l, lambda shard, i, j: shard.echogram(i, j))

    def ambisonic(
        self, s: int, l: int, /, rate: int | None = None, *, source: Directivity | str | None = None
    ) -> np.ndarray:
        """(9, n) float32 response, ACN/SN3D, world axes."""
        s, l, rate = self._asked(s, l, rate)
        if source is None and self._stored(rate):
            return self._shards.waveform(s, l, lambda shard, i, j: shard.ambisonic(i, j))
        from soundspaces_sim.dataset import sound

        seed = self.manifest.config.dataset.seed
        return sound.response(self.echogram(s, l, source), self.renderer, seed, s, l, rate)

    def monaural(
        self,
        s: int,
        l: int,
        /,
        rate: int | None = None,
        *,
        source: Directivity | str | None = None,
        listener: Directivity | str | None = None,
    ) -> np.ndarray:
        """(1, n) float32 response of a microphone, omnidirectional or with the directivity `listener`."""
        if listener is None:
            return self.ambisonic(s, l, rate, source=source)[:1]
        s, l, rate = self._asked(s, l, rate)
        echogram = self.echogram(s, l, source, listener)
        from soundspaces_sim.dataset import sound

        seed = self.manifest.config.dataset.seed
        return sound.response(echogram, self.renderer, seed, s, l, rate)[:1]

    def microphones(
        self,
        s: int,
        l: int,
        /,
        array: MicrophoneArray,
        rate: int | None = None,
        *,
        source: Directivity | str | None = None,
    ) -> np.ndarray:
        """(k, n) float32 responses of an array of microphones centred at point `l`, phases together."""
        s, l, rate = self._asked(s, l, rate)
        echogram = self.echogram(s, l, source)
        from soundspaces_sim.dataset import sound

        config = self.manifest.config
        return sound.at_microphones(
            echogram, array, config.dataset.seed, s, l, rate, config.simulation.c
        )

    def binaural(
        self,
        s: int,
        l: int,
        /,
        heading_deg: float = 0.0,
        rate: int | None = None,
        *,
        pitch_deg: float = 0.0,
        roll_deg: float = 0.0,
        source: Directivity | str | None = None,
    ) -> np.ndarray:
        """(2, n) float32 response at the ears of a head; angles as in `axes.head_matrix`."""
        return self.binaurals(s, l, [(heading_deg, pitch_deg, roll_deg)], rate, source=source)[0]

    def binaurals(
        self,
        s: int,
        l: int,
        /,
        orientations_deg: ArrayLike,
        rate: int | None = None,
        *,
        source: Directivity | str | None = None,
    ) -> np.ndarray:
        """(k, 2, n) float32: the same for k heads (k, 3) of heading, pitch and roll, at less cost."""
        rate = self.rate if rate is None else check_rate(rate)
        turns = check_degrees(orientations_deg, "heading, pitch and roll").reshape(-1, 3)
        headings = self.manifest.config.dataset.headings
        level = not turns[:, 1:].any()
        if (
            source is None
            and self.hrtf is None
            and self._stored(rate)
            and level
            and all(h % 360.0 in headings for h in turns[:, 0])
        ):
            s, l = self._check(s, "source"), self._check(l, "listener")
            return self._shards.waveform(
                s, l, lambda shard, i, j: np.stack([shard.binaural(i, j, h) for h in turns[:, 0]])
            )
        from soundspaces_sim.dataset import sound

        if self.hrtf is None or isinstance(self.hrtf, str | Path):
            field = self.ambisonic(s, l, rate, source=source)
            return sound.at_the_ears(field, rate, turns, self.hrtf)
        config = self.manifest.config
        return sound.at_these_ears(
            self.echogram(s, l, source), self.renderer, config.dataset.seed, s, l, rate, turns, self.hrtf,
            config.simulation.c,
        )  # fmt: skip

    # Many pairs

    def get_batch(
        self,
        pairs: ArrayLike,
        kind: Kind = "binaural",
        headings_deg: ArrayLike = 0.0,
        rate: int | None = None,
        workers: int | None = None,
        *,
        source: Directivity | str | Sequence[Directivity | str | None] | None = None,
    ) -> tuple[Any, np.ndarray]:
        """Responses of (k, 2) pairs, made in `workers` threads (one per core): (k, channels, n) float32,
        padded with zeros, and their lengths (k,). For ``echogram`` a list, and numbers of bins.

        `headings_deg`: one, or (k,). `source`: one directivity, or k.
        """
        rows = sampling.as_pairs(pairs)
        turns = np.broadcast_to(check_degrees(headings_deg, "headings_deg"), len(rows))
        emit = sampling.for_each(source, len(rows), "source")
        if kind not in get_args(Kind):
            raise ConfigError(f"kind: expected {', '.join(get_args(Kind))}, got {kind!r}")

        def one(k: int) -> Any:
            s, l = (int(i) for i in rows[k])
            if kind == "echogram":
                return self.echogram(s, l, emit[k])
            if kind == "ambisonic":
                return self.ambisonic(s, l, rate, source=emit[k])
            if kind == "monaural":
                return self.monaural(s, l, rate, source=emit[k])
            return self.binaural(s, l, float(turns[k]), rate, source=emit[k])

        with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
            found = list(pool.map(one, range(len(rows))))
        if kind == "echogram":
            return found, np.array([len(e.energy) for e in found])
        return sampling.pad(found, _CHANNELS[kind])

    def sample(self, count: int, seed: int = 0, **limits: tuple[float, float]) -> np.ndarray:
        """(count, 2) random pairs, the same for the same seed. `limits`: ranges of columns of `table`,
        e.g. ``distance=(1.0, 5.0)``, ``visible=(1, 1)``, ``geodesic=(0, 20)``, ``collocated=(0, 0)``.

        Raises `ConfigError` if no pair is within the limits.
        """
        if not limits:
            return np.random.default_rng(seed).integers(0, len(self.points), (count, 2))
        return sampling.draw_pairs(self.table(collocated=True), count, seed, limits, str(self.path))

    def nearest(self, position: ArrayLike) -> int:
        """The point nearest to a position (3,) in m."""
        return sampling.nearest(self.points, position)

    @overload
    def table(self, pandas: Literal[False] = False, *, collocated: bool = False) -> np.ndarray: ...
    @overload
    def table(self, pandas: Literal[True], *, collocated: bool = False) -> pandas.DataFrame: ...
    def table(self, pandas: bool = False, *, collocated: bool = False) -> np.ndarray | pandas.DataFrame:
        """One row per pair of two points, by source and listener; `columns` says what is in it. A structured array,
        or with `pandas` (extra ``pandas``) a data frame with the same columns, and `columns` in its ``attrs``.

        `collocated`: also the pairs whose source and listener are one point (column ``collocated``). Their direct
        sound is that of `simulation.least_distance`, 5 cm, so that they do not belong in averages over a room.
        """
        form: Literal["echogram", "waveform"] = (
            "echogram" if self._shards.has("echogram") else "waveform"
        )
        rows = join_tables(self._shards.of_every_shard(form, shard_table), collocated)
        return as_frame(rows, self.columns()) if pandas else rows

    def columns(self) -> Metadata:
        """Of each column of `table`: ``unit``, ``description``, and of a column per band ``band_hz``, its edges."""
        return column_metadata(self.manifest.config.simulation.bands)

    def graph(self) -> networkx.Graph:
        """The walking graph: nodes are rows of `points`."""
        found = self.manifest
        edges = np.array(found.edges, np.int64).reshape(-1, 2)
        walk = WalkGraph(np.array(found.nodes, int), edges, np.array(found.components), np.empty((0, 0)))
        return to_networkx(walk, self.points)

    # Sound

    def render(
        self,
        audio: ArrayLike,
        s: int,
        l: int,
        /,
        heading_deg: float = 0.0,
        *,
        source: Directivity | str | None = None,
    ) -> np.ndarray:
        """(2, n) float32: a dry mono signal (m,) at the dataset's rate, as heard at the listener."""
        from soundspaces_sim.dataset import sound

        return sound.render(self.binaurals, audio, s, l, heading_deg, source)

    def mix(self, sounds: Sequence[sound.Sound], listener: int, heading_deg: float = 0.0) -> np.ndarray:
        """(2, n) float32: several dry mono signals at once, each (signal, source) or (signal, source,
        directivity)."""
        from soundspaces_sim.dataset import sound

        return sound.mix(self.binaurals, sounds, listener, heading_deg)

    def render_path(
        self,
        audio: ArrayLike,
        sources: ArrayLike,
        listeners: ArrayLike,
        orientations_deg: ArrayLike = (0.0, 0.0, 0.0),
        *,
        source: Directivity | str | Sequence[Directivity | str | None] | None = None,
    ) -> np.ndarray:
        """(2, n) float32: a dry sound whose source, whose listener, or both move.

        In metres: rows (t, x, y, z), at rest before and after, no farther from the points than these are from
        each other; direct sound and early reflections change their pitch as they do in air. The other end may
        be such a way, a point or points. `orientations_deg` (k, 3) turns the head, at even times.

        By points at even times, cross-faded: one of `sources` and `listeners` is a sequence of them, the other
        one point; or both are one point and `orientations_deg` turns the head, or k directivities the source.
        Raises `PointError`, `ConfigError`.
        """
        from soundspaces_sim.dataset import moving

        if moving.in_metres(sources) or moving.in_metres(listeners):
            return moving.render_path(self, audio, sources, listeners, orientations_deg, source)
        from soundspaces_sim.dataset import sound

        return sound.render_path(self.binaurals, audio, sources, listeners, orientations_deg, source)

    def spectrogram(
        self,
        audio: ArrayLike,
        s: int,
        l: int,
        /,
        heading_deg: float = 0.0,
        *,
        source: Directivity | str | None = None,
    ) -> np.ndarray:
        """(65, frames, 2): `auralise.spectrogram` of `render`, as long as the dry sound."""
        from soundspaces_sim.dataset import sound

        return sound.spectrogram(self.binaurals, audio, s, l, heading_deg, self.rate, source)

    # Files

    def _asked(self, s: int, l: int, rate: int | None) -> tuple[int, int, int]:
        """Source, listener and rate of what is asked for. Raises `PairIndexError`, `ConfigError`."""
        s, l = self._check(s, "source"), self._check(l, "listener")
        return s, l, self.rate if rate is None else check_rate(rate)

    def _check(self, point: SupportsIndex, what: str) -> int:
        try:
            row = index(point)
        except TypeError:
            raise PairIndexError(f"{what}: expected the number of a point, got {point!r}") from None
        if not 0 <= row < len(self.points):
            raise PairIndexError(
                f"{what} {row} is out of range: {self.path} has points 0 to {len(self.points) - 1}"
            )
        return row

    def _stored(self, rate: int) -> bool:
        """Whether waveforms are to be read, not made. Raises if they alone are stored, at another rate."""
        if not self._shards.has("waveform"):
            return False
        stored = self.manifest.config.dataset.rate
        if rate != stored and not self._shards.has("echogram"):
            raise DatasetError(
                f"{self.path} stores waveforms at {stored} Hz alone, {rate} Hz was asked for; resample them, "
                "or build the dataset with STORE=both"
            )
        return rate == stored and self.renderer == self.manifest.config.dataset.renderer


def open_dataset(
    path: str | Path,
    rate: int | None = None,
    hrtf: str | Path | Ears | None = None,
    renderer: str | None = None,
) -> RirDataset:
    """Open a dataset made by `make rirs`; `rate` in Hz and `renderer` (a name of `rendering.renderers`) override
    those it was made for. `hrtf`: whose ears hear it, a SOFA file or `Ears`. A URL (``https://…``, ``s3://…``,
    ``hf://…``, extra ``remote``) is read as a folder: see `dataset.remote`.

    Raises `DatasetError` if there is none, it is unfinished, or of another version.
    """
    return RirDataset(path, rate, hrtf, renderer)
