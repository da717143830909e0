"""Room measures of decays that are known in closed form."""

import numpy as np
import pytest

from soundspaces_sim.measures import energy_measures, reverberation_time


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
    value, reason = reverberation_time(energy, 0.001, -5.0, -35.0)
    assert np.isnan(value) and "needed -45 dB" in reason
    value, reason = reverberation_time(np.zeros(10), 0.001, -5.0, -35.0)
    assert np.isnan(value) and reason == "no energy"
    m = energy_measures(energy[None], 0.001, 0.0)
    assert np.isnan(m.t30[0]) and any("T30, band 0" in r for r in m.reasons)


@pytest.mark.parametrize("ratio_db", [-6.0, 0.0, 6.0])
def test_direct_to_reverberant_ratio(ratio_db: float) -> None:
    energy = np.zeros((1, 400))
    energy[0, 30] = 10.0 ** (ratio_db / 10.0)
    energy[0, 60:160] = 0.01
    assert energy_measures(energy, 0.001, 0.03).drr[0] == pytest.approx(ratio_db, abs=1e-9)
