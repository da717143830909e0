"""A scene that is simulated while one listens to it.

One pair of places at a time, that of the latest question, is estimated with few subpaths of its own at first and
with more of them step by step. Two threads work: one on the steps that take a second or less, so that a new place
is heard soon, one on those that take longer. Wherever the listener has walked to meanwhile, discrete arrivals are
solved for that very place, which takes no subpaths; only reverberation is then that of the place before. Other
absorption is read from the counts of reflections at once, and then simulated. On the first run, while kernels are
compiled, the first sound is direct sound and reverberation, without early reflections: their kernel takes longest.
"""

from __future__ import annotations

import logging
import math
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs
from soundspaces_parameters import room_parameters

from soundspaces_explorer.absorption import with_absorption
from soundspaces_sim import (
    Arrivals,
    ConfigError,
    DiffractionConfig,
    Echogram,
    Echograms,
    GridConfig,
    MaterialError,
    MaterialsConfig,
    PointError,
    RadianceTransferConfig,
    Scene,
    SimulationConfig,
    SoundSpacesSimError,
    ambisonic_rir,
    binaural_rir,
    make_grid,
    refurnished,
)
from soundspaces_sim.parts import (
    DIRECT_SOUND,
    TECHNIQUES,
    Geometry,
    SimulatedPaths,
    WarmUp,
    at_points,
    cast_ray,
    check_inside,
    direct_arrival,
    kernel,
    prepare_scene,
    simulate_pairs,
    simulate_tile,
)

_log = logging.getLogger(__name__)


class Step(NamedTuple):
    """An estimate: subpaths of a point, and whether scattered sound goes from patch to patch."""

    walks: int
    transfer: bool


#: The first is heard within a second; each later one has half the error of the one before, or less.
STEPS = (Step(256, False), Step(256, True), Step(1024, True), Step(4096, True), Step(16384, True))
_QUICK = 3  # of them are made by the first thread
_PREVIEW = -1  # step of what is heard while kernels are compiled
_PREVIEW_S = 1.0  # that it lasts: what measures how long sound lasts is not compiled yet
#: Of all that arrives discretely the direct sound alone.
_WITHOUT_ARRIVALS = (
    DIRECT_SOUND,
    *(t for t in TECHNIQUES if t.name not in ("arrivals", "radiance_transfer")),
)
_KEPT = 8  # estimates: A, B, and places that one comes back to
#: Of the points that tell where one can stand. A tenth of a job's rays changes fewer than 1 in 100 of them, and in
#: a scan saves two seconds before the page opens.
_GRID = GridConfig(spacing=0.5, rays=100)
_GROUPS = 12  # materials whose reflections are counted: the most there can be
_LOOKED_AT = 24  # places of a source to begin with
_ACROSS = 300  # cells of a storey seen from above, along its longer side
_LEAST_CELL = 0.02  # m
_TOUCHING = 1e-3  # m
_LEAST = 1e-3  # share that a surface reflects at least
_MEASURES = ("t30", "c50", "sti")

Chosen = tuple[tuple[str, tuple[float, ...]], ...]  # materials and their absorption in every band


class Question(NamedTuple):
    """Two places (3,) m, and absorption other than the table's."""

    source: tuple[float, float, float]
    listener: tuple[float, float, float]
    chosen: Chosen = ()


@dataclass(frozen=True)
class Estimate:
    """Of a question; `step` is the row of `STEPS`, or `_PREVIEW`."""

    question: Question
    step: int
    echoes: Echograms


@dataclass(frozen=True)
class Answer:
    """What is heard, and how well it is known. `version` grows with every estimate; `kind`: ``estimate``,
    ``preview`` (without early reflections), ``moved`` (arrivals are those of the place, reverberation is of one
    nearby) or ``counts`` (absorption read from counts). `measures`: (B, 2) values and standard errors, NaN where
    they are not known, of each; (1, 2) of sti."""

    echogram: Echogram
    kind: str
    step: int
    version: int
    done: bool
    measures: Mapping[str, np.ndarray]


class NotYetError(Exception):
    """There is nothing to be heard yet; the message says why."""


class LiveScene:
    """A scene, where one can stand in it, and the threads that simulate. Raises `SceneError`, `ConfigError`."""

    def __init__(
        self,
        scene: Scene,
        config: SimulationConfig | None = None,
        seed: int = 0,
        hrtf: str | Path | None = None,
        compiling: WarmUp | None = None,
    ) -> None:
        self.scene, self.seed, self._hrtf = scene, seed, hrtf
        self.config = config or SimulationConfig()
        if self.config.low.method != "rays":
            raise ConfigError("simulation.low: waves take minutes a point; explore with rays")
        self.grid = make_grid(scene, config=_GRID)
        self._worlds: OrderedDict[Chosen, _World] = OrderedDict()
        self._making = threading.Lock()
        self._paths_lock = threading.Lock()
        self._kept: OrderedDict[Question, Estimate] = OrderedDict()
        self._wanted: Question | None = None
        self._last: Estimate | None = None
        self._failed: dict[Question, SoundSpacesSimError] = {}
        self._version, self._closed = 0, False
        self._compiled = 1.0 if compiling is None else 0.0  # share
        self._first_kernels, self._kernels = threading.Event(), threading.Event()
        self._changed = threading.Condition()
        if compiling is not None:
            threading.Thread(target=self._wait_for_first, args=(compiling,), daemon=True).start()
        threading.Thread(target=self._compile, args=(compiling,), daemon=True).start()
        for steps in (range(_PREVIEW, _QUICK), range(_QUICK, len(STEPS))):
            threading.Thread(target=self._work, args=(steps,), daemon=True).start()

    @property
    def bands(self) -> tuple[float, ...]:
        """Edges, Hz."""
        return self.config.bands

    def _compile(self, compiling: WarmUp | None) -> None:
        """Wait for the kernels, once per installation, while the page shows the plan."""

        def tell(done: int, total: int) -> None:
            self._compiled = done / total

        if compiling is not None:
            compiling.wait(tell)
        self._reached(self._kernels)

    def _wait_for_first(self, compiling: WarmUp) -> None:
        compiling.wait_for_first()
        self._reached(self._first_kernels)

    def _reached(self, event: threading.Event) -> None:
        with self._changed:
            event.set()
            self._changed.notify_all()

    @property
    def compiling(self) -> str | None:
        """What to tell of kernels that are compiled; None if all are there."""
        if self._kernels.is_set():
            return None
        return f"Compiling, once per installation: {100.0 * self._compiled:.0f} % …"

    def warm_up(self, rate: int) -> None:
        """Make the first estimate, and load what renders it, while a browser opens."""
        binaural_rir(np.zeros((9, 64), np.float32), rate)  # needs no kernels
        source, listener, storey = self.first_places()
        there, here = (
            self.place(round(float(p[0]), 3), round(float(p[1]), 3), storey) for p in (source, listener)
        )
        try:
            answer = self._first_answer(Question(there, here))
        except SoundSpacesSimError as error:
            _log.warning("%s", error)
            return
        if answer is None:
            return
        self.ears(answer, 0.0, rate)
        counts = answer.echogram.counts
        if counts is not None and counts.groups.names:
            _refurnished(answer.echogram, {counts.groups.names[0]: counts.groups.absorption[0]})

    def _first_answer(self, question: Question) -> Answer | None:
        """As soon as there is one; None if something else has been asked by then, or the threads have ended."""
        while not self._closed and self._wanted in (None, question):
            try:
                return self.ask(question, wait_s=5.0)
            except NotYetError:
                continue
        return None

    def close(self) -> None:
        """Let the threads end with what they are at."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    # ---- places ----

    def place(self, x: float, y: float, storey: int) -> tuple[float, float, float]:
        """A place at (x, y) of a storey, at the height of the points around. Raises `PointError` where there is no
        floor."""
        points = self.grid.points[self.grid.storey == storey]
        if len(points) == 0:
            raise PointError(f"storey {storey}: there is none; the scene has {len(self.grid.floors)}")
        away = np.hypot(points[:, 0] - x, points[:, 1] - y)
        if not away.min() <= 2.0 * self.grid.spacing:
            raise PointError(f"({x:.2f}, {y:.2f}) m: nobody can stand here; choose a place on the floor")
        return float(x), float(y), float(points[int(away.argmin()), 2])

    def first_places(self) -> tuple[np.ndarray, np.ndarray, int]:
        """(3,) source, listener, and storey, to begin with: points some 3 m apart, the listener near the middle of
        the storey with most points, in sight of each other if there are such nearby."""
        storey = int(np.bincount(self.grid.storey).argmax())
        points = self.grid.points[self.grid.storey == storey]
        middle = points[np.linalg.norm(points - points.mean(axis=0), axis=1).argmin()]
        away = np.linalg.norm(points - middle, axis=1)
        order = np.argsort(np.abs(away - 3.0), kind="stable")[:_LOOKED_AT]
        way = middle - points[order]
        length = np.maximum(np.linalg.norm(way, axis=1), _TOUCHING)
        triangle, _ = self._look(points[order], way / length[:, None], length)
        return points[order[int(np.argmax(triangle < 0))]], middle, storey

    def from_above(self, storey: int) -> tuple[float, np.ndarray, np.ndarray]:
        """A storey as one sees it when one looks down from the height of the points: side of a square cell, m; rows
        of materials in cells (Y, X) from the lowest corner of the scene on; their height above the storey's floor,
        m. Where nothing is met they are -1 and NaN. Raises `PointError`."""
        if not 0 <= storey < len(self.grid.floors):
            raise PointError(f"storey {storey}: there is none; the scene has {len(self.grid.floors)}")
        low, high = self.scene.bounds
        top = float(self.grid.floors[storey]) + self.grid.height
        cell = max(float((high - low)[:2].max()) / _ACROSS, _LEAST_CELL)
        x, y = (low[k] + cell * (0.5 + np.arange(math.ceil((high - low)[k] / cell))) for k in (0, 1))
        at = np.stack(np.broadcast_arrays(x, y[:, None], top), axis=-1).reshape(-1, 3)
        reach = np.full(len(at), max(top - float(low[2]), 0.0) + _TOUCHING)
        triangle, distance = self._look(at, np.tile([0.0, 0.0, -1.0], (len(at), 1)), reach)
        material = np.where(triangle < 0, -1, self.scene.face_material[triangle])
        height = np.where(triangle < 0, np.nan, self.grid.height - distance)
        return cell, material.reshape(len(y), len(x)), height.reshape(len(y), len(x))

    def _look(
        self, points: np.ndarray, ways: np.ndarray, reach: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(n,) the triangle that is met first from each point along a unit vector within so many m, or -1, and how
        far away it is."""
        triangle, distance = np.empty(len(points), np.int64), np.empty(len(points))
        from_center = points - self.scene.center
        _look_along(self.scene.geometry, from_center, ways, reach, triangle, distance)
        return triangle, distance

    # ---- questions ----

    def ask(self, question: Question, after: int = -1, wait_s: float = 10.0) -> Answer:
        """The best that is known now; with `after` a version, once there is a later one, or `wait_s` have passed.

        Raises `NotYetError`, `PointError`, `MaterialError`, and what the simulation of the question raised.
        """
        with self._changed:
            if question != self._wanted:
                self._check(question)
                self._failed.clear()
                self._wanted = question
                self._version += 1
                self._changed.notify_all()
            self._changed.wait_for(lambda: self._ready(question, after), wait_s)
            if question in self._failed:
                raise self._failed[question]
            best, version = self._best(question), self._version
        if best is None:
            raise NotYetError(self._why_not())
        return self._answer(question, best, version)

    def _why_not(self) -> str:
        return self.compiling or "Making the first estimate …"

    def _best(self, question: Question) -> Estimate | None:
        """The question's own estimate or, until that is as good, one of its places with other absorption, or else
        the latest of another place; None if there is none."""
        own = self._kept.get(question)
        if own is not None and own.step > 0:
            return own
        here = [e for e in self._kept.values() if e.question[:2] == question[:2] and e.step > 0]
        return max(here, key=lambda e: e.step, default=own or self._elsewhere)

    @property
    def _elsewhere(self) -> Estimate | None:
        """The latest of any places; None while nothing can be read for others from it."""
        return self._last if self._last is not None and self._last.step != _PREVIEW else None

    def _ready(self, question: Question, after: int) -> bool:
        known = question in self._kept or self._elsewhere is not None
        return self._closed or question in self._failed or (known and self._version > after)

    def _check(self, question: Question) -> None:
        for what, place in (("source", question.source), ("listener", question.listener)):
            check_inside(self.scene, np.array([place]), what)
        names = self.scene.materials.names
        for name, absorption in question.chosen:
            if name not in names:
                raise MaterialError(f"materials: there is no '{name}' in this scene")
            if len(absorption) != len(self.bands) - 1 or not all(0.0 <= a <= 1.0 for a in absorption):
                raise MaterialError(
                    f"materials: absorption of '{name}' must lie from 0 to 1 in every band"
                )

    def _answer(self, question: Question, best: Estimate, version: int) -> Answer:
        if best.question == question:
            kind, echogram = ("preview" if best.step == _PREVIEW else "estimate"), best.echoes[0, 0]
        else:
            kind = "counts" if best.question[:2] == question[:2] else "moved"
            echogram = self._read(best, question)
        done = best.question == question and best.step == len(STEPS) - 1
        parameters = room_parameters(
            best.echoes if kind == "estimate" else echogram, _MEASURES, "stored"
        )
        measures = {
            name: (parameters.single(name) if name == "sti" else parameters.values[name][0, :-1])[:, :2]
            for name in _MEASURES
        }
        return Answer(echogram, kind, best.step, version, done, measures)

    def _read(self, best: Estimate, question: Question) -> Echogram:
        """The estimate with the absorption and, of another place, the arrivals of a question."""
        echogram = _refurnished(best.echoes[0, 0], self._other(best, question))
        if best.question[:2] == question[:2]:
            return echogram
        with self._making:
            paths = self._world(question.chosen).paths
        source, listener = np.array(question.source), np.array(question.listener)
        with self._paths_lock:
            found = paths.between(source, listener)
        table, c = found.paths, self.config.c
        return replace(
            echogram,
            direct=direct_arrival(source - listener, found.distance, found.direct, c),
            early=Arrivals(
                table.length / c, table.energy, table.at_b, table.planes, table.kind, table.wedges
            ),
            visible=found.walls == 0,
        )

    def _other(self, best: Estimate, question: Question) -> dict[str, np.ndarray]:
        """Absorption by material, where the question's is not that of the estimate."""
        before, now = dict(best.question.chosen), dict(question.chosen)
        names = tuple(name for name in {**before, **now} if before.get(name) != now.get(name))
        table = dict(zip(names, self._table(names), strict=True))
        return {name: np.array(now.get(name, table[name])) for name in names}

    def _table(self, names: tuple[str, ...]) -> np.ndarray:
        """(M, B) absorption of the scene's own table."""
        absorption, _, _ = self.scene.materials.in_bands(self.bands)
        return absorption[[self.scene.materials.index(name) for name in names]]

    def ears(self, answer: Answer, heading_deg: float, rate: int) -> np.ndarray:
        """(2, n) float32 binaural response."""
        return binaural_rir(ambisonic_rir(answer.echogram, rate, self.seed), rate, heading_deg)

    # ---- work ----

    def _next(self, steps: range) -> tuple[Question, int] | None:
        """What is wanted next of some steps; None if nothing is."""
        question = self._wanted
        if question is None or question in self._failed:
            return None
        found = self._kept.get(question)
        if not self._kernels.is_set():
            step = _PREVIEW if found is None and self._first_kernels.is_set() else len(STEPS)
        else:
            step = 0 if found is None else found.step + 1
        return (question, step) if step in steps else None

    def _work(self, steps: range) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._next(steps) is not None)
                if self._closed:
                    return
                task = self._next(steps)
                assert task is not None
            question, step = task
            try:
                simulate = self._preview if step == _PREVIEW else self._simulate
                estimate = Estimate(question, step, simulate(question, step))
            except SoundSpacesSimError as error:
                with self._changed:
                    self._failed[question] = error
                    self._changed.notify_all()
                continue
            with self._changed:
                known = self._kept.get(question)
                if known is None or known.step < step:
                    self._kept[question] = estimate
                    self._kept.move_to_end(question)
                while len(self._kept) > _KEPT:
                    self._kept.popitem(last=False)
                if question == self._wanted or self._last is None:
                    self._last = estimate
                self._version += 1
                self._changed.notify_all()

    def _preview(self, question: Question, _: int) -> Echograms:
        """Direct sound and reverberation."""
        a, b = np.array([question.source]), np.array([question.listener])
        config = structs.replace(
            self.config,
            walks=STEPS[0].walks,
            target_error=None,
            duration=self.config.duration or _PREVIEW_S,
            radiance_transfer=RadianceTransferConfig(enabled=False),
            diffraction=DiffractionConfig(enabled=False),
        )
        prepared = prepare_scene(self._with(question.chosen), config)
        model = at_points(prepared, np.concatenate([a, b]), self.seed)
        return simulate_tile(model, a, b, both_ways=False, techniques=_WITHOUT_ARRIVALS)[0]

    def _with(self, chosen: Chosen) -> Scene:
        """The scene with some absorption."""
        if not chosen:
            return self.scene
        return with_absorption(self.scene, {n: np.array(a) for n, a in chosen}, self.bands)

    def _simulate(self, question: Question, step: int) -> Echograms:
        a, b = np.array([question.source]), np.array([question.listener])
        with self._making:
            world = self._world(question.chosen)
        model = world.model(step, np.concatenate([a, b]))
        return simulate_pairs(model, a, b, both_ways=False)[0]

    def _world(self, chosen: Chosen) -> _World:
        """The scene with some absorption, prepared."""
        if chosen not in self._worlds:
            self._worlds[chosen] = _World(self._with(chosen), self.config, self.seed)
            while len(self._worlds) > _KEPT:
                self._worlds.popitem(last=False)
        self._worlds.move_to_end(chosen)
        return self._worlds[chosen]


class _World:
    """A scene under the config, prepared for every step when it is first asked for. That takes seconds in a scan;
    paths between other places can be solved meanwhile."""

    def __init__(self, scene: Scene, config: SimulationConfig, seed: int) -> None:
        self.scene, self._config, self._seed = scene, config, seed
        self._models: dict[int, Any] = {}
        self._preparing = threading.Lock()
        self._duration: float | None = config.duration
        self.paths = SimulatedPaths(scene, config, seed)

    def model(self, step: int, points: np.ndarray) -> Any:
        """For an estimate; its echograms last as long as sound does at the first `points` that were asked for."""
        with self._preparing:
            return self._model(step, points)

    def _model(self, step: int, points: np.ndarray) -> Any:
        if step not in self._models:
            walks, transfer = STEPS[step]
            config = structs.replace(
                self._config,
                walks=walks,
                target_error=None,
                duration=self._duration,
                radiance_transfer=RadianceTransferConfig(
                    enabled=transfer and self._config.radiance_transfer.enabled, subpaths="own"
                ),
                materials=MaterialsConfig(enabled=True, groups=_GROUPS),
            )
            made = at_points(prepare_scene(self.scene, config), points, self._seed)
            self._models[step], self._duration = made, made.duration
        return self._models[step]


@kernel
def _look_along(
    geometry: Geometry,
    points: np.ndarray,
    ways: np.ndarray,
    reach: np.ndarray,
    triangle: np.ndarray,
    distance: np.ndarray,
) -> None:
    """What is met first from each of the points (n, 3), about the scene's centre, along a unit vector."""
    for k in range(len(points)):
        origin = points[k, 0], points[k, 1], points[k, 2]
        way = ways[k, 0], ways[k, 1], ways[k, 2]
        distance[k], triangle[k] = cast_ray(geometry, origin, way, reach[k])


def _refurnished(echogram: Echogram, other: Mapping[str, np.ndarray]) -> Echogram:
    """With other absorption of the materials whose reflections were counted; those of others stay until they are
    simulated. A material that transmits sound absorbs at most what is left."""
    counts = echogram.counts
    if counts is None:
        return echogram
    most = dict(zip(counts.groups.names, 1.0 - counts.groups.transmission - _LEAST, strict=True))
    within = {name: np.minimum(a, most[name]) for name, a in other.items() if name in most}
    return refurnished(echogram, within, force=True) if within else echogram
