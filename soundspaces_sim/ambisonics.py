"""Second-order ambisonics: echogram to pressure.

Conventions: ACN channel order, SN3D normalisation (AmbiX); X front = +x of the scene, Y left, Z up, in
world axes; channel 0 is the omnidirectional pressure. A direct sound of energy E has amplitude sqrt(E).

Reverberation is band noise under the envelope sqrt(E_b(t)). A plane wave spreads its energy E over the
2 n + 1 channels of order n so that they sum to E. Where a time bin holds several arrivals the moments
S_nm average towards zero and miss part of it; the rest is diffuse and gets noise of its own per channel:

    a_nm(t) = sqrt(E) * (S_nm / E) * noise_0 + sqrt(E (1 - sum_m (S_nm / E)^2) / (2 n + 1)) * noise_nm
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import convolve1d

from soundspaces_sim.echogram import Arrival, Echogram
from soundspaces_sim.errors import ConfigError
from soundspaces_sim.filters import lowpass_table, noise_table, sinc_table
from soundspaces_sim.synthesis import fill_reverberation, place_arrival
from soundspaces_sim.transport.rng import mix64

CHANNELS = 9


def spherical_harmonics(direction: ArrayLike) -> np.ndarray:
    """(…, 9) real spherical harmonics, ACN and SN3D, of (…, 3) unit vectors."""
    d = np.asarray(direction, float)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    root3 = math.sqrt(3.0)
    out = np.stack(
        [
            np.ones_like(x), y, z, x, root3 * x * y, root3 * y * z,
            0.5 * (2.0 * z * z - x * x - y * y), root3 * x * z, 0.5 * root3 * (x * x - y * y),
        ],
        axis=-1,
    )  # fmt: skip
    return np.asarray(out)


def ambisonic_rir(echogram: Echogram, rate: int = 44100, seed: int = 0) -> np.ndarray:
    """(9, n) float32 room impulse response at `rate` Hz, world axes, ACN/SN3D.

    The noise is a function of `seed` alone. n covers the echogram's duration and its last arrival.
    """
    if not 8000 <= rate <= 192000:
        raise ConfigError(f"rate: expected 8000 to 192000 Hz, got {rate}")
    arrivals = echogram.arrivals
    end = max([float(echogram.time_edges[-1])] + [a.delay + 0.01 for a in arrivals])
    out = np.zeros((CHANNELS, math.ceil(end * rate)))
    _add_reverberation(out, echogram, rate, seed)
    for arrival in arrivals:
        _add_arrival(out, arrival, echogram.bands, rate)
    return out.astype(np.float32)


def _add_reverberation(out: np.ndarray, echogram: Echogram, rate: int, seed: int) -> None:
    noise = noise_table(echogram.bands, rate)
    energy, hop = _smooth_energy(echogram, len(noise))
    fill_reverberation(out, energy, hop * rate, noise, np.uint64(mix64(np.uint64(seed % 2**64))))


def _smooth_energy(echogram: Echogram, bands: int) -> tuple[np.ndarray, float]:
    """(steps, 9, bands) energy per step of the finest bin width, and that width in s.

    A band's envelope must be no faster than the band is wide, or its noise spreads into its neighbours:
    energies are smoothed by a Hann kernel about 0.9 / bandwidth wide.
    """
    widths = np.diff(echogram.time_edges)
    hop = float(widths.min())
    repeats = np.rint(widths / hop).astype(np.int64)
    energy = np.repeat(echogram.energy[:, :, :bands] / repeats[:, None, None], repeats, axis=0)
    energy = energy.astype(float)
    for b in range(bands):
        width = 0.9 / (echogram.bands[b + 1] - echogram.bands[b])  # half-height width of the kernel
        half = int(width / hop)
        if half >= 1:
            kernel = np.hanning(2 * half + 3)[1:-1]
            kernel /= kernel.sum()
            # Reflected at both ends, so that no energy is lost there.
            energy[:, :, b] = convolve1d(energy[:, :, b], kernel, axis=0, mode="reflect")
    return np.ascontiguousarray(energy), hop


def _add_arrival(out: np.ndarray, arrival: Arrival, bands: tuple[float, ...], rate: int) -> None:
    """A discrete arrival: an exact fractional delay, filtered by its band gains (zero phase).

    With gains g_b the filter is g_top * delta + sum_b (g_b - g_(b+1)) * lowpass_b, so equal bands give
    the delta alone.
    """
    lowpass, half = lowpass_table(bands, rate)
    gains = np.sqrt(arrival.energy[: len(lowpass) + 1])
    harmonics = spherical_harmonics(arrival.direction)
    if not arrival.direction.any():
        harmonics = np.eye(CHANNELS)[0]
    place_arrival(out, arrival.delay * rate, gains, harmonics, sinc_table(), lowpass, half)
