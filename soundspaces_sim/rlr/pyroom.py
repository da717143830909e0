"""Rooms with the names of pyroomacoustics on this engine: shoeboxes and extruded polygons.

    from soundspaces_sim.rlr import pyroom as pra

Levels, times and shapes are pyroomacoustics': direct sound 1 / r, 40 samples late, `room.rir[microphone][source]`.
docs/rlr.md says what differs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.signal import fftconvolve

from soundspaces_sim.core.config import check_rate
from soundspaces_sim.rlr.errors import RlrError, as_runtime_errors
from soundspaces_sim.rlr.pyroom_ends import MicrophoneArray, SoundSource, places
from soundspaces_sim.rlr.pyroom_formulas import (
    circular_2D_array,
    inverse_sabine,
    linear_2D_array,
    measure_rt60,
)
from soundspaces_sim.rlr.pyroom_scene import (
    C,
    Material,
    box_scene,
    inside,
    make_materials,
    prism_scene,
    responses,
)
from soundspaces_sim.scene.scene import Scene

__all__ = [
    "Material",
    "MicrophoneArray",
    "Room",
    "ShoeBox",
    "SoundSource",
    "circular_2D_array",
    "inverse_sabine",
    "linear_2D_array",
    "make_materials",
    "measure_rt60",
]

LEAD = 40  # samples by which pyroomacoustics' responses are late: half its fractional delay filter


class Room:
    """A room whose floor is a polygon: `Room.from_corners(corners).extrude(height)`.

    `max_order` 0 leaves the direct sound alone; any other takes reflections of all orders, diffuse ones as well,
    until energy has fallen by 70 dB. `seed` draws noise and tails. Raises `RlrError` (a RuntimeError).
    """

    def __init__(self, fs: float = 8000, max_order: int = 1, sigma2_awgn: float | None = None) -> None:
        with as_runtime_errors():
            check_rate(fs, "fs")
        if not (max_order >= 0 and int(max_order) == max_order):
            raise RlrError(f"max_order: expected a whole number, 0 or more, got {max_order!r}")
        if sigma2_awgn is not None and not 0.0 <= sigma2_awgn < math.inf:
            raise RlrError(f"sigma2_awgn: expected a variance, 0 or more, got {sigma2_awgn!r}")
        self.fs, self.max_order, self.sigma2_awgn = fs, max_order, sigma2_awgn
        self.c, self.seed = C, 0
        self.sources: list[SoundSource] = []
        self.mic_array: MicrophoneArray | None = None
        self.rir: list[list[np.ndarray]] | None = None
        self._corners: np.ndarray | None = None
        self._walls: Any = None
        self._scene: Scene | None = None

    @classmethod
    def from_corners(
        cls,
        corners: Any,
        fs: float = 8000,
        max_order: int = 1,
        sigma2_awgn: float | None = None,
        materials: Material | Sequence[Material] | None = None,
        **options: Any,
    ) -> Room:
        """A floor plan of corners (2, n), m; `extrude` makes a room of it. `materials`: one, or one for each side.
        `options`: pyroomacoustics' others; see docs/rlr.md."""
        _known(options)
        room = cls(fs, max_order, sigma2_awgn)
        room._corners, room._walls = np.array(corners, float), materials or Material(0.0)
        if room._corners.ndim != 2 or len(room._corners) != 2:
            raise RlrError(f"from_corners: expected corners (2, n), got {room._corners.shape}")
        return room

    def extrude(self, height: float, v_vec: Any = None, materials: Any = None) -> None:
        """Make the plan a room `height` m high; `materials`: of floor and ceiling, one or a mapping of both."""
        if self._corners is None:
            raise RlrError("extrude: the room has a height already")
        if v_vec is not None and not np.allclose(v_vec, [0.0, 0.0, 1.0]):
            raise RlrError("extrude: v_vec: walls are upright here")
        with as_runtime_errors():
            self._scene = prism_scene(self._corners, float(height), self._walls, materials)
        self._corners = None

    def add_source(self, position: Any, signal: Any = None, delay: float = 0.0, **options: Any) -> Room:
        """Add a source at (3,) m, or a `SoundSource`."""
        _known(options)
        given = isinstance(position, SoundSource)
        source = position if given else SoundSource(position, signal, delay)
        self._check_inside(source.position[:, None], "source")
        self.sources.append(source)
        self.rir = None
        return self

    add_soundsource = add_source

    def add_microphone(self, loc: Any, fs: float | None = None, **options: Any) -> Room:
        """Add a microphone at (3,) m."""
        _known(options)
        return self.add_microphone_array(MicrophoneArray(loc, self.fs if fs is None else fs))

    def add_microphone_array(self, mic_array: Any, **options: Any) -> Room:
        """Add microphones: a `MicrophoneArray` or places (3, m)."""
        _known(options)
        if not isinstance(mic_array, MicrophoneArray):
            mic_array = MicrophoneArray(mic_array, self.fs)
        if mic_array.fs != self.fs:
            raise RlrError(f"microphones record at {mic_array.fs!r} Hz, the room is at {self.fs!r} Hz")
        self._check_inside(mic_array.R, "microphone")
        before = [] if self.mic_array is None else [self.mic_array.R]
        self.mic_array = MicrophoneArray(np.hstack([*before, mic_array.R]), self.fs)
        self.rir = None
        return self

    def set_ray_tracing(self, *_: Any, **__: Any) -> None:
        """Nothing: reflections of all orders are traced as it is."""

    def set_air_absorption(self, *_: Any, **__: Any) -> None:
        """Nothing: air absorbs as ISO 9613-1 has it, at 20 °C and 50 %."""

    def image_source_model(self) -> None:
        """`compute_rir`."""
        self.compute_rir()

    ray_tracing = image_source_model

    def compute_rir(self) -> None:
        """Simulate every source at every microphone: `rir[microphone][source]`, (n,) float64."""
        scene, array = self._ready()
        places = np.array([s.position for s in self.sources])
        with as_runtime_errors():
            found = responses(scene, places, array.R.T, self.fs, self.max_order != 0, self.seed)
        self.rir = [[np.pad(response, (LEAD, 0)) for response in row] for row in found]

    def simulate(
        self, snr: float | None = None, reference_mic: int = 0, return_premix: bool = False
    ) -> np.ndarray | None:
        """Record the sources' signals: `mic_array.signals` (m, n). `snr`: dB of the signals over noise at a
        microphone. `return_premix`: also give (sources, m, n), what each source adds."""
        if self.rir is None:
            self.compute_rir()
        assert self.rir is not None and self.mic_array is not None
        lacking = [i for i, s in enumerate(self.sources) if s.signal is None]
        if lacking:
            raise RlrError(f"simulate: source {lacking[0]} has no signal; give add_source one")
        if snr is not None and not math.isfinite(snr):
            raise RlrError(f"simulate: snr: expected dB, got {snr!r}")
        if not 0 <= reference_mic < len(self.mic_array):
            raise RlrError(f"simulate: reference_mic: expected 0 to {len(self.mic_array) - 1}")
        parts = []
        for s, source in enumerate(self.sources):
            late = np.zeros(math.floor(source.delay * self.fs))
            signal = np.concatenate([late, source.signal])
            parts.append([fftconvolve(signal, row[s]) for row in self.rir])
        longest = max(len(part) for row in parts for part in row)
        premix = np.array([[np.pad(p, (0, longest - len(p))) for p in row] for row in parts])
        signals = premix.sum(axis=0)
        variance = self.sigma2_awgn or 0.0
        if snr is not None:
            variance = float((signals[reference_mic] ** 2).mean()) * 10.0 ** (-snr / 10.0)
        if variance:
            draw = np.random.default_rng(self.seed)
            signals = signals + math.sqrt(variance) * draw.standard_normal(signals.shape)
        self.mic_array.signals = signals
        return premix if return_premix else None

    def measure_rt60(self, decay_db: float = 60.0, plot: bool = False) -> np.ndarray:
        """(m, sources) reverberation time of each response, s; see `measure_rt60`."""
        if self.rir is None:
            self.compute_rir()
        assert self.rir is not None
        return np.array(
            [[measure_rt60(h, self.fs, decay_db, plot=plot) for h in row] for row in self.rir]
        )

    def get_volume(self) -> float:
        """m³."""
        corners = self._made().corners
        return float(
            abs(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum()) / 6
        )

    volume = property(get_volume)

    def rt60_theory(self, formula: str = "sabine") -> float:
        """s, by Sabine's or Eyring's formula with the walls' absorption at 1 kHz; inf where they absorb nothing."""
        scene = self._made()
        edges = scene.corners[:, 1] - scene.corners[:, 0], scene.corners[:, 2] - scene.corners[:, 0]
        area = 0.5 * np.linalg.norm(np.cross(*edges), axis=1)
        table = scene.materials
        at = int(np.abs(table.frequency_hz - 1000.0).argmin())
        share = float((area * table.absorption[scene.face_material, at]).sum() / area.sum())
        if formula not in ("sabine", "eyring"):
            raise RlrError(f"rt60_theory: expected sabine or eyring, got {formula!r}")
        if formula == "eyring":
            share = math.inf if share >= 1.0 else -math.log1p(-share)
        if share == 0.0:
            return math.inf
        return 24.0 * math.log(10.0) / C * self.get_volume() / (float(area.sum()) * share)

    def is_inside(self, p: Any) -> bool:
        """Whether a place (3,) is in the room."""
        return bool(self._inside(places(p, "is_inside"))[0])

    def _inside(self, places: np.ndarray) -> np.ndarray:
        return inside(self._made(), places.T)

    def _check_inside(self, places: np.ndarray, what: str) -> None:
        if not self._inside(places).all():
            raise RlrError(
                f"{what} at {places[:, ~self._inside(places)][:, 0].tolist()} is not in the room"
            )

    def _made(self) -> Scene:
        if self._scene is None:
            raise RlrError("rooms are three-dimensional here; call extrude(height) first")
        return self._scene

    def _ready(self) -> tuple[Scene, MicrophoneArray]:
        if not self.sources or self.mic_array is None:
            raise RlrError(
                "a room needs a source and a microphone; call add_source and add_microphone first"
            )
        return self._made(), self.mic_array


class ShoeBox(Room):
    """A room from the origin to `p` (3,) m. `materials`: one `Material`, or a mapping with one for each of west,
    east (x = 0 and x = max), south, north, floor and ceiling; without any nothing is absorbed."""

    def __init__(
        self,
        p: Any,
        fs: float = 8000,
        t0: float = 0.0,
        max_order: int = 1,
        sigma2_awgn: float | None = None,
        sources: Any = None,
        mics: Any = None,
        materials: Any = None,
        **options: Any,
    ) -> None:
        super().__init__(fs, max_order, sigma2_awgn)
        _known(options)
        if t0:
            raise RlrError("ShoeBox: t0: expected 0, the only start of a simulation here")
        with as_runtime_errors():
            self._scene = box_scene(p, materials or Material(0.0))
        self.shoebox_dim = np.array(p, float)
        for source in sources or ():
            self.add_source(source)
        if mics is not None:
            self.add_microphone_array(mics)


#: Options of pyroomacoustics that change nothing here, and what others must be.
_WITHOUT_EFFECT = (
    "air_absorption",
    "ray_tracing",
    "temperature",
    "humidity",
    "use_rand_ism",
    "max_rand_disp",
)
_NONE_ONLY = ("directivity", "min_phase", "sources", "mics", "t0")


def _known(options: dict[str, Any]) -> None:
    for name, value in options.items():
        if name in _WITHOUT_EFFECT or (name in _NONE_ONLY and not value):
            continue
        raise RlrError(f"{name}={value!r}: this is not known here; docs/rlr.md lists what is")
