"""Waves below an edge and the echogram above it meet without a step, as pressure, directions, ears and arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from soundspaces_parameters.of_waves import low_levels, octaves_below

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError, PairIndexError
from soundspaces_sim.echogram.directed import directed
from soundspaces_sim.echogram.echogram import Arrival, Arrivals, Echogram
from soundspaces_sim.echogram.low_response import (
    LowResponse,
    band_gain,
    heard,
    lead_samples,
    response_rate,
    response_samples,
)
from soundspaces_sim.rendering.directivity import Cardioid
from soundspaces_sim.rendering.higher_orders import higher_order_rir
from soundspaces_sim.rendering.low_band import share
from soundspaces_sim.rendering.microphones import MicrophoneArray, array_rir
from soundspaces_sim.rendering.renderers import find_renderer
from soundspaces_sim.rendering.rendering import Rendering
from tests.stats import assert_mean

BANDS, EDGE, C, RATE = ss.SimulationConfig().bands, 176.0, 343.0, 16000
THIRDS = 1000.0 * 10.0 ** (np.arange(-15, 0) / 10.0)  # 31.5 to 800 Hz


def plane_waves(directions: np.ndarray, amplitudes: np.ndarray, delays: np.ndarray) -> LowResponse:
    """Of plane waves from (k, 3), by their closed form."""
    size = 2 * response_samples(EDGE, 0.5)
    frequency = np.fft.rfftfreq(size, 1.0 / response_rate(EDGE))
    shift = lead_samples(EDGE) / response_rate(EDGE)
    wave = amplitudes[:, None] * np.exp(-2j * np.pi * np.outer(delays + shift, frequency))
    first = np.concatenate([np.ones((len(directions), 1)), directions], axis=1)
    spectrum = first.T @ wave * band_gain(frequency, EDGE)
    return LowResponse(EDGE, np.fft.irfft(spectrum, size)[:, : size // 2].astype(np.float32))


def direct_sound(direction: np.ndarray, energy: float = 0.01, delay: float = 0.02) -> Echogram:
    edges = np.linspace(0.0, 0.5, 501)
    none = Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))
    first = Arrival(delay, np.full(4, energy), direction)
    return Echogram(
        BANDS, edges, np.zeros((500, 9, 4), np.float32), first, none, np.zeros((2, 4)), True,
        low=plane_waves(direction[None], np.array([energy**0.5]), np.array([delay])),
    )  # fmt: skip


def unit(*direction: float) -> np.ndarray:
    return np.asarray(np.array(direction) / np.linalg.norm(direction))


def thirds(signal: np.ndarray, rate: int = RATE) -> np.ndarray:
    """(…, 15) energies of `THIRDS` per Hz, of (…, n)."""
    power = np.abs(np.fft.rfft(signal, 1 << 16)) ** 2
    frequency = np.fft.rfftfreq(1 << 16, 1.0 / rate)
    edge = THIRDS * 10.0**0.05
    bands = [(frequency >= e * 10.0**-0.1) & (frequency < e) for e in edge]
    return np.stack([power[..., band].mean(axis=-1) for band in bands], axis=-1)


def test_direct_sound_is_heard_once() -> None:
    """What both parts hold is heard once: a flat spectrum, a clean pulse. The high-pass at 8 Hz is what is left of
    28 Hz on: .05 dB."""
    towards = unit(1.0, 2.0, -0.5)
    for name in ("default", "smooth", "paper"):
        out = find_renderer(name)(direct_sound(towards), RATE, 0)
        level = 10.0 * np.log10(thirds(out[0]) / 0.01)
        assert np.abs(level).max() < 0.06, name
        peak = np.abs(out[0]).argmax()
        assert peak == round(0.02 * RATE)
        np.testing.assert_allclose(out[1:4, peak], out[0, peak] * towards[[1, 2, 0]], rtol=1e-3)
        ringing = out[0, : peak - 40]  # of the sinc alone, and of the high-pass
        assert np.abs(ringing).max() < 2e-3 * out[0, peak]


def test_levels_of_octaves_are_those_of_two_pulses() -> None:
    """Two pulses, t apart, have a mean square of a² + b² + 2 a b times the band's mean of cos(2 pi f t)."""
    a, b, t = 0.1, 0.07, 0.013
    edges = octaves_below(EDGE)
    found = low_levels(plane_waves(np.eye(3)[:2], np.array([a, b]), np.array([0.02, 0.02 + t])), edges)
    sines = np.diff(np.sin(2.0 * np.pi * np.array(edges) * t)) / (2.0 * np.pi * t * np.diff(edges))
    exact = 10.0 * np.log10(4.0 * np.pi * (a**2 + b**2 + 2.0 * a * b * sines))
    np.testing.assert_allclose(found, exact, atol=0.02)
    with pytest.raises(ConfigError, match="edges up to 176 Hz"):
        low_levels(plane_waves(np.eye(3)[:1], np.ones(1), np.zeros(1)), (100.0, 400.0))


def test_the_same_at_any_rate() -> None:
    """One source strength for both, whatever the rates."""
    for rate in (8000, 44100, 96000):
        out = ss.ambisonic_rir(direct_sound(unit(1.0, 0.0, 0.0)), rate)
        assert np.abs(10.0 * np.log10(thirds(out[0], rate) / 0.01)).max() < 0.06, rate


def test_reverberation_is_continuous_in_power() -> None:
    """Independent parts of the same spectrum: noise above, many plane waves below. Flat in the mean."""
    rng, rate = np.random.default_rng(5), 8000
    energy = np.zeros((500, 9, 4), np.float32)
    energy[100:300, 0] = 5e-5  # J/m² a bin, .01 in all
    plain = replace(direct_sound(unit(1.0, 0.0, 0.0)), direct=None, energy=energy)
    frequency = np.fft.rfftfreq(1 << 12, 1.0 / rate)
    spans = [(frequency > low) & (frequency < high) for low, high in ((80, 150), (150, 190), (190, 300))]
    found = []
    for seed in range(150):
        from_ = rng.standard_normal((100, 3))
        from_ /= np.linalg.norm(from_, axis=1, keepdims=True)
        arrive, sign = rng.uniform(0.1, 0.3, 100), rng.choice([-1.0, 1.0], 100)
        low = plane_waves(from_, sign * (0.01 / 100) ** 0.5, arrive)
        power = (
            np.abs(np.fft.rfft(ss.ambisonic_rir(replace(plain, low=low), rate, seed)[:4], 1 << 12)) ** 2
        )
        found.append([power[:, span].mean(axis=1) / 0.01 for span in spans])
    mean = np.array(found)
    assert_mean(mean[:, :, 0], np.ones(3), "energy below, across and above the edge", relative=0.045)
    assert_mean(mean[:, :, 1:].sum(axis=2), np.ones(3), "that of order 1", relative=0.045)


def test_the_crossover_is_flat_for_both() -> None:
    """b + (1 - b) = 1 and b² + (1 - b²) = 1; the waves' own fall begins where b has ended."""
    frequency = np.linspace(0.0, 400.0, 4001)
    b = share(frequency, EDGE)
    assert np.all(np.diff(b) <= 0.0)
    assert np.all(b[frequency <= 0.9 * EDGE] == 1.0)
    assert np.all(b[frequency >= 1.03 * EDGE] < 1e-30)
    whole = band_gain(frequency[(b > 1e-9) & (frequency > 100.0)], EDGE)
    assert np.abs(np.abs(whole) - 1.0).max() < 1e-4


def test_ears_hear_waves_from_where_they_come() -> None:
    """Waves have the ear signals of the echogram's direct sound without order 2, which is what they lack: its share of
    a binaural signal is below 50 us and 1 dB there."""
    combined = direct_sound(unit(0.2, 1.0, 0.0))
    rendering = Rendering(RATE, "default", None, 0, C)
    frequency = np.fft.rfftfreq(1 << 15, 1.0 / RATE)
    band = (frequency > 60.0) & (frequency < 150.0)
    for heading in (0.0, 60.0):
        field = rendering.ambisonic(replace(combined, low=None), 0, 1)
        first = np.concatenate([field[:4], np.zeros_like(field[4:])])
        turn = np.array([[heading, 0.0, 0.0]])
        ears = [rendering.binaural(combined, 0, 1, turn)[0]]
        ears += [rendering.decoded(f, turn)[0] for f in (first, field)]
        ratio = [s[0] / s[1] for s in (np.fft.rfft(e, 1 << 15)[:, band] for e in ears)]
        for other, most in ((1, 0.05), (2, 1.0)):
            between = np.log(ratio[0] / ratio[other])
            assert np.abs(between.imag / (2.0 * np.pi * frequency[band])).max() < 50e-6 * most
            assert np.abs(between.real * 20.0 / np.log(10.0)).max() < most


def test_microphones_hear_waves_where_they_are() -> None:
    """A plane wave at capsules: phases of k o.d to first order of the harmonics, patterns exactly."""
    towards = unit(1.0, 0.4, 0.3)
    combined = direct_sound(towards)
    places = np.array([[0.05, 0.0, 0.0], [-0.05, 0.03, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    array = MicrophoneArray(places, [None, None, Cardioid(), Cardioid(heading_deg=90.0)])
    out = array_rir(combined, array, RATE, 0, C)
    level = 10.0 * np.log10(thirds(out) / 0.01)
    gains = [1.0, 1.0, *(0.5 * (1.0 + towards[:2]))]
    assert np.abs(level - 20.0 * np.log10(gains)[:, None]).max() < 0.1
    frequency = np.fft.rfftfreq(1 << 15, 1.0 / RATE)
    band = (frequency > 40.0) & (frequency < 150.0)
    spectra = np.fft.rfft(out, 1 << 15)[:, band]
    found = np.angle(spectra[0] / spectra[1])
    exact = 2.0 * np.pi * frequency[band] / C * ((places[0] - places[1]) @ towards)
    assert np.abs(found - exact).max() < 0.03 * exact.max()


def test_a_displaced_listener_hears_a_plane_wave_earlier() -> None:
    """Pressure to (k o)² / 3. Of the velocity, whose differences are of order 2, the third that is its divergence."""
    towards, offset = unit(1.0, -1.0, 0.5), np.array([0.08, -0.05, 0.02])
    plain = plane_waves(towards[None], np.ones(1), np.array([0.1]))
    exact = plane_waves(towards[None], np.ones(1), np.array([0.1 - towards @ offset / C]))
    moved = heard(plain, offset, None, C)
    for row, most in ((0, 0.02), (slice(1, 4), 0.15)):
        wanted = np.linalg.norm(exact.signal[row])
        error, unmoved = (np.linalg.norm(x.signal[row] - exact.signal[row]) for x in (moved, plain))
        assert error < most * wanted
        assert error < 0.9 * unmoved


def test_directive_ends() -> None:
    """Cardioids at either end, in a field of one direction: gains of their angles, in all channels."""
    towards = unit(1.0, 0.5, 0.0)
    there, back = direct_sound(towards), direct_sound(-towards)
    source = Cardioid(heading_deg=120.0, level="pattern")
    front = np.array([np.cos(np.radians(120.0)), np.sin(np.radians(120.0)), 0.0])
    out = ss.ambisonic_rir(directed(there, back, source, None, C), RATE)
    gain = 0.5 * (1.0 - front @ towards)
    np.testing.assert_allclose(10.0 * np.log10(thirds(out[0]) / 0.01), 20.0 * np.log10(gain), atol=0.1)
    np.testing.assert_allclose(
        10.0 * np.log10(thirds(out[3]) / thirds(out[0])), 20.0 * np.log10(towards[0]), atol=0.1
    )
    microphone = ss.ambisonic_rir(directed(there, None, None, Cardioid(), C), RATE)[0]
    gain = 0.5 * (1.0 + towards[0])
    np.testing.assert_allclose(
        10.0 * np.log10(thirds(microphone) / 0.01), 20.0 * np.log10(gain), atol=0.1
    )
    with pytest.raises(PairIndexError, match="waves"):
        directed(there, replace(back, low=None), source, None, C)


def test_higher_orders_and_the_direct_renderer() -> None:
    towards = unit(0.0, 1.0, 1.0)
    out = higher_order_rir(direct_sound(towards), RATE, 0, 3)
    assert np.abs(10.0 * np.log10(thirds(out[0]) / 0.01)).max() < 0.06
    assert thirds(out[9:])[:, :6].max() < 1e-3 * 0.01  # nothing of order 3 below 100 Hz
    plain = replace(direct_sound(towards), low=None)
    for echogram in (plain, direct_sound(towards)):
        np.testing.assert_array_equal(
            find_renderer("direct")(echogram, RATE, 0), ss.ambisonic_rir(plain, RATE)
        )
