"""The reader of datasets: `open_dataset(path)`, and then any pair as echogram, ambisonic or binaural response.

Echograms become waveforms when they are read, deterministically: noise is seeded by (dataset seed, source,
listener). Stored waveforms are returned where their rate, renderer and headings are those asked for.

Safe in threads and in forked or spawned workers: a pickle is a path and settings, and every process opens its own
files. Reading echograms or tables imports neither the renderer nor the tracer.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex, get_args, overload

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim import rendering
from soundspaces_sim.core.config import SimulationConfig, check_rate
from soundspaces_sim.core.errors import ConfigError, DatasetError, PairIndexError
from soundspaces_sim.core.io.untrusted import parse_json
from soundspaces_sim.core.numerics.axes import check_degrees, check_head
from soundspaces_sim.core.numerics.threads import core_count, renderer_count
from soundspaces_sim.core.registry import Entry, of_neighbour
from soundspaces_sim.core.simulation_config import without_constants
from soundspaces_sim.core.svg import BLUE, GREY, Dots, Layer, Lines, html, svg
from soundspaces_sim.dataset import sampling
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.floorplan import read_floorplan
from soundspaces_sim.dataset.format.manifest import Manifest
from soundspaces_sim.dataset.format.table import Metadata, as_frame, column_metadata
from soundspaces_sim.dataset.materials import ChangeableMaterials, spread_metadata, with_spreads
from soundspaces_sim.dataset.stored import StoredResponses
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.low_response import LowResponse
from soundspaces_sim.echogram.material_spread import measure_spread
from soundspaces_sim.echogram.measure_names import MEASURES
from soundspaces_sim.echogram.refurnish import Materials
from soundspaces_sim.layout.records import WalkGraph, storeys_of, to_networkx
from soundspaces_sim.rendering.renderers import check_renderer

if TYPE_CHECKING:
    import networkx
    import pandas

    from soundspaces_sim.echogram.endpoints import Directivity
    from soundspaces_sim.rendering.ears import Ears
    from soundspaces_sim.rendering.microphones import MicrophoneArray
    from soundspaces_sim.rendering.rendering import Rendering

    Sound = tuple[ArrayLike, int] | tuple[ArrayLike, int, Directivity | str | None]


_log = logging.getLogger(__name__)
_PARAMETERS = Entry("soundspaces_parameters:dataset_parameters", "parameters of ISO 3382", "parameters")
_OFFICE = Entry("soundspaces_parameters:dataset_office", "parameters of an office", "parameters")

Kind = Literal["binaural", "ambisonic", "monaural", "echogram"]
_CHANNELS = {"binaural": 2, "ambisonic": 9, "monaural": 1}


class RirDataset:
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
        self._stored = StoredResponses(path, materials, force)
        self.path = self._stored.path
        self.manifest: Manifest = self._stored.manifest
        self.points = self._stored.points
        own = self.manifest.config.dataset
        self.rate = own.rate if rate is None else check_rate(rate)
        self.hrtf, self.renderer = hrtf, own.renderer if renderer is None else renderer
        if renderer is not None:
            check_renderer(renderer)
        if not (hrtf is None or isinstance(hrtf, str | Path)):
            self._rendering(self.rate)  # raises `ConfigError` for other ears
        self.scene = self.manifest.scene

    def __repr__(self) -> str:
        """Points, pairs, lengths, what is stored, and how much it is."""
        found = self.manifest
        forms = " and ".join(f"{form}s" for form in sorted({e.form for e in found.shards}))
        size = sum(e.bytes for e in found.shards)
        bands = len(found.config.simulation.bands) - 1
        return (
            f"RirDataset({str(self.path)!r}): {len(self):,} pairs of {len(self.points):,} points in "
            f"'{self.scene}', {found.duration:g} s each\n  {forms}, {bands} bands, rendered at {self.rate:,} Hz, "
            f"{size / 1e6:.1f} MB"
        )

    def _repr_html_(self) -> str:
        """The text above the floor plan of the lowest storey, its points and navigation graph."""
        try:
            plan = read_floorplan(self.path)
            lowest = storeys_of(plan, self.points) == 0
            walls: list[Layer] = [Lines(plan.walls[0], GREY, 1.2)]
        except DatasetError as error:  # it was not copied with the rest
            _log.debug("%s", error)
            lowest, walls = np.ones(len(self.points), bool), []
        edges = np.array(self.manifest.edges, int).reshape(-1, 2)
        edges = edges[lowest[edges].all(axis=1)]
        layers: list[Layer] = [
            *walls,
            Lines(self.points[edges][:, :, :2].reshape(-1, 4), BLUE, 0.6),
            Dots(self.points[lowest, :2], BLUE, 1.8),
        ]
        return html(repr(self), svg(layers))

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

    # One pair

    def _rendering(self, rate: int) -> Rendering:
        """What makes signals of echograms: the one place that imports the renderer."""
        config = self.manifest.config
        return rendering.Rendering(
            rate, self.renderer, self.hrtf, config.dataset.seed, config.simulation.c
        )

    def echogram(
        self,
        s: int,
        l: int,
        /,
        source: Directivity | str | None = None,
        listener: Directivity | str | None = None,
        *,
        materials: Materials | None = None,
        force: bool = False,
    ) -> Echogram:
        """Energy against delay, per band, from point `s` to point `l`; with a `source` or a `listener` that is
        directive, see `directed.directed`; with `materials`, as `open_dataset` takes them, for this pair alone.
        Raises `PairIndexError`, `DatasetError`, `MaterialError`."""
        echogram = self._stored.echogram(s, l, materials, force)
        if source is None and listener is None:
            return echogram
        back = None if source is None else self._stored.echogram(l, s, materials, force)
        return self._rendering(self.rate).directed(echogram, back, source, listener)

    def low(self, s: int, l: int, /) -> LowResponse:
        """Pressure and velocity from point `s` to point `l` below an edge, as simulated with waves
        (`[simulation.low]`). Raises `PairIndexError`, `DatasetError` without waves."""
        return self._stored.low(s, l)

    @property
    def stored(self) -> StoredResponses:
        """What the files hold."""
        return self._stored

    def counted(self, s: int, l: int, /) -> Echogram:
        """The echogram from point `s` to point `l` as simulated, with its counts of reflections. Raises
        `PairIndexError`, `DatasetError` without counts."""
        return self._stored.counted(s, l)

    def ambisonic(
        self,
        s: int,
        l: int,
        /,
        rate: int | None = None,
        *,
        source: Directivity | str | None = None,
        order: int = 2,
    ) -> np.ndarray:
        """((order + 1)², n) float32 response, ACN/SN3D, world axes: (9, n), or of `order` 3 to 7, whose
        reverberation no renderer changes (`rendering.higher_orders`). Raises `ConfigError`."""
        s, l, rate = self._asked(s, l, rate)
        if order != 2:
            return self._rendering(rate).ambisonic_of_order(self.echogram(s, l, source), order, s, l)
        if source is None and self._stored.has_waveforms(rate, self.renderer):
            return self._stored.ambisonic(s, l)
        return self._rendering(rate).ambisonic(self.echogram(s, l, source), s, l)

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
        return self._rendering(rate).ambisonic(self.echogram(s, l, source, listener), s, l)[:1]

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
        return self._rendering(rate).microphones(self.echogram(s, l, source), array, s, l)

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
        head = check_head(heading_deg, pitch_deg, roll_deg)
        return self.binaurals(s, l, [head], rate, source=source)[0]

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
        s, l, rate = self._asked(s, l, rate)
        turns = check_degrees(orientations_deg, "heading, pitch and roll").reshape(-1, 3)
        stored = source is None and self._stored.has_waveforms(rate, self.renderer)
        level = not turns[:, 1:].any()
        headings = self.manifest.config.dataset.headings
        if stored and self.hrtf is None and level and all(h % 360.0 in headings for h in turns[:, 0]):
            return self._stored.binaural(s, l, turns[:, 0])
        made = self._rendering(rate)
        if stored and made.decodes:
            return made.decoded(self._stored.ambisonic(s, l), turns)
        return made.binaural(self.echogram(s, l, source), s, l, turns)

    def rendered(
        self, echogram: Echogram, s: int, l: int, heading_deg: float | None = None
    ) -> np.ndarray:
        """(9, n) float32 response of an `echogram` from point `s` to point `l`; (2, n) at a head with a heading."""
        made = self._rendering(self.rate)
        if heading_deg is None:
            return made.ambisonic(echogram, s, l)
        turns = check_degrees([(heading_deg, 0.0, 0.0)], "heading, pitch and roll").reshape(-1, 3)
        return made.binaural(echogram, s, l, turns)[0]

    def _asked(self, s: int, l: int, rate: int | None) -> tuple[int, int, int]:
        """Source, listener and rate of what is asked for. Raises `PairIndexError`, `ConfigError`."""
        s, l = self._stored.row(s, "source"), self._stored.row(l, "listener")
        return s, l, self.rate if rate is None else check_rate(rate)

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
        """Responses of (k, 2) pairs, made in `workers` threads (one per core, at most four): (k, channels, n)
        float32, padded with zeros, and their lengths (k,). For ``echogram`` a list, and numbers of bins.

        `headings_deg`: one, or (k,). `source`: one directivity, or k.
        """
        rows = sampling.as_pairs(pairs)
        turns = np.broadcast_to(check_degrees(headings_deg, "headings_deg"), len(rows))
        emit = sampling.for_each(source, len(rows))
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

        with ThreadPoolExecutor(workers or renderer_count(core_count())) as pool:
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
        sound is that of 5 cm, so that they do not belong in averages over a room.
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
        speech: Any = None,
        source: Directivity | str | None = None,
        waves: bool = False,
        progress: Callable[[int, int], None] | None = None,
    ) -> Any:
        """Room-acoustic parameters (ISO 3382-1, IEC 60268-16) of (k, 2) `pairs`, by default all of two points,
        each with its standard error and what it may be off for the course within simulated bands: a
        `soundspaces_parameters.ParameterTable` (neighbours/parameters).

        `names`: of `soundspaces_parameters.PARAMETERS`, by default all; `bands`: ``octaves``, ``thirds``,
        ``stored``, or edges in Hz; `speech`: a `soundspaces_parameters.Speech`, for the speech transmission
        index. With `waves`, measures of decay and clarity in bands below the edge of waves are those of `low`,
        of which no error is known. `progress` is told of pairs done, of how many. Raises
        `ConfigError`, `PairIndexError`, `DatasetError`.
        """
        hrtf = self.hrtf if self.hrtf is None or isinstance(self.hrtf, str | Path) else self.hrtf.hrtf
        directed = None if source is None else lambda s, l: self.echogram(s, l, source)
        of_dataset = of_neighbour("parameters of ISO 3382", _PARAMETERS)
        return of_dataset(self._stored, names, bands, pairs, speech, hrtf, directed, waves, progress)

    def office(self, source: int, listeners: ArrayLike, noise_db: Sequence[float] | None = None) -> Any:
        """Single numbers of an open-plan office (ISO 3382-3): of a source and at least four listeners along a
        line, 2 to 16 m away. `noise_db`: seven levels of background noise, octaves from 125 Hz to 8 kHz;
        without it the distances of distraction and privacy are those of a silent office. Raises `ConfigError`,
        `PairIndexError`. A `soundspaces_parameters.OfficeParameters` (neighbours/parameters)."""
        of_dataset = of_neighbour("parameters of an office", _OFFICE)
        return of_dataset(self._stored, source, listeners, noise_db)

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
        made = self._rendering(self.rate)
        if sampling.in_metres(sources) or sampling.in_metres(listeners):
            if len(self.points) < 2:
                raise PairIndexError(f"{self.path} has one point: nothing moves in it")
            end = np.size(audio) / self.rate
            return made.moving(
                audio,
                sampling.as_way_rows(sources, "sources", self.points, end),
                sampling.as_way_rows(listeners, "listeners", self.points, end),
                orientations_deg,
                source,
                points=self.points,
                echogram=self._stored.echogram,
                duration=self.manifest.duration,
            )
        dry = made.dry(audio)
        steps, moves = sampling.path_steps(sources, listeners, orientations_deg, source)
        responses = [
            self.binaurals(p.source, p.listener, [p.orientation_deg], source=p.directivity)[0]
            for p in steps
        ]
        return made.cross_fade(dry, responses, moves)

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
    ``hf://…``) is read as a folder, by neighbours/remote.

    `materials`: other absorption of some materials, for datasets made with `[simulation.materials]`:
    ``{"carpet": 0.6}``, one value per band, ``{"carpet": {125: 0.1, 1000: 0.4}}``, or a `MaterialTable`. Echograms,
    waveforms and the table follow; error bars hold what that may be off by. `ds.materials` says what can change and
    how far; beyond it `force`.

    Raises `DatasetError` if there is none, it is unfinished, of another version, or without counts for `materials`;
    `MaterialError` for materials that were not counted and changes that are too large.
    """
    return RirDataset(path, rate, hrtf, renderer, materials, force)


def read_room(path: str | Path) -> list[list[Echogram]]:
    """The echograms of a room, a list for each source with one for each listener. Raises `DatasetError`."""
    with closing(EchogramShard(Path(path))) as plain:
        text = str(plain.attribute("config"))
    try:
        settings = parse_json(text, path, DatasetError, "room's settings")[2]
        config = msgspec.convert(without_constants(settings), SimulationConfig)
    except (msgspec.MsgspecError, ValueError, LookupError, TypeError, ConfigError) as error:
        raise DatasetError(f"{path}: its settings cannot be read ({error}); make it again") from error
    with closing(EchogramShard(Path(path), config.air)) as shard:
        sources, listeners = range(len(shard.sources)), range(len(shard.listeners))
        return [[shard.echogram(s, l) for l in listeners] for s in sources]
