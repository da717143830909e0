"""Scores of tasks against what is known of them."""

from __future__ import annotations

import numpy as np
import pytest
from soundspaces_tasks import (
    decays,
    dereverberation,
    location,
    prediction,
    reverberation,
    speech,
)
from soundspaces_tasks.fits import ridge, weighted_mean
from soundspaces_tasks.results import interval, root
from soundspaces_tasks.setting import RATE

import soundspaces_sim as ss
from soundspaces_sim.echogram.measures import BIN_S


def test_intervals_hold_the_mean_as_often_as_they_say() -> None:
    """Of 300 draws of five homes and three seeds with effects of their own, items in homes of different sizes."""
    rng = np.random.default_rng(1)
    home = np.repeat(np.arange(5), (4, 6, 5, 7, 3))
    inside = 0
    for k in range(300):
        values = (
            rng.normal(size=5)[home]
            + 0.5 * rng.normal(size=(3, 1))
            + 0.5 * rng.normal(size=(3, len(home)))
        )
        found = interval(values, home, seed=k)
        inside += found.low <= 0.0 <= found.high
    # A crossed bootstrap is conservative: 95 % at least, as a binomial count allows, and not always.
    assert 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / 300) < inside / 300 < 0.995


def test_the_standard_error_is_that_of_means_of_homes() -> None:
    means = np.array([1.0, 2.0, 4.0, 8.0, 9.0, 3.0])
    found = interval(np.repeat(means, 4)[None], np.repeat(np.arange(6), 4))
    assert found.mean == pytest.approx(means.mean())
    assert found.error == pytest.approx(means.std(ddof=1) / np.sqrt(6), rel=0.06)  # of 2,000 draws
    assert found.high - found.mean == pytest.approx(2.5706 * found.error, rel=1e-4)  # Student, 5 degrees


def test_weights_and_missing_items() -> None:
    values = np.array([[1.0, 3.0, np.nan, 100.0]])
    found = interval(values, np.array([0, 1, 1, 1]), np.array([1.0, 3.0, 1.0, 0.0]))
    assert found.mean == pytest.approx(2.5)
    alone = interval(values[:, :1], np.array([0]))
    assert np.isnan(alone.low) and str(alone).endswith("(no interval)")
    with pytest.raises(ss.ConfigError, match="finite"):
        interval(np.array([[1.0, np.inf]]), np.array([0, 1]))
    with pytest.raises(ss.ConfigError, match="finite"):
        interval(np.array([[1.0, np.nan], [1.0, 1.0]]), np.array([0, 1]))
    with pytest.raises(ss.ConfigError, match="no item"):
        interval(np.array([[np.nan]]), np.array([0]))
    assert root(np.array(-0.1)) == 0.0 and root(np.array(9.0)) == 3.0


def test_the_noise_of_labels_is_not_counted() -> None:
    """Estimates off by 0.3, labels that scatter by their standard errors: the score is 0.3."""
    rng = np.random.default_rng(0)
    truth, errors = rng.normal(size=(8000, 3)), rng.uniform(0.1, 0.8, (8000, 3))
    labels = truth + errors * rng.standard_normal((8000, 3))
    weights = reverberation.label_weights(labels, errors, np.ones(3))
    assert weights[0, 0] == pytest.approx(1.0 / (errors[0, 0] ** 2 + 1.0))
    found = reverberation.weighted_scores(
        truth[None] + 0.3, labels, errors, weights, np.repeat(np.arange(20), 400)
    )
    for one in found:
        assert one.error < 0.03 and abs(one.mean - 0.3) < 3.0 * one.error
    labels[0, 0] = np.nan
    assert reverberation.label_weights(labels, errors, np.ones(3))[0, 0] == 0.0


@pytest.mark.parametrize("t60", [0.3, 0.9])
def test_rates_of_an_ideal_decay(t60: float) -> None:
    """Exactly -60 / T60 dB per s; of decaying noise, in the mean of its bands."""
    time = np.arange(60) * speech.HOP / RATE
    rates = reverberation.decay_rates(np.tile(-60.0 * time[:, None] / t60, 3))
    np.testing.assert_allclose(rates, -60.0 / t60, rtol=1e-9)
    n = int(0.8 * t60 * RATE)
    noise = np.random.default_rng(0).standard_normal(n) * 10.0 ** (-3.0 * np.arange(n) / RATE / t60)
    log = speech.log_energies(np.abs(speech.spectra(noise)) ** 2, speech.mel_bands(32)[16:])
    slopes = reverberation.decay_rates(log).mean(axis=0)
    error = slopes.std(ddof=1) / np.sqrt(len(slopes))
    assert error < 0.06 * 60.0 / t60 and abs(slopes.mean() + 60.0 / t60) < 3.0 * error


def test_decay_rate_features_rise_as_rooms_get_drier() -> None:
    time = np.arange(100)[:, None] * speech.HOP / RATE
    live, dry = (reverberation.rate_features(np.tile(-60.0 * time / t, 32)) for t in (1.0, 0.5))
    np.testing.assert_allclose(dry - live, np.log(2.0), rtol=1e-6)
    assert np.isfinite(reverberation.rate_features(np.ones((100, 32)))).all()


@pytest.mark.parametrize("t60", [0.4, 1.2])
def test_measures_of_an_ideal_decay(t60: float) -> None:
    rate = np.log(1e6) / t60
    curve = decays.curve_of(3.0 * np.exp(-rate * np.arange(decays.LENGTH) * BIN_S))
    t30, c50, edt = decays.measures_of(curve)
    assert t30 == pytest.approx(t60, rel=2e-3) and edt == pytest.approx(t60, rel=2e-3)
    assert c50 == pytest.approx(10.0 * np.log10(np.exp(rate * 0.05) - 1.0), abs=0.01)
    level = 10.0 * np.log10(3.0 / (1.0 - np.exp(-rate * BIN_S)))
    assert curve[0] == pytest.approx(level, abs=1e-6)
    again = decays.from_knots(decays.at_knots(curve[None]))[0]
    heard = curve - curve[0] > -45.0  # to where T30 asks; the floor lies between knots
    np.testing.assert_allclose(again[heard], curve[heard], atol=1e-3)


def test_curves_from_knots_fall() -> None:
    knots = np.zeros((2, len(decays.KNOTS_S)))
    knots[1] = np.linspace(0.0, 5.0, len(decays.KNOTS_S))
    curves = decays.from_knots(knots)
    assert (np.diff(curves, axis=1) <= -0.999 * decays.SLOWEST_DB_S * BIN_S).all()
    assert curves.shape == (2, decays.LENGTH)


def test_differences_of_known_curves() -> None:
    time = np.arange(decays.LENGTH) * BIN_S
    curves = np.maximum(-60.0 * time[None] / np.array([[1.0], [0.8]]), decays.FLOOR_DB)
    labels = np.array([decays.measures_of(c) for c in curves])
    data = decays.Examples(curves, curves[:, None], np.ones((2, 3)), labels, 0.0 * labels, np.arange(2))
    found = prediction.differences(curves[::-1] + 2.0, data, np.arange(2))
    np.testing.assert_allclose(found[:, 0], (20.0, 25.0), rtol=5e-3)
    np.testing.assert_allclose(found[:, 2], 200.0, rtol=5e-3)
    # From 0 to 0.5 s the faster one falls by 15 dB/s more: 3.75 dB in the mean; 3 dB to 0.4 s.
    np.testing.assert_allclose(found[:, 3], (3.75, 3.0), rtol=5e-3)
    np.testing.assert_allclose(found[:, 4], 2.0)
    labels[1, 0] = np.nan  # not measured: not scored
    level = np.where(time[None] < 1.9, 0.0, decays.FLOOR_DB) * np.ones((2, 1))  # of no T30
    none = prediction.differences(level, data, np.arange(2))
    assert none[0, 0] == pytest.approx(100.0) and np.isnan(none[1, 0]) and np.isfinite(none[:, 1:]).all()
    labels[1, 0] = decays.measures_of(curves[1])[0]
    own = prediction.differences(curves, data, np.arange(2))
    np.testing.assert_allclose(own, 0.0, atol=1e-9)


def test_weights_of_references() -> None:
    count = decays.REFERENCES
    distances = np.zeros((1, 1 + 2 * count))
    distances[0, 1 + count :] = 0.9 + 2.0 * np.arange(count)[::-1]
    assert prediction.nearest(distances)[0].tolist() == [0.0] * (count - 1) + [1.0]
    share = prediction.inverse_distance(distances)[0]
    assert share.sum() == pytest.approx(1.0) and share[-1] / share[-2] == pytest.approx(3.0)
    assert prediction.mean(distances).sum() == pytest.approx(1.0)


def test_speech_is_drawn_by_seed_and_level() -> None:
    one, again, other = (speech.dry_speech(2.0, np.random.default_rng(k)) for k in (0, 0, 1))
    assert len(one) == 2 * RATE and (one == again).all() and (one != other).any()
    assert np.mean(one**2) == pytest.approx(1.0)
    delayed = np.zeros((2, 100))
    delayed[0, 10], delayed[1, 20] = 0.5, 0.25
    wet = speech.heard(one, delayed)
    np.testing.assert_allclose(wet[0, 10:] / wet[0, 10:].std(), one[:-10] / one[:-10].std(), atol=2e-2)
    assert np.mean(wet[0] ** 2) == pytest.approx(1.0)
    with pytest.raises(ss.ConfigError, match="response"):
        speech.heard(one, np.zeros((1, 10)))


def test_spectra_and_back() -> None:
    x = np.random.default_rng(0).standard_normal(20 * speech.HOP)
    inside = slice(speech.HOP, -speech.HOP)
    np.testing.assert_allclose(
        speech.signal_of(speech.spectra(x), len(x))[inside], x[inside], atol=1e-12
    )
    peaks = speech.mel_bands(24)
    assert peaks.shape == (24, speech.FRAME // 2 + 1) and (peaks.max(axis=1) > 0.4).all()


def test_fits() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(5000, 3))
    y = x @ np.array([[1.0, 0.0], [-2.0, 0.5], [0.0, 3.0]]) + 4.0
    y[0] = np.nan
    weights = np.where(np.isfinite(y), 1.0, 0.0)
    found = ridge(x, y, weights)(x[1:])
    np.testing.assert_allclose(found, y[1:], atol=0.02)
    assert weighted_mean(np.array([[1.0], [5.0], [np.nan]]), np.array([[3.0], [1.0], [0.0]])) == 2.0


def test_signal_to_distortion_ratio() -> None:
    """Scaled copies have no distortion; an orthogonal part of a tenth of the energy is 10 dB."""
    rng = np.random.default_rng(0)
    target, other = rng.standard_normal((2, 4000))
    other -= (other @ target) / (target @ target) * target
    other *= np.linalg.norm(target) / np.linalg.norm(other)
    for gain in (1e-3, -1.0, 40.0):
        assert dereverberation.si_sdr(gain * target, target) > 150.0
        mixed = gain * (target + other / np.sqrt(10.0))
        assert dereverberation.si_sdr(mixed, target) == pytest.approx(10.0)


def test_spectral_distance() -> None:
    """None of a scaled copy; of 6 dB in half of the time, 6 dB there after the common gain is known."""
    x = np.random.default_rng(0).standard_normal(64 * speech.HOP)
    assert dereverberation.spectral_distance(3.0 * x, x) < 1e-9
    y = np.sqrt(10.0) * x
    y[: len(x) // 2] = x[: len(x) // 2]
    common = 10.0 * np.log10(5.5)  # mean power of the two halves
    expected = (common + (10.0 - common)) / 2.0
    assert dereverberation.spectral_distance(y, x) == pytest.approx(
        expected, abs=0.25
    )  # edges of frames


@pytest.mark.parametrize("t60", [0.4, 0.8])
def test_late_reverberation_of_a_steady_sound(t60: float) -> None:
    """Its power after 50 ms is that of all, less 60 dB x 0.048 s / T60 (three frames)."""
    power = np.full((40, 5), 2.0)
    frames = round(dereverberation.EARLY_S * RATE / speech.HOP)
    late = dereverberation.late_power(power, t60)
    assert (late[:frames] == 0.0).all()
    expected = 2.0 * 10.0 ** (-6.0 * frames * speech.HOP / RATE / t60)
    np.testing.assert_allclose(late[frames:], expected)
    gains = dereverberation.subtraction_gains(power, t60)
    np.testing.assert_allclose(gains[frames:], max(1.0 - np.sqrt(expected / 2.0), 0.1))
    assert (dereverberation.subtraction_gains(0.0 * power, t60) == 1.0).all()


def _plane_wave(azimuth_deg: float, elevation_deg: float, signal: np.ndarray) -> np.ndarray:
    a, e = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    gains = (1.0, np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e))  # ACN, SN3D
    return np.outer(gains, signal)


@pytest.mark.parametrize("azimuth", [-170.0, -45.0, 0.0, 100.0])
def test_intensity_of_a_plane_wave(azimuth: float) -> None:
    """Points to where it comes from, also from a head that is turned; none of it is diffuse."""
    signal = np.random.default_rng(0).standard_normal(4000)
    for heading in (0.0, 77.0):
        heard = location.turned(_plane_wave(azimuth, 20.0, signal), heading)
        towards, energy = location.intensity_of(speech.spectra(heard))
        found = location.azimuth_of(towards.sum(axis=(0, 1)))
        assert location.angle_between(found, np.array(azimuth - heading)) < 1e-6
        np.testing.assert_allclose(np.linalg.norm(towards, axis=-1), energy, rtol=1e-9)
        np.testing.assert_allclose(location.diffuseness_of(towards, energy), 0.0, atol=1e-9)


def test_diffuseness_of_waves_from_everywhere() -> None:
    """Independent noise from eight opposite pairs of directions: nearly all of it."""
    rng = np.random.default_rng(0)
    sound = sum(
        _plane_wave(a, e, rng.standard_normal(160_000))
        for a in range(0, 360, 45)
        for e in (-35.26, 35.26)
    )
    towards, energy = location.intensity_of(speech.spectra(np.asarray(sound)))
    found = location.diffuseness_of(towards.sum(axis=1)[:, None], energy.sum(axis=1)[:, None])
    assert found[0] > 0.98


def test_angles_between() -> None:
    found = location.angle_between(np.array([179.0, 10.0, 0.0]), np.array([-179.0, 350.0, 180.0]))
    np.testing.assert_allclose(found, (2.0, 20.0, 180.0))
