"""Air within bands: what a response loses per octave, against ISO 9613-1 as written in tests/iso9613.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from soundspaces_renderers.smooth import smooth_rir

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.air import Air
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.echogram import Arrival, Arrivals
from soundspaces_sim.rendering.air import hop_and_ring, hop_filters, through_air
from soundspaces_sim.rendering.ambisonics import ambisonic_rir
from soundspaces_sim.rendering.microphones import MicrophoneArray, array_rir
from tests import iso9613
from tests.marks import few

RATE = 44100
OCTAVES = 125.0 * 2.0 ** np.arange(7)


def band_edges(bands: int) -> tuple[float, ...]:
    """Edges, Hz, of bands that are equally wide in octaves from 40 Hz to 15 kHz; four are the default's."""
    if bands == 4:
        return DEFAULT_BANDS
    inner = 40.0 * (15000.0 / 40.0) ** (np.arange(1, bands) / bands)
    return (0.0, *(float(edge) for edge in inner), DEFAULT_BANDS[-1])


HALF = 2.0**0.5
Render = Callable[[ss.Echogram, int, int], np.ndarray]


def _one_capsule(echogram: ss.Echogram, rate: int, seed: int) -> np.ndarray:
    return array_rir(echogram, MicrophoneArray([(0.0, 0.0, 0.0)]), rate, seed)


def _octaves(response: np.ndarray) -> np.ndarray:
    power = np.abs(np.fft.rfft(response.astype(float), 1 << 17)) ** 2
    f = np.fft.rfftfreq(1 << 17, 1.0 / RATE)
    return np.array([power[(f >= o / HALF) & (f < o * HALF)].sum() for o in OCTAVES])


def _echogram(bands: tuple[float, ...], metres: float, direct: bool, air: Air | None) -> ss.Echogram:
    """An arrival after a path, or 40 ms of reverberation about its time, in which all bands had unit energy."""
    n, delay = len(bands) - 1, metres / 343.0
    table = np.zeros((round(delay / 0.001) + 30, 9, n), np.float32)
    none = Arrivals(np.empty(0), np.empty((0, n)), np.empty((0, 3)), np.empty((0, 2), int))
    edges = np.arange(len(table) + 1) * 0.001
    first = None
    if direct:
        left = np.ones(n) if air is None else air.transmission(bands, metres)
        first = Arrival(delay, left, np.array([1.0, 0.0, 0.0]))
    else:
        for i in range(len(table) - 50, len(table) - 10):
            middle = 343.0 * (i + 0.5) * 0.001
            table[i, 0] = 1.0 if air is None else air.transmission(bands, middle)
    return ss.Echogram(bands, edges, table, first, none, np.zeros((2, n)), direct, air=air)


@pytest.mark.parametrize("count", [1, 4, 10])
@pytest.mark.parametrize("metres", [10.0, 100.0, 200.0])
def test_the_direct_sound_loses_in_every_octave_what_air_takes(count: int, metres: float) -> None:
    """To .02 dB, however wide the bands are."""
    levels = [
        _octaves(ambisonic_rir(_echogram(band_edges(count), metres, True, air), RATE)[0])
        for air in (Air(), None)
    ]
    lost = 10.0 * np.log10(levels[0] / levels[1])
    expected = [10.0 * np.log10(iso9613.left(o / HALF, o * HALF, metres)) for o in OCTAVES]
    np.testing.assert_allclose(lost, expected, atol=0.02)


@pytest.mark.parametrize("render", [ambisonic_rir, smooth_rir, _one_capsule])
@pytest.mark.parametrize("count", few([1, 4], 4))
def test_reverberation_loses_in_every_octave_what_air_takes(render: Render, count: int) -> None:
    """100 m on, beside the same noise without air, to .3 dB, the noise of 40 ms in four draws; .7 dB for what `smooth`
    makes of bands, of which nothing lies beside it in one band, and less than nothing in four."""
    levels = np.zeros((2, len(OCTAVES)))
    for seed in range(4):
        for row, air in zip(levels, (Air(), None), strict=True):
            row += _octaves(render(_echogram(band_edges(count), 100.0, False, air), RATE, seed)[0])
    lost = 10.0 * np.log10(levels[0] / levels[1])
    expected = [10.0 * np.log10(iso9613.left(o / HALF, o * HALF, 100.0)) for o in OCTAVES]
    np.testing.assert_allclose(lost, expected, atol=0.3)


@pytest.mark.parametrize("n", [1, 23, 192, 200, 1000, 4801])
def test_frames_are_filtered_one_by_one_and_added(n: int) -> None:
    """Responses shorter than a frame or not, of which frames hang over at both ends: as a loop over frames has it."""
    rate, air = 16000, Air()
    (hop, ring), count, size = hop_and_ring(rate), -(-n // 192) + 1, 432
    assert (hop, ring) == (192, 24)
    response = np.random.default_rng(n).standard_normal((2, n)).astype(np.float32)
    padded = np.pad(response.astype(float), ((0, 0), (hop, 2 * hop)))
    window = np.sin(np.pi * (np.arange(2 * hop) + 0.5) / (2 * hop)) ** 2
    filters = hop_filters(air, rate, hop, count, size)
    expected = np.zeros((2, (count + 1) * hop + 2 * ring))
    for k in range(count):
        frame = np.fft.rfft(padded[:, k * hop : (k + 2) * hop] * window, size) * filters[k]
        expected[:, k * hop : k * hop + size] += np.roll(np.fft.irfft(frame, size), ring, axis=1)
    found = through_air(response, air, rate)
    np.testing.assert_allclose(found, expected[:, hop + ring : hop + ring + n], atol=2e-6)
