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
from soundspaces_sim.core.numerics.kernel import kernel, part
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
    size = int(scipy.fft.next_fast_len(2 * hop + 2 * ring, real=True))
    filters, window = hop_filters(air, rate, hop, count, size), _window(hop)
    out, frames = np.zeros((len(response), n), np.float32), np.zeros((count, size), np.float32)
    for before, after in zip(response, out, strict=True):  # what a channel needs stays in the cache
        _cut(frames, np.ascontiguousarray(before, np.float32), window)
        spectrum = scipy.fft.rfft(frames)
        spectrum *= filters
        _overlap(after, scipy.fft.irfft(spectrum, size, overwrite_x=True), hop, ring)
    return out


@kernel
def _cut(out: np.ndarray, samples: np.ndarray, window: np.ndarray) -> None:
    """Fill the beginnings of `out` (k, F) with samples (n,) under a window (2 hop,), each a hop later; the first
    begins a hop before the samples."""
    n, length = len(samples), len(window)
    hop = length // 2
    for k in range(len(out)):
        first = (k - 1) * hop
        low, high = max(-first, 0), min(n - first, length)
        into = out[k]
        into[:low] = 0.0
        into[max(high, 0) : length] = 0.0
        begin = np.uintp(low)
        here = np.uintp(first + low)
        for i in range(np.uintp(max(high - low, 0))):
            into[begin + i] = samples[here + i] * window[begin + i]


@kernel
def _overlap(out: np.ndarray, frames: np.ndarray, hop: int, ring: int) -> None:
    """Add to `out` (n,) filtered frames (k, F) of `_cut`. What the filter puts before a frame lies at the end of
    its transform."""
    size = frames.shape[1]
    for k in range(len(frames)):
        first, of_frame = (k - 1) * hop, frames[k]
        _add_from(out, first, of_frame, 0, 2 * hop + ring)
        _add_from(out, first - ring, of_frame, size - ring, ring)


@part
def _add_from(out: np.ndarray, first: int, frame: np.ndarray, start: int, length: int) -> None:
    """Add `length` samples of a frame from `start` on to `out` from `first` on, those that it has."""
    low, high = max(-first, 0), min(len(out) - first, length)
    here, there = np.uintp(first + low), np.uintp(start + low)
    for i in range(np.uintp(max(high - low, 0))):
        out[here + i] += frame[there + i]


@lru_cache(maxsize=8)
def _window(hop: int) -> np.ndarray:
    """(2 hop,) float32 that adds up to 1 with itself a hop later."""
    made = (np.sin(np.pi * (np.arange(2 * hop) + 0.5) / (2 * hop)) ** 2).astype(np.float32)
    made.setflags(write=False)
    return made


@lru_cache(maxsize=8)
def hop_filters(air: Air, rate: int, hop: int, count: int, size: int) -> np.ndarray:
    """(count, size / 2 + 1) amplitudes after every hop."""
    frequency = scipy.fft.rfftfreq(size, 1.0 / rate)
    length = air.speed_of_sound * hop / rate * np.arange(count)
    gains = np.exp(-0.5 * length[:, None] * air.attenuation(frequency)).astype(np.float32)
    gains.setflags(write=False)
    return gains
