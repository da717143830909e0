"""A `PropagationBackend` of isaac-audio-sensors (2.0) on this engine: what a robot's microphones hear in any mesh.

    from soundspaces_isaac import PathTracedAcoustics
    frame, block = simulate_frame(PathTracedAcoustics(scene), snapshot, array_id, window, perception=…)

Scenes, arrays and signals are that package's, in its world axes (Z up, metres), which the mesh has to share; its
environments (shoebox, half space) are not used.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.signal import fftconvolve
from soundspaces_rlr.errors import RlrError, as_runtime_errors
from soundspaces_rlr.responses import responses

from soundspaces_sim import Scene
from soundspaces_sim.parts import check_inside, mono, read_sound


class PathTracedAcoustics:
    """Responses from every source to every microphone, convolved with what the sources emit.

    Direct sound is 1 / (4 pi r), as in that package's solver of the free field, and late by its way. Sources and
    array stand still within a window, where the snapshot has them; responses are kept while nothing moves.
    `indirect` False: the direct sound alone. Raises `RlrError` (a RuntimeError) for what it does not model:
    directivities, noise of microphones, sources that are generated rather than files.
    """

    backend_id = "soundspaces_sim"

    def __init__(self, scene: Scene, *, indirect: bool = True, seed: int = 0) -> None:
        if not isinstance(scene, Scene):
            raise TypeError(f"PathTracedAcoustics: expected a Scene, got {type(scene).__name__}")
        self.scene, self.indirect, self.seed = scene, indirect, seed
        self.reset()

    def reset(self) -> None:
        """Forget where things were: the next block of every array begins anew."""
        self._kept: dict[str, tuple[Any, list[list[np.ndarray]]]] = {}
        self._files: dict[tuple[str, int], np.ndarray] = {}
        self._started = False

    def propagate(self, scene: Any, array_id: str, time_window: Any) -> Any:
        """The array's signals, a `MicrophoneSignalBlock`, in a window of an `AudioSceneSnapshot`."""
        from isaac_audio_sensors.core.microphone_array import microphone_world_positions
        from isaac_audio_sensors.core.types import MicrophoneSignalBlock

        array = scene.array_by_id(array_id)
        for thing in (*scene.sources, *array.microphones):
            _check(thing)
        rate = int(array.sample_rate_hz)
        places = microphone_world_positions(array)
        names = [microphone.mic_id for microphone in array.microphones]
        mics = np.array([places[name] for name in names], float)
        spots = np.array([s.position_world for s in scene.sources], float).reshape(-1, 3)
        first = round(time_window.start_time_s * rate)
        count = max(1, round((time_window.end_time_s - time_window.start_time_s) * rate))
        rirs, moved = self._responses(f"{scene.stage_id}/{array_id}", spots, mics, rate)
        gains = [10.0 ** (m.gain_db / 20.0) / (4.0 * math.pi) for m in array.microphones]
        samples = np.zeros((len(names), count))
        for s, source in enumerate(scene.sources):
            longest = max(len(row[s]) for row in rirs)
            begin = max(0, first - longest + 1)
            emitted = self._emission(source, begin, first + count - begin, rate)
            if emitted.any():
                for m, row in enumerate(rirs):
                    heard = fftconvolve(emitted, row[s])[first - begin : first - begin + count]
                    samples[m] += gains[m] * heard
        return MicrophoneSignalBlock(
            samples=samples.astype(np.float32),
            microphone_ids=tuple(names),
            microphone_positions_m=tuple(m.relative_position_m for m in array.microphones),
            array_id=array_id,
            sample_rate_hz=rate,
            time_window=time_window,
            clock_domain=f"simulation:{scene.stage_id}",
            discontinuity=moved,
            channel_validity=(True,) * len(names),
            channel_clipping=(False,) * len(names),
            producer_id=self.backend_id,
            provenance="room_acoustics",
            diagnostics={
                "propagation": {"motion_model": "held_within_window", "scene": self.scene.name}
            },
        )

    def _responses(
        self, key: str, spots: np.ndarray, mics: np.ndarray, rate: int
    ) -> tuple[list[list[np.ndarray]], bool]:
        """[microphone][source] responses, and whether they are others than in the window before."""
        now = (spots.tobytes(), mics.tobytes(), rate)
        known = self._kept.get(key)
        if known is not None and known[0] == now:
            return known[1], False
        with as_runtime_errors():
            for points, what in ((spots, "source"), (mics, "microphone")):
                if len(points):
                    check_inside(self.scene, points, what)
            found = (
                responses(self.scene, spots, mics, rate, self.indirect, self.seed)
                if len(spots)
                else [[] for _ in mics]
            )
        self._kept[key] = now, found
        return found, known is not None

    def _emission(self, source: Any, first: int, count: int, rate: int) -> np.ndarray:
        """(count,) what a source emits from sample `first` of the clock on."""
        begins = round(source.start_time_s * rate)
        at = np.arange(first - begins, first - begins + count)
        signal = self._file(str(source.audio_asset_path), rate)
        last = math.inf if source.loop_count == -1 else len(signal) * (source.loop_count + 1)
        if source.duration_s is not None:
            last = min(last, round(source.duration_s * rate))
        on = (at >= 0) & (at < last)
        out = np.zeros(count)
        out[on] = 10.0 ** (source.gain_db / 20.0) * signal[at[on] % len(signal)]
        return out

    def _file(self, path: str, rate: int) -> np.ndarray:
        """(n,) mean of a file's channels, at `rate`."""
        if (path, rate) not in self._files:
            self._files[path, rate] = mono(*read_sound(path, RlrError), rate)
        return self._files[path, rate]


def _check(thing: Any) -> None:
    """Raise `RlrError` for a source or a microphone that is not modelled."""
    name = getattr(thing, "source_id", None) or thing.mic_id
    pattern = getattr(thing.directivity, "value", thing.directivity)
    if pattern not in ("omni", "omnidirectional"):
        raise RlrError(
            f"{name}: directivity {pattern!r}: sources and microphones are omnidirectional here"
        )
    if getattr(thing, "self_noise_db", None) is not None:
        raise RlrError(f"{name}: self_noise_db: microphones are without noise here")
    if hasattr(thing, "audio_asset_path") and (
        not thing.audio_asset_path or "://" in thing.audio_asset_path
    ):
        raise RlrError(f"{name}: expected a sound file, got {thing.audio_asset_path!r}")
