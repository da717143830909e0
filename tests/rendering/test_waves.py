"""Reverberation as plane waves has the energy of its echogram and the coherence of its field."""

import numpy as np
import pytest

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.numerics.axes import spherical_harmonics
from soundspaces_sim.echogram.echogram import Arrivals, Echogram
from soundspaces_sim.rendering.harmonics import harmonics_n3d
from soundspaces_sim.rendering.soundfield import convert
from soundspaces_sim.rendering.waves import WAVES, WaveField, lattice, shares
from tests.marks import few
from tests.stats import assert_mean

BANDS, RATE = SimulationConfig().bands, 40000  # Nyquist is the highest edge: nothing is cut off
C = 343.0


def tail(moments: np.ndarray, bins: int = 40) -> Echogram:
    """Bins of 5 ms from 0.1 s on with 1 J/m² in all and the given moments (9,), alike in every band."""
    energy = np.zeros((20 + bins, 9, len(BANDS) - 1), np.float32)
    energy[20:] = (moments / bins)[:, None]
    none = Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))
    edges = np.arange(len(energy) + 1) * 0.005
    return Echogram(BANDS, edges, energy, None, none, np.zeros((2, 4)), False)


N = 16000  # 0.4 s: 0.1 s around the energy, so that no filter's ringing is cut off
DIFFUSE = np.eye(9)[0]


@pytest.mark.parametrize("waves", few([1, WAVES], 1))
def test_energy_is_that_of_the_echogram(waves: int) -> None:
    def run(seed: int) -> float:
        field = WaveField(tail(DIFFUSE), N, RATE, seed, waves)
        return float((field.at(np.array([[0.1, 0.0, 0.05]]), np.ones((1, waves)), C) ** 2).sum())

    assert_mean(np.array([run(seed) for seed in range(24)]), 1.0, "energy", relative=0.01)


def test_diffuse_coherence_is_a_sinc() -> None:
    """Real part of the coherence of two points in a diffuse field: sin(k r) / (k r) (Cook et al. 1955)."""
    apart, low, high = 0.08, 500.0, 6000.0
    frequency = np.fft.rfftfreq(N, 1.0 / RATE)
    use = (frequency >= low) & (frequency <= high)
    expected = np.sinc(2.0 * frequency[use] * apart / C)
    ones = np.ones((2, WAVES))
    axes = np.eye(3)
    cross, power = np.zeros(use.sum()), np.zeros(use.sum())
    for seed in range(16):
        field = WaveField(tail(DIFFUSE), N, RATE, seed)
        places = np.array([np.zeros(3), apart * axes[seed % 3]])
        middle, beside = np.fft.rfft(field.at(places, ones, C))[:, use]
        cross += (middle * beside.conj()).real
        power += 0.5 * (np.abs(middle) ** 2 + np.abs(beside) ** 2)
    smooth = np.ones(200) / 200.0  # 500 Hz
    got = np.convolve(cross, smooth, "valid") / np.convolve(power, smooth, "valid")
    assert np.abs(got - np.convolve(expected, smooth, "valid")).max() < 0.08


def _directions(count: int, seed: int) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


@pytest.mark.parametrize(("few", "bound"), [(1, 0.1), (3, 0.06), (30, 0.01)])
def test_shares_have_the_moments_they_are_made_of(few: int, bound: float) -> None:
    """First moments of one, three and thirty directions. One direction lies up to 10 degrees from the nearest of
    192, and no shares can beat the chord across the lattice there; else the bias is the ridge's, lambda / 333."""
    given = np.mean([spherical_harmonics(_directions(300, i)) for i in range(few)], axis=0)[:, 1:]
    got = shares(given, lattice())
    assert (got >= 0.0).all()
    np.testing.assert_allclose(got.sum(axis=1), 1.0)
    first = got @ lattice()
    off = np.linalg.norm(first - given[:, [2, 0, 1]], axis=1)  # ACN: y, z, x
    assert off.max() < bound
    assert np.array_equal(shares(given[:7], lattice()), got[:7])


def test_a_field_in_one_plane_stays_in_it() -> None:
    """Sound from all round but not from above or below: the mean of z² is 0, a diffuse field's is 1/3."""
    angle = np.arange(90) * np.pi / 45.0
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    moments = spherical_harmonics(ring).mean(axis=0)[None, 1:]
    got = shares(moments, lattice())[0]
    assert got @ lattice()[:, 2] ** 2 < 0.03
    assert 1.0 / (got**2).sum() > 10.0  # and from all round it comes


def test_a_wave_from_one_side_arrives_there_first() -> None:
    """Moments of a plane wave from +x: the first-order signal is that of pressure, and a point nearer to where
    it comes from hears it earlier."""
    moments = spherical_harmonics(np.array([1.0, 0.0, 0.0]))
    field = WaveField(tail(moments), N, RATE, 3)
    weights = spherical_harmonics(field.directions).T
    signal = field.at(np.zeros((9, 3)), weights, C)
    assert (signal[3] * signal[0]).sum() == pytest.approx((signal[0] ** 2).sum(), rel=0.05)
    ahead = field.at(np.array([[0.1, 0.0, 0.0]]), weights[:1], C)[0]
    lags = np.arange(-30, 31)
    score = [(signal[0, 40:-40] * ahead[40 - lag : len(ahead) - 40 - lag]).sum() for lag in lags]
    assert lags[int(np.argmax(score))] == pytest.approx(0.1 / C * RATE, abs=1.0)


def test_n3d_harmonics() -> None:
    """Orders 0 to 2 against the package's own, order 3 against values read off the original."""
    d = np.random.default_rng(0).normal(size=(50, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    np.testing.assert_allclose(
        harmonics_n3d(d, 3)[:, :9], convert(spherical_harmonics(d).T, "n3d").T, atol=1e-12
    )
    read_off = np.array([0.0827, 0.1831, 0.079, -0.0781, 0.0988, 0.0412, -0.0403]) / 0.097
    np.testing.assert_allclose(
        harmonics_n3d(np.array([[0.6, 0.48, 0.64]]), 3)[0, 9:], read_off, atol=0.004
    )
    np.testing.assert_allclose((harmonics_n3d(d, 3)[:, 9:] ** 2).sum(axis=1), 7.0)
    np.testing.assert_allclose(harmonics_n3d(np.zeros((1, 3)), 3)[0], np.eye(16)[0], atol=1e-15)
