"""Observations of agents in continuous space."""

from __future__ import annotations

import math

import numpy as np
import scipy.fft
import scipy.signal

from soundspaces_continuous.signals import SourceSignal
from soundspaces_continuous.state import ContinuousState, sounding_steps
from soundspaces_continuous.step_renderer import Sounding, StepRenderer
from soundspaces_continuous.task import CONTINUOUS_SENSORS, ContinuousOptions
from soundspaces_continuous.world import ContinuousWorld
from soundspaces_sim import ConfigError, spectrogram
from soundspaces_sim.nav import SoundBank, depth_views
from soundspaces_sim.parts import (
    CAMERA_HEIGHT,
    POINTGOAL,
    RMS_AT_1_M,
    BlockCache,
    drawn_size,
    normalise_depth as normalise,
    shrink_views as shrink,
    sound_intensity as intensity,
)

_FOREVER = 2**62  # samples
_N_FFT, _MOST_RATIO, _LEAST = 512, 4.0, 1e-8


def interaural(ears: np.ndarray, rate: int) -> np.ndarray:
    """(4, 256, frames) float32 of ears (2, n): mean magnitude, cosine and sine of the phase difference, and log10
    of the
    ratio of magnitudes (at most ±4), left against right, by bin from the first, every 10 ms: the features of
    SAVN-CE's agents (short-time Fourier transform of 512 points, Hann window, centred, padded with zeros)."""
    hop = round(0.01 * rate)
    padded = np.pad(ears, ((0, 0), (_N_FFT // 2, _N_FFT // 2)))
    window = scipy.signal.get_window("hann", _N_FFT).astype(np.float32)
    frames = np.lib.stride_tricks.sliding_window_view(padded, _N_FFT, axis=1)[:, ::hop]
    left, right = scipy.fft.rfft(frames * window, axis=2)[:, :, 1:].transpose(0, 2, 1)
    a, b = np.abs(left), np.abs(right)
    both = left * right.conj()
    size = np.abs(both)
    turn = np.where(size > 0.0, both / np.where(size > 0.0, size, 1.0), 1.0)
    ratio = np.clip(np.log10((a + _LEAST) / (b + _LEAST)), -_MOST_RATIO, _MOST_RATIO)
    return np.stack([0.5 * (a + b), turn.real, turn.imag, ratio]).astype(np.float32)


class ContinuousSensorSuite:
    """Sees and hears anywhere. `shapes`: of each sensor's observation."""

    def __init__(self, bank: SoundBank, options: ContinuousOptions) -> None:
        self.bank, self.options = bank, options
        self.block = round(options.step_time * bank.rate)
        if self.block <= _N_FFT // 2:
            raise ConfigError(
                f"step_time: expected more than {_N_FFT // 2} samples, got {self.block} at {bank.rate} Hz"
            )
        self.memory = BlockCache(options.memory)
        self.shapes = {
            name: CONTINUOUS_SENSORS[name].shape(bank.rate, self.block, options.depth_size)
            for name in options.sensors
        }
        self._renderers: dict[int, tuple[ContinuousWorld, StepRenderer]] = {}
        self._hears = any(CONTINUOUS_SENSORS[name].heard for name in options.sensors)

    def empty(self) -> dict[str, np.ndarray]:
        """Arrays for one observation."""
        return {sensor: np.empty(shape, np.float32) for sensor, shape in self.shapes.items()}

    def observe(
        self, state: ContinuousState, rng: np.random.Generator, out: dict[str, np.ndarray]
    ) -> None:
        """Write what the agent of `state` perceives into `out`. Of each state once per step, as sound goes on."""
        ears = self.hear(state) if self._hears else np.empty((2, 0), np.float32)
        for name in self.options.sensors:
            into = out[name]
            if name == "audiogoal":
                into[:] = ears
            elif name == "spectrogram":
                into[:] = spectrogram(ears, self.bank.rate)
            elif name == "interaural":
                into[:] = interaural(ears, self.bank.rate)
            elif name == "intensity":
                into[:] = intensity(ears)
            elif name == "depth":
                into[:, :, 0] = self._see(state)
            elif name == POINTGOAL:
                into[:] = self._locate(state, rng)
            elif name == "pose":
                into[:] = _pose(state)
            else:
                into[0] = state.collided

    def hear(self, state: ContinuousState) -> np.ndarray:
        """(2, block) float32 of the step that a state is in."""
        if state.heard is not None and state.heard[0] == state.steps:
            return state.heard[1]
        renderer = self._renderer(state.world)
        sounding = []
        for source in (*state.episode.goals, *state.episode.distractors):
            first, last = sounding_steps(source, self.options.step_time)
            end = _FOREVER if math.isinf(last) else int(last) * self.block
            signal = SourceSignal(source.sound, self.bank[source.sound], first * self.block, end)
            sounding.append(Sounding(signal, state.world.source_at(source, state.time)))
        ears, state.tail = renderer.hear(state.steps, sounding, state.place, state.facing, state.tail)
        if state.episode.noise is not None:
            ears += self._noise(state.episode.noise, state.steps)
        state.heard = state.steps, ears
        return ears

    def _renderer(self, world: ContinuousWorld) -> StepRenderer:
        found = self._renderers.get(id(world))
        if found is None:
            found = self._renderers[id(world)] = (world, world.renderer(self.memory))
        return found[1]

    def _noise(self, name: str, step: int) -> np.ndarray:
        """(2, block): the two ears read a clip from its beginning and from its middle on."""
        clip = self.bank[name]
        at = step * self.block + np.arange(self.block)
        gain = np.float32(RMS_AT_1_M * 10.0 ** (-self.options.noise_db / 20.0))
        return gain * np.stack([clip[at % len(clip)], clip[(at + len(clip) // 2) % len(clip)]])

    def _see(self, state: ContinuousState) -> np.ndarray:
        """(size, size) z-depth / 10 m, as `views` has it."""
        camera = np.array([[state.x, state.y, state.floor.height + CAMERA_HEIGHT]])
        size = self.options.depth_size
        drawn = depth_views(state.world.scene, camera, np.array([state.heading]), drawn_size(size))
        return shrink(normalise(drawn[0, 0]), size)

    def _locate(self, state: ContinuousState, rng: np.random.Generator) -> tuple[float, float]:
        """(distance m, angle rad, left positive) of the nearest goal as the crow flies."""
        goals = [state.world.source_at(g, state.time).position for g in state.episode.goals]
        offsets = [(float(g[0]) - state.x, float(g[1]) - state.y) for g in goals]
        dx, dy = min(offsets, key=lambda o: math.hypot(*o))
        if self.options.gps_sigma > 0.0:
            noise = rng.standard_normal(2) * self.options.gps_sigma
            dx, dy = dx + float(noise[0]), dy + float(noise[1])
        angle = (math.atan2(dy, dx) - state.facing + math.pi) % (2.0 * math.pi) - math.pi
        return min(math.hypot(dx, dy), 1000.0), angle


def _pose(state: ContinuousState) -> tuple[float, float, float, float]:
    """(forward m, left m, turn rad, steps) since the beginning, in the axes of the first pose."""
    episode = state.episode
    start = math.radians(episode.heading)
    dx, dy = state.x - episode.start[0], state.y - episode.start[1]
    c, s = math.cos(start), math.sin(start)
    turn = (state.facing - start + math.pi) % (2.0 * math.pi) - math.pi
    return c * dx + s * dy, c * dy - s * dx, turn, float(state.steps)
