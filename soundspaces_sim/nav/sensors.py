"""Observations of agents, whatever environment asks for them: one writer into arrays that are given."""

from __future__ import annotations

import math
import os

import numpy as np

from soundspaces_sim.nav import audio_sensor
from soundspaces_sim.nav.audio_sensor import AudioSensor, Cache
from soundspaces_sim.nav.cache import BlockCache
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episode_state import EpisodeState
from soundspaces_sim.nav.sensor_table import SENSOR_TABLE, SINGLE_OF_HALF, widen
from soundspaces_sim.nav.sounds import SoundBank
from soundspaces_sim.nav.task import TaskOptions
from soundspaces_sim.nav.views import Views

_shared: dict[int, BlockCache] = {}


def shared_memory() -> BlockCache:
    """The memory of what was heard, one for all environments of this process."""
    return _shared.setdefault(os.getpid(), BlockCache(audio_sensor.MEMORY))


class SensorSuite:
    """Sees and hears in all scenes of `data`. `shapes`: of each sensor's observation."""

    def __init__(
        self, data: NavData, bank: SoundBank, task: TaskOptions, cache: Cache = "memory"
    ) -> None:
        audio_sensor.check_cache(cache)
        self.data, self.bank, self.task, self.cache = data, bank, task, cache
        self.gps_sigma = task.gps_sigma
        self.shapes = {s: SENSOR_TABLE[s].shape(bank.rate, task.depth_size) for s in task.sensors}
        # Noise changes the waveform: its pictures cannot be kept.
        self._kinds = frozenset(("audiogoal",)) if task.heard and task.snr_db is not None else task.heard
        self._audio: dict[str, AudioSensor] = {}
        self._views: dict[str, Views] = {}

    def audio(self, scene: str) -> AudioSensor:
        """The ears of a scene."""
        if scene not in self._audio:
            self._audio[scene] = AudioSensor(
                self.data.dataset(scene),
                self.bank,
                self._kinds,
                self.cache,
                shared_memory(),
                self.task.pad_mode,
            )
        return self._audio[scene]

    def views(self, scene: str) -> Views:
        """The eyes of a scene."""
        if scene not in self._views:
            self._views[scene] = Views(self.data.dataset(scene), self.task.depth_size)
        return self._views[scene]

    def empty(self) -> dict[str, np.ndarray]:
        """Arrays for one observation."""
        return {sensor: np.empty(shape, np.float32) for sensor, shape in self.shapes.items()}

    def observe(self, state: EpisodeState, rng: np.random.Generator, out: dict[str, np.ndarray]) -> None:
        """Write what the agent of `state` perceives into `out`, one array per sensor. `rng`: for noise."""
        for name in self.task.sensors:
            observe = SENSOR_TABLE[name].observe
            if observe is not None:
                observe(self, state, rng, out[name])
        if self._kinds:
            self._hear(state, state.pose & 3, rng, out)
            if self.task.ears == "mono":
                for sensor in self.task.heard:
                    _same_for_both(sensor, out[sensor])

    def _hear(
        self, state: EpisodeState, k: int, rng: np.random.Generator, out: dict[str, np.ndarray]
    ) -> None:
        episode = state.episode
        here = self.audio(episode.scene)
        if state.silent:
            for sensor in self.task.heard:
                out[sensor][:] = 0.0  # it is over; a spectrogram of silence is log(1 + 0)
            return
        block = here.facing(k, episode.sound, episode.goal, state.node, state.steps)
        if self.task.snr_db is None:
            for sensor in self.task.heard:
                heard = block[sensor]
                if sensor == "spectrogram":
                    widen(SINGLE_OF_HALF, heard.view(np.uint16).reshape(-1), out[sensor].reshape(-1))
                else:
                    out[sensor][:] = heard
            return
        ears = audio_sensor.add_noise(block["audiogoal"], self.task.snr_db, rng)
        for sensor in self.task.heard:
            if sensor == "audiogoal":
                out[sensor][:] = ears
            elif sensor == "intensity":
                out[sensor][:] = audio_sensor.intensity(ears)
            else:
                out[sensor][:] = audio_sensor.picture(ears, self.bank.rate, self.task.pad_mode)


def _same_for_both(sensor: str, heard: np.ndarray) -> None:
    """Give both ears their mean, in place: that of waveforms, of spectrograms, of power."""
    if sensor == "audiogoal":
        heard[:] = heard.mean(axis=0)
    elif sensor == "intensity":
        heard[:] = math.sqrt(float(np.mean(np.square(heard, dtype=np.float64))))
    else:
        heard[:] = heard.mean(axis=-1, keepdims=True)
