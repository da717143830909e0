"""Octaves and thirds of echograms in other bands: what is exact, and how far off the rest is."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
import soundspaces_parameters
from soundspaces_parameters.band_pieces import pieces_of
from soundspaces_parameters.evaluate import Conditions, Pair, bands_of

import soundspaces_sim as ss
from neighbours.parameters.tests.test_parameters import FRONT, echogram
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.core.numerics.air import Air
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS, band_means, fractional_octaves

OCTAVES, THIRDS = (tuple(fractional_octaves(n, 100.0, 5000.0)[0].tolist()) for n in (1, 3))


def random_echogram(bands: tuple[float, ...], seed: int = 0, air: Air | None = None) -> ss.Echogram:
    rng = np.random.default_rng(seed)
    energy = rng.exponential(1.0, (300, len(bands) - 1)) * np.exp(-np.arange(300) / 60.0)[:, None]
    arrivals = tuple((t, FRONT, e) for t, e in rng.uniform(0.05, 0.2, (3, 2)))
    found = echogram(energy, bands, arrivals=arrivals, direct=(0.01, FRONT, 2.0))
    found.energy[:, 3] = 0.5 * found.energy[:, 0]
    return ss.Echogram(**{**vars(found), "air": air})


def test_bands_that_were_simulated_come_back() -> None:
    found = random_echogram(OCTAVES, air=Air())
    assert soundspaces_parameters.in_bands(found, OCTAVES) is found
    near = tuple(1.01 * e for e in OCTAVES)  # an edge within 2 % is the stored one
    again = soundspaces_parameters.in_bands(found, near)
    np.testing.assert_allclose(again.energy, found.energy, rtol=2e-6)
    np.testing.assert_allclose(again.early.energy, found.early.energy, rtol=1e-9)
    assert again.direct is not None and found.direct is not None
    np.testing.assert_allclose(again.direct.energy, found.direct.energy, rtol=1e-9)


def test_thirds_add_up_to_their_octaves() -> None:
    """An octave of sound with the same energy at every frequency: its thirds weighted by their widths in Hz,
    without air and with it."""
    low, high = (int(np.abs(np.array(THIRDS) - edge).argmin()) for edge in OCTAVES[1:3])
    width = np.diff(THIRDS[low : high + 1]) / (OCTAVES[2] - OCTAVES[1])
    for air in (None, Air()):
        found = random_echogram(THIRDS, air=air)
        octave = soundspaces_parameters.in_bands(found, OCTAVES[1:3])
        expected = found.energy[:, :, low:high] @ width
        np.testing.assert_allclose(octave.energy[:, :, 0], expected, rtol=1e-5)
        np.testing.assert_allclose(octave.energy[:, 3], 0.5 * octave.energy[:, 0], rtol=1e-5)


def test_a_spectrum_that_is_a_straight_line_is_found() -> None:
    """Decay rates linear over log frequency: octaves within inner bands get theirs exactly."""
    bands = tuple(100.0 * 4.0 ** np.arange(6.0))
    centre = np.log2(np.sqrt(np.array(bands[1:]) * bands[:-1]))
    times = (np.arange(300) + 0.5) * 0.001

    def of(log_frequency: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(-times[:, None] * (5.0 + 2.0 * log_frequency)))

    found = echogram(of(centre), bands, direct=None)
    octaves = tuple(400.0 * 2.0 ** np.arange(7.0))  # the inner bands, in halves
    got = soundspaces_parameters.in_bands(found, octaves).energy[:, 0]
    expected = of(np.log2(np.sqrt(np.array(octaves[1:]) * octaves[:-1])))
    np.testing.assert_allclose(got, expected, rtol=1e-4)
    stairs = soundspaces_parameters.in_bands(found, octaves, staircase=True).energy[:, 0]
    np.testing.assert_allclose(stairs, np.repeat(of(centre)[:, 1:4], 2, axis=1), rtol=1e-4)


def test_air_is_that_of_the_octave() -> None:
    """A room without any absorption but the air's: octaves fall as ISO 9613-1 has it for them, not for their
    band."""
    air = Air()
    times = (np.arange(1000) + 0.5) * 0.001
    found = echogram(air.transmission(DEFAULT_BANDS, 343.0 * times), DEFAULT_BANDS, direct=None)
    found = ss.Echogram(**{**vars(found), "air": air})
    got = soundspaces_parameters.in_bands(found, OCTAVES).energy[:, 0]
    expected = air.transmission(OCTAVES, 343.0 * times)
    np.testing.assert_allclose(got[:, [0, 1, 2, 4]], expected[:, [0, 1, 2, 4]], rtol=2e-3)
    # 1 and 4 kHz lie across an edge: they are sums of two parts
    np.testing.assert_allclose(got, expected, rtol=2e-3)


@pytest.mark.parametrize("seed", range(5))
def test_no_octave_lies_beyond_its_neighbours(seed: int) -> None:
    """Random bands that differ by up to 90 dB, and empty ones: energies stay within those of the bands around."""
    rng = np.random.default_rng(seed)
    energy = 10.0 ** rng.uniform(-9.0, 0.0, (200, 4)) * (rng.random((200, 4)) < 0.9)
    found = echogram(energy, DEFAULT_BANDS, direct=None)
    thirds = soundspaces_parameters.in_bands(found, THIRDS).energy[:, 0]
    assert np.isfinite(thirds).all() and (thirds >= 0.0).all()
    stored = found.energy[:, 0]
    floor = 1.01e-9 * stored.max(axis=1, keepdims=True)
    for k, f in enumerate(np.sqrt(np.array(THIRDS[1:]) * THIRDS[:-1])):
        b = int(np.searchsorted(DEFAULT_BANDS, f)) - 1
        around = stored[:, max(b - 1, 0) : b + 2]
        assert (thirds[:, k] <= around.max(axis=1) * 1.0001 + floor[:, 0]).all()


def test_the_error_of_interpolation_is_that_of_real_materials() -> None:
    """Rooms of six of the library's materials, known in octaves and simulated in four bands: the reverberation
    times of octaves are off by as much as is stated, root mean square, and by half as much as those of a
    staircase."""
    with resource("materials", "materials.toml").open("rb") as file:
        library = tomllib.load(file)
    frequency = np.array(library["frequency_hz"], float)
    tables = np.unique([m["absorption"] for m in library["materials"].values()], axis=0)
    rng = np.random.default_rng(0)
    times = np.arange(1500) * 0.001
    z, plain, stairs = [], [], []
    for _ in range(40):
        share = rng.dirichlet(np.ones(6))
        alpha = share @ tables[rng.integers(0, len(tables), 6)]
        truth = 0.05 / alpha  # Sabine: T over a constant
        stored = 0.05 / band_means(frequency, alpha, DEFAULT_BANDS)
        decays = np.exp(-6.0 * np.log(10.0) * times[:, None] / stored)
        pair = Pair(echogram(decays, DEFAULT_BANDS), bands_of("octaves", DEFAULT_BANDS), Conditions())
        octaves = [pair.bands.centre.index(f) for f in frequency]
        got = pair.values("t20")
        value, error = got.value[octaves], got.interpolation[octaves]
        use = np.isfinite(value) & np.isfinite(truth)
        assert use.sum() >= 5
        z.append(np.sum((value - truth)[use] ** 2) / np.sum(error[use] ** 2))
        plain.append(np.mean(np.log(value / truth)[use] ** 2))
        edges = pair.bands.edges
        rough = soundspaces_parameters.in_bands(pair.stored, edges, staircase=True)
        flat = soundspaces_parameters.room_parameters(rough, "t20", edges)["t20"][0][octaves]
        stairs.append(np.mean(np.log(flat / truth)[use] ** 2))
    assert 0.5 < np.sqrt(np.median(z)) < 1.3, np.sqrt(np.median(z))
    assert np.sqrt(np.mean(plain)) < 0.10, np.sqrt(np.mean(plain))
    assert np.sqrt(np.mean(plain)) < 0.7 * np.sqrt(np.mean(stairs))


def test_pieces_fill_what_is_asked_for() -> None:
    p = pieces_of(DEFAULT_BANDS, OCTAVES)
    np.testing.assert_allclose(p.means(np.ones(len(p.stored))), 1.0)
    assert (p.filled > 0.0).all() and (p.filled <= 1.0 + 1e-12).all() and (np.abs(p.offset) < 1.1).all()
    for wrong in ((0.0, 100.0), (100.0, 30000.0), (200.0, 100.0), (np.nan, 100.0)):
        with pytest.raises(ss.ConfigError):
            pieces_of(DEFAULT_BANDS, wrong)
