"""Microphone arrays: capsules within 0.3 m of a point, whose phases belong together.

All capsules hear one sound field, that of the array's centre. A discrete arrival comes from its image, at the
distance that sound travelled: each capsule has its own delay and level. Reverberation is a set of plane waves
with independent noise from directions spread evenly over the sphere, weighted in every time bin and band by the
density that its moments describe (order 2, what is negative cut off); a capsule at o hears the wave from d
earlier by o.d / c. So a diffuse field has the coherence sin(kr) / kr between two omnidirectional capsules
(Cook et al. 1955), and a wave has one direction at all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike

from soundspaces_sim.base.axes import DEGREE, head_matrix, spherical_harmonics
from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.base.rng import combine
from soundspaces_sim.echo.directed import aim, gains
from soundspaces_sim.echo.echogram import Echogram
from soundspaces_sim.echo.ends import Directivity, Listener, check_angles
from soundspaces_sim.echo.filters import arrival_filters, white_noise
from soundspaces_sim.sound.ambisonics import band_plans, response_length
from soundspaces_sim.sound.synthesis import place

MOST_RADIUS = 0.3  # m
_WAVES = 192
_LANES = 2000  # streams of noise apart from those of other renderers


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
    _add_arrivals(out, echogram, array, rate, speed_of_sound)
    return out


def _waves(seed: int) -> np.ndarray:
    """(J, 3) directions, a Fibonacci lattice turned at random."""
    k = np.arange(_WAVES) + 0.5
    z, phi = 1.0 - 2.0 * k / _WAVES, np.pi * (1.0 + np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z**2)
    turn = np.random.default_rng(seed % 2**64).uniform(-180.0, 180.0, 3)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1) @ head_matrix(*turn).T


def _reverberation(
    echogram: Echogram, array: MicrophoneArray, n: int, rate: int, seed: int, speed_of_sound: float
) -> np.ndarray:
    directions = _waves(seed)
    earlier = array.offsets @ directions.T / speed_of_sound  # (k, J) s
    level = np.sqrt(array.energy_gains(directions, echogram.bands))
    # density over directions of moments S: sum (2 n + 1) S_nm Y_nm
    harmonics = (2.0 * DEGREE + 1.0) * spherical_harmonics(directions)
    size, plans = band_plans(echogram.bands, int(rate), n)
    spectrum = np.zeros((len(earlier), size // 2 + 1), np.complex64)
    for b, plan in enumerate(plans):
        energy = np.maximum(echogram.energy[:, :, b] @ harmonics.T, 0.0)
        whole = energy.sum(axis=1, keepdims=True)
        energy *= np.divide(
            echogram.energy[:, :1, b], whole, out=np.zeros_like(whole), where=whole > 0.0
        )
        made = _noise(energy, echogram.time_edges, size // plan.step, plan.step / rate, seed, b)
        made = made[plan.first : plan.last] * plan.gain[:, None]
        turn = 2j * np.pi * np.arange(plan.first, plan.last)[:, None] * (rate / size)
        for k in range(len(earlier)):
            phases = np.exp(turn * earlier[k]).astype(np.complex64)
            spectrum[k, plan.first : plan.last] += np.einsum(
                "fj,fj,j->f", made, phases, level[k, :, b].astype(np.float32)
            )
    return np.ascontiguousarray(scipy.fft.irfft(spectrum, size)[:, :n], np.float32)


def _noise(
    energy: np.ndarray, edges: np.ndarray, samples: int, dt: float, seed: int, band: int
) -> np.ndarray:
    """(bins, J) spectra of independent noises, `samples` long and `dt` apart, that carry `energy` (t, J)."""
    table, mask = white_noise(), len(white_noise()) - 1
    cumulative = np.concatenate([np.zeros((1, energy.shape[1])), np.cumsum(energy, axis=0)])
    between = np.clip((np.arange(samples + 1) - 0.5) * dt, edges[0], edges[-1])
    row = np.clip(np.searchsorted(edges, between, "right") - 1, 0, len(edges) - 2)
    part = ((between - edges[row]) / (edges[row + 1] - edges[row]))[:, None]
    at_edges = (1.0 - part) * cumulative[row] + part * cumulative[row + 1]
    stream = np.uint64(combine(np.uint64(combine(np.uint64(seed % 2**64), _LANES)), band))
    starts = [int(combine(stream, j) % np.uint64(len(table))) for j in range(energy.shape[1])]
    noise = table[(np.arange(samples)[:, None] + np.array(starts)) & mask]
    root = np.sqrt(np.maximum(np.diff(at_edges, axis=0), 0.0)).astype(np.float32)
    return np.asarray(scipy.fft.rfft(root * noise, axis=0))


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
            energy * gain * near[:, None] ** 2, own / speed_of_sound, echogram.bands, int(rate)
        )
        place(out[k : k + 1], responses, starts, np.ones((len(own), 1), np.float32))
