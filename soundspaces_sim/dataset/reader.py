"""The reader of datasets: `open_dataset(path)`, and then any pair as echogram, ambisonic or binaural response.

Echograms become waveforms when they are read, deterministically: noise is seeded by (dataset seed, source,
listener). Stored waveforms are returned where their rate, renderer and headings are those asked for.

Safe in threads and in forked or spawned workers: a pickle is a path and settings, and every process opens its own
files. Reading echograms or tables imports neither the renderer nor the tracer.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex, get_args, overload

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import ConfigError, PairIndexError
from soundspaces_sim.core.numerics.axes import check_degrees
from soundspaces_sim.dataset import representation, room_parameters, sampling
from soundspaces_sim.dataset.format.table import Metadata, as_frame, column_metadata
from soundspaces_sim.dataset.materials import ChangeableMaterials, spread_metadata, with_spreads
from soundspaces_sim.dataset.pair_reader import PairReader
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.material_spread import measure_spread
from soundspaces_sim.echogram.measure_names import MEASURES
from soundspaces_sim.echogram.refurnish import Materials
from soundspaces_sim.layout.records import WalkGraph, to_networkx

if TYPE_CHECKING:
    import networkx
    import pandas

    from soundspaces_sim.dataset.room_parameters.office import OfficeParameters
    from soundspaces_sim.dataset.room_parameters.table import ParameterTable
    from soundspaces_sim.echogram.endpoints import Directivity
    from soundspaces_sim.echogram.parameters.speech import Speech
    from soundspaces_sim.rendering.ears import Ears

    #: Signal, source, and how that emits.
    Sound = tuple[ArrayLike, int] | tuple[ArrayLike, int, Directivity | str | None]

Kind = Literal["binaural", "ambisonic", "monaural", "echogram"]
_CHANNELS = {"binaural": 2, "ambisonic": 9, "monaural": 1}


class RirDataset(PairReader):
    """Room impulse responses between all points of a scene: a resource that opens files lazily.

    `points` (N, 3) m; `rate` Hz; `len(ds)` pairs. Sources and listeners are rows of `points`. `hrtf`: path of a
    SOFA file for binaural responses, KEMAR by default, or `Ears`; `renderer`: see `rendering.renderers`.

    `source` in the methods below: a directivity in world axes, ``ss.Talker(heading_deg=90.0)``, or its name;
    None is omnidirectional. It needs echograms, and reads those of the way back.
    """

    def __init__(
        self,
        path: str | Path,
        rate: int | None = None,
        hrtf: str | Path | Ears | None = None,
        renderer: str | None = None,
        materials: Materials | None = None,
        force: bool = False,
    ) -> None:
        self._given, self.chosen_materials, self._force = path, materials, force
        super().__init__(path, rate, hrtf, renderer, materials, force)
        self.scene = self.manifest.scene

    def __repr__(self) -> str:
        return representation.text(self)

    def _repr_html_(self) -> str:
        return representation.picture(self)

    def __len__(self) -> int:
        return len(self.points) ** 2

    def __getitem__(self, pair: tuple[SupportsIndex, SupportsIndex]) -> Echogram:
        """`ds[source, listener]` is `ds.echogram(source, listener)`."""
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise PairIndexError(f"expected ds[source, listener], got ds[{pair!r}]")
        return self._stored.echogram(*pair)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Every (source, listener)."""
        n = len(self.points)
        return ((s, l) for s in range(n) for l in range(n))

    def __getstate__(self) -> dict[str, Any]:
        settings = {"rate": self.rate, "hrtf": self.hrtf, "renderer": self.renderer}
        chosen = {"materials": self.chosen_materials, "force": self._force}
        return {"path": self._given, **settings, **chosen}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def __enter__(self) -> RirDataset:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; the next read opens them again."""
        self._stored.close()

    @property
    def materials(self) -> ChangeableMaterials:
        """The materials whose absorption `open_dataset(…, materials=…)` can change: their share of reflections, and
        the range in which each may move."""
        return self._stored.materials

    def material_spread(self, s: int, l: int) -> dict[str, np.ndarray]:
        """By room measure (``t30``, ``c80``, …) the standard deviations (bands,) that come of what laboratories
        differ by that measure absorption (ISO 12999-2), to first order, independent between the counted materials.
        Raises `PairIndexError`, `DatasetError` without counts."""
        found = measure_spread(self._stored.counted(s, l))
        return dict(zip(MEASURES, found, strict=True))

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
        """One row per pair of two points, by source and listener; `columns` says what is in it. A structured
        array, or with `pandas` (extra ``pandas``) a data frame with the same columns, and `columns` in its
        ``attrs``.

        `collocated`: also the pairs whose source and listener are one point (column ``collocated``). Their direct
        sound is that of `simulation.least_distance`, 5 cm, so that they do not belong in averages over a room.
        """
        rows = self._stored.table(collocated)
        return as_frame(rows, self.columns()) if pandas else rows

    def columns(self, spreads: bool = False) -> Metadata:
        """Of each column of `table`: ``unit``, ``description``, and of a column per band ``band_hz``, its
        edges."""
        found = column_metadata(self.manifest.config.simulation.bands)
        return {**found, **spread_metadata(found)} if spreads else found

    def with_spreads(self, rows: np.ndarray) -> np.ndarray:
        """Rows of `table` with columns ``t30_spread_0`` …, `material_spread` of each, in some tenth of a second a
        pair. `columns(spreads=True)` explains them."""
        return with_spreads(rows, len(self.manifest.config.simulation.bands) - 1, self.material_spread)

    def parameters(
        self,
        names: str | Sequence[str] | None = None,
        bands: str | Sequence[float] = "octaves",
        pairs: ArrayLike | None = None,
        *,
        speech: Speech | None = None,
        source: Directivity | str | None = None,
        waves: bool = False,
        progress: Callable[[int, int], None] | None = None,
    ) -> ParameterTable:
        """Room-acoustic parameters (ISO 3382-1, IEC 60268-16) of (k, 2) `pairs`, by default all of two points,
        each with its standard error and what it may be off for the course within simulated bands.

        `names`: of `room_parameters.registry.PARAMETERS`, by default all; `bands`: ``octaves``, ``thirds``,
        ``stored``, or edges in Hz; `speech` and noise are for the speech transmission index. With `waves`, measures
        of decay and clarity in bands below the edge of waves are those of `low`, of which no error is known
        (`soundspaces_sim.low_measures` finds them). `progress` is told of pairs done, of how many. Raises
        `ConfigError`, `PairIndexError`, `DatasetError`.
        """
        hrtf = self.hrtf if self.hrtf is None or isinstance(self.hrtf, str | Path) else self.hrtf.hrtf
        directed = None if source is None else lambda s, l: self.echogram(s, l, source)
        of_dataset = room_parameters.dataset_parameters
        return of_dataset(self._stored, names, bands, pairs, speech, hrtf, directed, waves, progress)

    def office(
        self, source: int, listeners: ArrayLike, noise_db: Sequence[float] | None = None
    ) -> OfficeParameters:
        """Single numbers of an open-plan office (ISO 3382-3): of a source and at least four listeners along a
        line, 2 to 16 m away. `noise_db`: seven levels of background noise, octaves from 125 Hz to 8 kHz;
        without it the distances of distraction and privacy are those of a silent office. Raises `ConfigError`,
        `PairIndexError`."""
        return room_parameters.dataset_office(self._stored, source, listeners, noise_db)

    def graph(self) -> networkx.Graph:
        """The navigation graph: nodes are rows of `points`."""
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
        response = self.binaural(s, l, heading_deg, source=source)
        return self._rendering(self.rate).convolve(audio, response)

    def mix(self, sounds: Sequence[Sound], listener: int, heading_deg: float = 0.0) -> np.ndarray:
        """(2, n) float32: several dry mono signals at once, each (signal, source) or (signal, source,
        directivity)."""
        if not sounds or any(len(sound) not in (2, 3) for sound in sounds):
            raise ConfigError(
                "sounds: expected at least one (signal, source) or (signal, source, directivity)"
            )
        heard = [
            self.render(audio, s, listener, heading_deg, source=emits[0] if emits else None)
            for audio, s, *emits in sounds
        ]
        return self._rendering(self.rate).mix(heard)

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
        rendering = self._rendering(self.rate)
        if sampling.in_metres(sources) or sampling.in_metres(listeners):
            if len(self.points) < 2:
                raise PairIndexError(f"{self.path} has one point: nothing moves in it")
            end = np.size(audio) / self.rate
            return rendering.moving(
                audio,
                sampling.as_way_rows(sources, "sources", self.points, end),
                sampling.as_way_rows(listeners, "listeners", self.points, end),
                orientations_deg,
                source,
                points=self.points,
                echogram=self._stored.echogram,
                duration=self.manifest.duration,
                least_distance=self.manifest.config.simulation.least_distance,
            )
        dry = rendering.dry(audio)
        steps, moves = sampling.path_steps(sources, listeners, orientations_deg, source)
        responses = [
            self.binaurals(p.source, p.listener, [p.orientation_deg], source=p.directivity)[0]
            for p in steps
        ]
        return rendering.cross_fade(dry, responses, moves)

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
        response = self.binaural(s, l, heading_deg, source=source)
        return self._rendering(self.rate).spectrogram(audio, response)


def open_dataset(
    path: str | Path,
    rate: int | None = None,
    hrtf: str | Path | Ears | None = None,
    renderer: str | None = None,
    *,
    materials: Materials | None = None,
    force: bool = False,
) -> RirDataset:
    """Open a dataset made by `make rirs`; `rate` in Hz and `renderer` (a name of `rendering.renderers`) override
    those of the dataset. `hrtf`: the path of a SOFA file, or `Ears`. A URL (``https://…``, ``s3://…``,
    ``hf://…``, extra ``remote``) is read as a folder: see `dataset.remote`.

    `materials`: other absorption of some materials, for datasets made with `[simulation.materials]`:
    ``{"carpet": 0.6}``, one value per band, ``{"carpet": {125: 0.1, 1000: 0.4}}``, or a `MaterialTable`. Echograms,
    waveforms and the table follow; error bars hold what that may be off by. `ds.materials` says what can change and
    how far; beyond it `force`.

    Raises `DatasetError` if there is none, it is unfinished, of another version, or without counts for `materials`;
    `MaterialError` for materials that were not counted and changes that are too large.
    """
    return RirDataset(path, rate, hrtf, renderer, materials, force)
