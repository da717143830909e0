"""Microphone arrays: capsules within 0.3 m of a point, whose phases belong together.

All capsules hear one sound field, that of the array's centre. A discrete arrival comes from its image, at the
distance that sound travelled: each capsule has its own delay and level. Reverberation is the plane waves of
`waves`: a capsule at o hears the wave from d earlier by o.d / c. Waves below an edge are known to first order about
the centre (`echogram.low_response`): what is left out is 3 % of the pressure at .1 m and 30 % at .3 m, for 176 Hz.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.axes import head_matrix
from soundspaces_sim.echogram.directed import aim, gains
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.endpoints import Directivity, Listener, check_angles
from soundspaces_sim.echogram.filters import arrival_filters
from soundspaces_sim.echogram.low_response import sphere
from soundspaces_sim.rendering.ambisonics import response_length
from soundspaces_sim.rendering.low_band import at_microphones, combined
from soundspaces_sim.rendering.synthesis import place
from soundspaces_sim.rendering.waves import WaveField

MOST_RADIUS = 0.3  # m


@dataclass(frozen=True)
class MicrophoneArray:
    """Capsules at `positions` (k, 3) m from the array's centre, in its own axes (front X, left Y, up Z).

    `directivity`: of all capsules, or k of them, in the array's axes; None is omnidirectional. Heading, pitch
    and roll turn the whole. Raises `ConfigError`, also for a capsule more than 0.3 m from the centre.
    """

    positions: ArrayLike
    directivity: Directivity | Sequence[Directivity | None] | None = None
    heading_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    capsules: tuple[Directivity | None, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        place = np.array(self.positions, float)
        if place.ndim != 2 or place.shape[1] != 3 or len(place) < 1 or not np.isfinite(place).all():
            raise ConfigError(f"positions: expected finite offsets of shape (k, 3), got {place.shape}")
        radius = float(np.linalg.norm(place, axis=1).max())
        if radius > MOST_RADIUS:
            raise ConfigError(
                f"positions: expected capsules within {MOST_RADIUS} m of the centre, got one at {radius:g} m; "
                "what is farther apart hears other reflections: place it at a point of its own"
            )
        check_angles(type(self).__name__, self.heading_deg, self.pitch_deg, self.roll_deg)
        given = self.directivity
        each = tuple(given) if isinstance(given, list | tuple) else (given,) * len(place)
        if len(each) != len(place) or not all(d is None or isinstance(d, Directivity) for d in each):
            raise ConfigError(
                f"directivity: expected one Directivity or {len(place)} of them, got {given!r}"
            )
        place.setflags(write=False)
        object.__setattr__(self, "positions", place)
        object.__setattr__(self, "capsules", each)

    @property
    def offsets(self) -> np.ndarray:
        """(k, 3) m, in world axes."""
        turn = head_matrix(self.heading_deg, self.pitch_deg, self.roll_deg)
        return np.asarray(self.positions @ turn.T)

    def energy_gains(self, directions: np.ndarray, bands: tuple[float, ...]) -> np.ndarray:
        """(k, n, b) of the capsules in directions (n, 3) of world axes."""
        out = np.ones((len(self.capsules), len(directions), len(bands) - 1))
        for row, directivity in zip(out, self.capsules, strict=True):
            turned = Listener(
                (0.0, 0.0, 0.0), directivity, self.heading_deg, self.pitch_deg, self.roll_deg
            )
            to = aim(turned, bands, "pattern")
            if to is not None:
                row[:] = gains(to, directions)
        return out


def array_rir(
    echogram: Echogram,
    array: MicrophoneArray,
    rate: int = 44100,
    seed: int = 0,
    speed_of_sound: float = 343.0,
) -> np.ndarray:
    """(k, n) float32 responses at `rate` Hz of an array centred at the echogram's listener.

    The noise is a function of `seed` alone, the same field for every array. Raises `ConfigError`.
    """
    n = response_length(echogram, rate)
    out = _reverberation(echogram, array, n, rate, seed, speed_of_sound)
    low = echogram.low
    if low is None:
        _add_arrivals(out, echogram, array, rate, speed_of_sound)
        return out
    discrete = np.zeros_like(out)
    _add_arrivals(discrete, echogram, array, rate, speed_of_sound)
    amplitudes = list(np.sqrt(array.energy_gains(sphere()[0], echogram.bands)[:, :, 0]))
    waves = at_microphones(low, array.offsets, amplitudes, n, rate, speed_of_sound)
    return combined(out, discrete, waves, low.edge, rate)


def _reverberation(
    echogram: Echogram, array: MicrophoneArray, n: int, rate: int, seed: int, speed_of_sound: float
) -> np.ndarray:
    field = WaveField(echogram, n, rate, seed)
    level = np.sqrt(array.energy_gains(field.directions, echogram.bands)).transpose(0, 2, 1)
    return field.at(array.offsets, level, speed_of_sound)


def _add_arrivals(
    out: np.ndarray, echogram: Echogram, array: MicrophoneArray, rate: int, speed_of_sound: float
) -> None:
    arrivals = echogram.arrivals
    if not arrivals:
        return
    delay = np.array([a.delay for a in arrivals])
    energy = np.array([a.energy for a in arrivals])
    length = delay * speed_of_sound
    images = np.array([a.direction for a in arrivals]) * length[:, None]
    for k, offset in enumerate(array.offsets):
        towards = images - offset
        own = np.linalg.norm(towards, axis=1)
        # at the very place of the source nothing but the delay tells capsules apart
        near = np.where(length > 0.0, length / np.maximum(own, 1e-3), 1.0)
        gain = array.energy_gains(towards, echogram.bands)[k]
        responses, starts = arrival_filters(
            energy * gain * near[:, None] ** 2,
            own / speed_of_sound,
            echogram.bands,
            int(rate),
            echogram.air,
        )
        place(out[k : k + 1], responses, starts, np.ones((len(own), 1), np.float32))
