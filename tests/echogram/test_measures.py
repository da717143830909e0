"""Room measures of decays that are known in closed form."""

import tracemalloc

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram import measures
from soundspaces_sim.echogram.echogram import Arrivals, Echograms
from soundspaces_sim.echogram.measures import (
    echograms_measures,
    energy_measures,
    room_measures,
    waveform_measures,
)
from tests.marks import CI_SLOW
from tests.rooms import box, plain, table


def test_exponential_decay() -> None:
    """E(t) = exp(-13.8155 t / T): T20 = T30 = EDT = T; C, D and Ts in closed form."""
    bin_s, reverb = 0.0005, np.array([0.4, 1.1])
    k = 6.0 * np.log(10.0) / reverb[:, None]
    edges = np.arange(0.0, 4.0, bin_s)
    decay = np.exp(-k * edges[:-1]) - np.exp(-k * edges[1:])
    onset = 0.02
    energy = np.concatenate([np.zeros((2, round(onset / bin_s))), decay], axis=1)
    m = energy_measures(energy, bin_s, onset)
    for measured in (m.t20, m.t30, m.edt):
        np.testing.assert_allclose(measured, reverb, rtol=1e-6)
    k = k[:, 0]
    np.testing.assert_allclose(m.c80, 10 * np.log10(np.exp(0.08 * k) - 1.0), atol=1e-6)
    np.testing.assert_allclose(m.c50, 10 * np.log10(np.exp(0.05 * k) - 1.0), atol=1e-6)
    np.testing.assert_allclose(m.d50, 1.0 - np.exp(-0.05 * k), atol=1e-9)
    np.testing.assert_allclose(m.ts, 1.0 / k, rtol=1e-3)
    assert m.reasons == ()


def test_short_decays_are_nan_with_a_reason() -> None:
    energy = np.exp(-np.arange(300) / 100.0)  # ends 13 dB down
    m = energy_measures(energy[None], 0.001, 0.0)
    assert np.isnan(m.t30[0]) and any("T30, band 0" in r and "needed -45 dB" in r for r in m.reasons)
    silent = energy_measures(np.zeros((1, 10)), 0.001, 0.0)
    assert np.isnan(silent.t30[0]) and any("no energy" in r for r in silent.reasons)


def test_responses_that_were_cut_have_no_time_of_what_is_lost() -> None:
    """A decay of 4 s cut after 1.5 s reaches -22 dB: neither T20 nor T30, though its own curve dives below -45 dB
    before the end; EDT stays. Cut after 3.2 s (-48 dB) all are there, and right to what is lost."""
    time = np.arange(4000) * 1e-3
    energy = 10.0 ** (-6.0 * time / 4.0)[None]
    cut = energy_measures(energy[:, :1500], 1e-3, 0.0)
    assert np.isnan(cut.t20[0]) and np.isnan(cut.t30[0])
    (reason,) = [r for r in cut.reasons if r.startswith("T30, band 0: the decay reaches -22")]
    assert "cut after 1.5 s" in reason and "simulation.max_duration" in reason
    assert cut.edt[0] == pytest.approx(4.0, rel=0.05)
    longer = energy_measures(energy[:, :3200], 1e-3, 0.0)
    assert longer.t20[0] == pytest.approx(4.0, rel=0.01)
    assert longer.t30[0] == pytest.approx(4.0, rel=0.03)


@pytest.mark.parametrize("ratio_db", [-6.0, 0.0, 6.0])
def test_direct_to_reverberant_ratio(ratio_db: float) -> None:
    energy = np.zeros((1, 400))
    energy[0, 30] = 10.0 ** (ratio_db / 10.0)
    energy[0, 60:160] = 0.01
    assert energy_measures(energy, 0.001, 0.03).drr[0] == pytest.approx(ratio_db, abs=1e-9)


@pytest.mark.parametrize(
    ("rate", "absorption"),
    [
        (16000, [0.1, 0.2, 0.3, 0.4]), pytest.param(44100, [0.2] * 4, marks=CI_SLOW),
        pytest.param(16000, [0.4, 0.3, 0.2, 0.1], marks=CI_SLOW),
        pytest.param(44100, [0.4, 0.3, 0.2, 0.1], marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_waveforms_measure_as_their_echograms(rate: int, absorption: list[float]) -> None:
    """Mean over noise seeds: T within 2 %, C within 0.3 dB, from 176 Hz up, beside slower bands as well.

    Below, early arrivals add up as pressures: `waveform_measures` says why C and EDT differ there.
    """
    scene = box((6.0, 5.0, 2.7), table([absorption], 0.5))
    echogram = ss.simulate(scene, [1.5, 2.0, 1.2], [4.3, 3.1, 1.6], plain(walks=1000))[0, 0]
    expected = room_measures(echogram)
    measured = [waveform_measures(ss.ambisonic_rir(echogram, rate, seed)[0], rate) for seed in range(96)]
    for name in ("t20", "t30", "edt"):
        ratio = np.array([getattr(m, name)[1:] for m in measured]) / getattr(expected, name)[1:]
        error = ratio.std(axis=0, ddof=1) / np.sqrt(len(ratio))
        assert np.all(np.abs(ratio.mean(axis=0) - 1.0) < 0.02 + 2.0 * error), (name, ratio.mean(axis=0))
        assert np.all(error < 0.02), (name, error)
    for name in ("c50", "c80"):
        difference = np.array([getattr(m, name)[1:] for m in measured]) - getattr(expected, name)[1:]
        error = difference.std(axis=0, ddof=1) / np.sqrt(len(difference))
        assert np.all(np.abs(difference.mean(axis=0)) < 0.3 + 2.0 * error), (
            name,
            difference.mean(axis=0),
        )
        assert np.all(error < 0.2), (name, error)


def test_waveform_measures_of_an_exact_decay() -> None:
    """Band noise is not needed: a train of pulses that decays as exp(-6.9 t / T) has T in every band."""
    rate, reverb = 16000, 0.7
    t = np.arange(2 * rate) / rate
    ir = np.where(np.arange(len(t)) % 80 == 0, np.exp(-np.log(1e3) * t / reverb), 0.0)
    m = waveform_measures(np.concatenate([np.zeros(500), ir]), rate)
    np.testing.assert_allclose(m.t30[1:], reverb, rtol=0.01)
    with pytest.raises(ConfigError, match="shape"):
        waveform_measures(np.zeros((2, 5)), rate)


def _echograms(energy: np.ndarray, direct: np.ndarray, length: np.ndarray, early: int = 0) -> Echograms:
    """Of (S, L, bins, 4) energies in bins of 1 ms, and so many early arrivals of each pair."""
    rng, shape, pairs = np.random.default_rng(1), energy.shape[:2], energy[:, :, 0, 0].size
    table = np.zeros((*energy.shape[:3], 9, 4), np.float32)
    table[:, :, :, 0] = energy
    arrivals = Arrivals(
        rng.uniform(0.01, 0.05, pairs * early),
        rng.uniform(0.0, 1.0, (pairs * early, 4)),
        np.zeros((pairs * early, 3)),
        np.full((pairs * early, 2), -1),
    )
    return Echograms(
        DEFAULT_BANDS, 343.0, np.zeros((shape[0], 3)), np.ones((shape[1], 3)), np.arange(energy.shape[2] + 1) * 0.001,
        table, direct, length, np.zeros(shape, np.int64), np.arange(pairs + 1) * early, arrivals,
        np.zeros((*shape, 2, 4)),
    )  # fmt: skip


def _measured(echoes: Echograms) -> tuple[dict[str, np.ndarray], int]:
    """Measures, and the bytes that they took at most."""
    tracemalloc.start()
    try:
        return echograms_measures(echoes), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_listeners_are_taken_some_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bits are the same, and memory does not grow with their number."""
    rng, shape = np.random.default_rng(0), (3, 40)
    falling = np.exp(-30.0 * np.arange(400) * 0.001)[:, None]
    direct = rng.uniform(0.0, 5.0, (*shape, 4)) * (rng.uniform(size=shape) < 0.7)[:, :, None]
    energy = rng.gamma(4.0, size=(*shape, 400, 4)) * falling
    echoes = _echograms(energy, direct, rng.uniform(1.0, 9.0, shape), 3)
    whole, most = _measured(echoes)
    assert np.isfinite(whole["t20"]).all()
    for some in (1, 7):
        monkeypatch.setattr(measures, "_AT_ONCE", some * 401 * 4)
        found, less = _measured(echoes)
        assert found.keys() == whole.keys() and less < 0.5 * most
        for name, values in whole.items():
            np.testing.assert_array_equal(found[name], values)


def test_a_delay_that_is_rounded_below_a_bin_is_in_it() -> None:
    """Direct sound of 1 after 30 ms, and .2 from 60 to 100 ms: both ways of measuring begin with it."""
    energy = np.zeros((1, 1, 400, 4))
    energy[:, :, 60:100] = 0.005
    for rounded in (0.0, 1e-15, 1e-13):
        length = np.full((1, 1), 343.0 * 0.03 * (1.0 - rounded))
        echoes = _echograms(energy, np.ones((1, 1, 4)), length)
        single, table = room_measures(echoes[0, 0]), echograms_measures(echoes)
        np.testing.assert_allclose(single.drr, 10.0 * np.log10(1.0 / 0.2), atol=1e-5)
        np.testing.assert_allclose(single.d50, 1.1 / 1.2, atol=1e-5)
        for name in ("drr", "d50", "c50", "ts", "edt"):
            np.testing.assert_allclose(table[name][0, 0], getattr(single, name), rtol=1e-6)


@pytest.mark.parametrize("rounded", [0.0, 1e-15, 1e-13, -1e-13])
def test_direct_sound_that_comes_last_on_a_whole_millisecond(rounded: float) -> None:
    length = np.full((1, 1), 343.0 * 0.03 * (1.0 - rounded))
    echoes = _echograms(np.zeros((1, 1, 20, 4)), np.ones((1, 1, 4)), length)
    found = room_measures(echoes[0, 0])
    np.testing.assert_array_equal(found.d50, 1.0)
    np.testing.assert_array_equal(found.d50, echograms_measures(echoes)["d50"][0, 0])
    assert np.isnan(found.t20).all()
