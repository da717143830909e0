"""The course of air's absorption within bands, put back on rendering.

Sound that is heard at t has travelled c t, whatever it met: what air has taken of each frequency is known. So the
energies of a band are divided by what air leaves of it and rendered as if there were none, and the response goes
through exp(-m(f) c t / 2): a filter without phase that changes with time, made anew every `_HOP_S` and cross-faded.
Discrete arrivals get theirs in `echogram.filters.arrival_filters`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy.fft

from soundspaces_sim.core.numerics.air import Air
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.filters import air_left

_HOP_S = 0.012  # sound travels 4 m: at 20 kHz cross-fading is .1 dB off, at 10 kHz .01 dB
_RING_S = 0.0015  # room for the filter on either side


def without_air(echogram: Echogram) -> Echogram:
    """The echogram as if the air took nothing of its reverberation; its discrete arrivals stay as they are."""
    air = echogram.air
    if air is None:
        return echogram
    edges = echogram.time_edges
    left = air_left(air, echogram.bands, 0.5 * (edges[1:] + edges[:-1]))
    energy = np.divide(
        echogram.energy, left[:, None], out=np.zeros_like(echogram.energy), where=left[:, None] > 0.0
    )
    return replace(echogram, energy=energy)


def hop_and_ring(rate: int) -> tuple[int, int]:
    """Samples from filter to filter, and of room on either side."""
    return round(_HOP_S * rate), round(_RING_S * rate)


def through_air(response: np.ndarray, air: Air | None, rate: int) -> np.ndarray:
    """(C, n) float32 of a response (C, n) that was made without air, from the moment of emission on."""
    if air is None:
        return response
    n, (hop, ring) = response.shape[1], hop_and_ring(rate)
    count = -(-n // hop) + 1
    padded = np.zeros((len(response), (count + 1) * hop), np.float32)
    padded[:, hop : hop + n] = response
    frames = np.lib.stride_tricks.sliding_window_view(padded, 2 * hop, axis=1)[:, ::hop]
    window = (np.sin(np.pi * (np.arange(2 * hop) + 0.5) / (2 * hop)) ** 2).astype(np.float32)
    size = int(scipy.fft.next_fast_len(2 * hop + 2 * ring, real=True))
    spectrum = scipy.fft.rfft(frames * window, size)
    spectrum *= hop_filters(air, rate, hop, count, size)
    made = scipy.fft.irfft(spectrum, size, overwrite_x=True)
    out = np.zeros((len(response), padded.shape[1] + 2 * ring), np.float32)
    for k in range(count):  # what the filter puts before a frame lies at the end of its transform
        first = k * hop + ring
        out[:, first : first + 2 * hop + ring] += made[:, k, : 2 * hop + ring]
        out[:, first - ring : first] += made[:, k, size - ring :]
    return np.ascontiguousarray(out[:, hop + ring : hop + ring + n])


@lru_cache(maxsize=8)
def hop_filters(air: Air, rate: int, hop: int, count: int, size: int) -> np.ndarray:
    """(count, size / 2 + 1) amplitudes after every hop."""
    frequency = scipy.fft.rfftfreq(size, 1.0 / rate)
    length = air.speed_of_sound * hop / rate * np.arange(count)
    gains = np.exp(-0.5 * length[:, None] * air.attenuation(frequency)).astype(np.float32)
    gains.setflags(write=False)
    return gains
