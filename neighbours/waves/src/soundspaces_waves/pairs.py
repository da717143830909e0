"""Waves of the pairs of a model: one run per point, to which all others listen. What the entry point names.

A run's responses depend on its source and listener alone, whatever else is run with it. The pressure is reciprocal:
where both ways are there, they have to agree, and their mean is taken, so that it is the same for both to the bit.
"""

from __future__ import annotations

import logging
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from soundspaces_sim import Echograms, PointError, Scene, SimulationConfig, SimulationError
from soundspaces_sim.parts import (
    LOW_CHANNELS as CHANNELS,
    LowResponse,
    Model,
    PreparedScene,
    free_memory,
    profile_stage as stage,
    reserve_file,
    response_samples,
    thread_count,
)
from soundspaces_waves.lattice import make_lattice
from soundspaces_waves.placing import place_points
from soundspaces_waves.row_algebra import LANES
from soundspaces_waves.scheme import WaveScene, make_wave_scene
from soundspaces_waves.simulate import simulate_low
from soundspaces_waves.solve import solve

MEMORY = 1e9  # bytes of responses that are kept in memory
_SPARE = 2.0  # times what is written that must be free on the disk
_SAME = 1e-3  # of the largest pressure: by which both ways may differ
_log = logging.getLogger(__name__)


def low_edge(config: SimulationConfig) -> float:
    """Hz, up to which waves are simulated."""
    return config.bands[1] if config.low.edge is None else config.low.edge


def check_lattice(scene: Scene, config: SimulationConfig) -> None:
    """Raise `SimulationError` or `ConfigError` if waves would take too many cells, before any is made."""
    make_lattice(scene, config.c / (low_edge(config) * config.low.cells_per_wavelength))


def wave_scene(prepared: PreparedScene) -> WaveScene:
    """The lattice of a scene: to be made once."""
    low, config = prepared.config.low, prepared.config
    with stage("lattice"):
        return make_wave_scene(prepared.scene, low_edge(config), low.cells_per_wavelength, config.c)


def check_points(model: Model, points: np.ndarray) -> None:
    """Raise `PointError` for a point that no cell sees, before anything is run."""
    waves = model.prepared.once(wave_scene)
    place_points(waves.scene, waves.lattice, waves.component, points, "points")


class WaveRuns:
    """Of one model. With `points` (N, 3) m, all of a job, they all listen to each run, and what they hear is kept
    for other tiles: in memory, or in an unnamed file of `folder`, which goes with the process. Where neither has
    room, points are run again for other listeners."""

    def __init__(
        self, model: Model, points: np.ndarray | None = None, folder: Path | None = None
    ) -> None:
        self._model, self._points, self._folder = model, points, folder
        self._table: np.ndarray | None = None
        self._rows: dict[bytes, int] = {}
        self._done: set[int] = set()
        if points is not None:
            self._rows = {p.tobytes(): i for i, p in enumerate(np.ascontiguousarray(points, float))}
            self._table = self._empty((len(points), len(points), CHANNELS, self.samples))

    @property
    def samples(self) -> int:
        """Of a response."""
        return response_samples(low_edge(self._model.config), self._model.duration)

    @property
    def sources(self) -> int:
        """That a core runs side by side: fewer take as long."""
        return LANES

    def _empty(self, shape: tuple[int, ...]) -> np.ndarray | None:
        size = 4.0 * float(np.prod(shape, dtype=float))
        if size <= min(MEMORY, 0.5 * free_memory()):
            return np.empty(shape, np.float32)
        if self._folder is not None and _SPARE * size <= shutil.disk_usage(self._folder).free:
            try:
                with tempfile.TemporaryFile(dir=self._folder) as file:
                    reserve_file(file.fileno(), int(size))
                    return np.memmap(file, np.float32, "w+", shape=shape)
            except OSError as error:  # others write there, too, or there is a quota
                _log.info("%s: %s", self._folder, error)
        _log.info("No room to keep what points hear of waves: sources are run again for other tiles")
        return None

    def responses(self, sources: np.ndarray, listeners: np.ndarray) -> np.ndarray:
        """(S, L, 4, n) float32 between (S, 3) and (L, 3) m, of the job's points if it has any. Raises `PointError`
        for points that no cell sees."""
        if self._table is None:
            return self._run(sources, listeners)
        assert self._points is not None
        rows, columns = ([self._rows[p.tobytes()] for p in ends] for ends in (sources, listeners))
        wanted = sorted({*rows} - self._done)
        step = LANES * thread_count()
        for first in range(0, len(wanted), step):
            some = wanted[first : first + step]
            self._table[some] = self._run(self._points[some], self._points)
            self._done.update(some)
        return np.asarray(self._table[np.ix_(rows, columns)])

    def _run(self, sources: np.ndarray, listeners: np.ndarray) -> np.ndarray:
        size, free = 4.0 * len(sources) * len(listeners) * CHANNELS * self.samples, free_memory()
        if not 2.0 * size <= free:
            raise PointError(
                f"{len(sources)} sources × {len(listeners)} listeners: their waves take {2e-9 * size:.1f} GB of "
                f"memory, and {1e-9 * free:.1f} GB are free; simulate some at a time"
            )
        model = self._model
        waves = model.prepared.once(wave_scene)
        with stage("time steps"):
            return solve(
                waves, sources, listeners, low_edge(model.config), model.duration, model.config.air
            )


def make_runs(model: Model, points: np.ndarray | None = None, folder: Path | None = None) -> WaveRuns:
    """The runs of a model; `points`: all of a job, which they keep."""
    return WaveRuns(model, points, folder)


def responses_from(
    scene: Scene, source: np.ndarray, listeners: np.ndarray, duration: float
) -> list[LowResponse]:
    """Below the first band's edge, from (3,) to each of (L, 3), m."""
    low = simulate_low(scene, source[None], listeners, duration)
    return [low[0, i] for i in range(len(listeners))]


@stage("waves")
def with_waves(
    runs: WaveRuns, config: SimulationConfig, there: Echograms, back: Echograms | None
) -> tuple[Echograms, Echograms | None]:
    """Echograms of pairs, and of the ways back, with their waves. Raises `SimulationError` where they differ."""
    low = runs.responses(there.sources, there.listeners)
    edge = low_edge(config)
    if np.array_equal(there.sources, there.listeners):
        _average(low, low.copy(), there)
        return replace(there, low=low, low_edge=edge), back
    if back is None:
        return replace(there, low=low, low_edge=edge), None
    other = runs.responses(back.sources, back.listeners)
    before = low.copy()
    _average(low, other, there)
    _average(other, before, back)
    return replace(there, low=low, low_edge=edge), replace(back, low=other, low_edge=edge)


def _average(low: np.ndarray, reverse: np.ndarray, pairs: Echograms) -> None:
    """The mean of pressures both ways, in place of those of `low` (S, L, 4, n); `reverse` (L, S, 4, n)."""
    one, other = low[:, :, 0], reverse[:, :, 0].transpose(1, 0, 2)
    off = np.abs(one - other).max(axis=2)
    most = _SAME * np.maximum(np.abs(one), np.abs(other)).max(axis=2)
    for s, l in np.argwhere(~(off <= most))[:1]:
        raise SimulationError(
            f"waves between {pairs.sources[s]} and {pairs.listeners[l]} m: the pressure there and back differs by "
            f"{off[s, l]:.3g} of {most[s, l] / _SAME:.3g}, expected the same; please report scene and settings"
        )
    low[:, :, 0] = 0.5 * (one + other)
