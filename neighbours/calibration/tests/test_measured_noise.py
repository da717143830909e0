"""Measured responses end in noise: measures as without it, or none."""

import numpy as np
from soundspaces_calibration.measured.responses import response_measures, without_noise
from soundspaces_calibration.measured.room import MEASURED

from soundspaces_sim.core.numerics.bands import fractional_octaves
from soundspaces_sim.echogram.measures import band_energies, energy_measures
from tests.stats import z_scores

RATE, TIME, LENGTH = 6000, 0.5, 1.2  # Hz, s, s
EDGES = tuple(fractional_octaves(1, 125.0, 2000.0)[0].tolist())


def _responses(count: int, noise_db: float) -> np.ndarray:
    """Noise that decays by 60 dB in `TIME` from 20 ms on, in steady noise at this level re its start."""
    rng = np.random.default_rng(7)
    time = np.arange(int(LENGTH * RATE)) / RATE - 0.02
    decay = np.where(time >= 0.0, 10.0 ** (-3.0 * np.maximum(time, 0.0) / TIME), 0.0)
    steady = 10.0 ** (noise_db / 20.0)
    one, two = rng.standard_normal((2, count, len(time)))
    return np.asarray(one * decay + two * steady)


def test_measures_as_without_noise() -> None:
    """40 responses with noise at -54 dB, whose T30 would be 2 % too long or more, against the same ones without: means
    within 1 % and .05 dB. From 500 Hz on also against the exponential decay, z below 4.5; below, few degrees of freedom and
    the filters' ringing shift means with or without noise."""
    found, quiet = (
        np.array([response_measures(r, RATE, EDGES) for r in _responses(40, level)])
        for level in (-54.0, -200.0)
    )
    assert np.isnan(found).any(axis=1).sum() <= 2 and np.isfinite(found[:, :, 1:]).all()
    means = np.nanmean(found, axis=0), np.nanmean(quiet, axis=0)
    np.testing.assert_allclose(means[0][:2], means[1][:2], rtol=0.01)
    np.testing.assert_allclose(means[0][2:], means[1][2:], atol=0.05)
    k = 6.0 * np.log(10.0) / TIME
    closed = (TIME, TIME, 10.0 * np.log10(np.exp(0.08 * k) - 1.0), 1.0 - np.exp(-0.05 * k))
    for m, expected in enumerate(closed):
        assert np.abs(z_scores(found[:, m, 2:], expected)).max() < 4.5
    assert (found[:, 0, 2:].std(axis=0) / np.sqrt(40) < 0.01 * TIME).all()
    whole = [
        energy_measures(band_energies(r, RATE, EDGES)[0], 1.0 / RATE, 0.02) for r in _responses(8, -54.0)
    ]
    assert (np.mean([w.t30 for w in whole], axis=0) > 1.02 * TIME).all()


def test_what_noise_hides_is_not_measured() -> None:
    """Noise at -38 dB: no T30, whose range needs -45; EDT is there."""
    found = np.array([response_measures(r, RATE, EDGES) for r in _responses(4, -38.0)])
    assert np.isnan(found[:, MEASURED.index("t30")]).all()
    assert np.isfinite(found[:, MEASURED.index("edt")]).all()
    loud = np.array([response_measures(r, RATE, EDGES) for r in _responses(4, -6.0)])
    assert np.isnan(loud[:, :2]).all()


def test_a_decay_without_noise_stays() -> None:
    """Of an exact decay, cut at its end: the sum with its continuation is the whole, to .1 %."""
    step = 1.0 / RATE
    energy = 10.0 ** (-6.0 * np.arange(int(0.6 * RATE)) * step / TIME)
    whole, reached = without_noise(energy, RATE)
    expected = 1.0 / (1.0 - 10.0 ** (-6.0 * step / TIME))
    assert abs(whole.sum() / expected - 1.0) < 1e-3
    assert reached < -45.0
