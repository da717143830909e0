"""Random equalisation below 200 Hz: the levels that were drawn, causal, nothing above."""

from __future__ import annotations

import numpy as np
import pytest
from soundspaces_rooms.low_equalisation import check_deviation, equalised, low_filter

import soundspaces_sim as ss

CENTRES = 200.0 * 2.0 ** (-np.arange(1, 10) / 3.0)


@pytest.mark.parametrize("rate", [8000, 16000, 48000])
def test_the_filter_has_the_gains_at_their_centres_and_none_above(rate: int) -> None:
    gains = np.random.default_rng(0).normal(0.0, 8.0, 9)
    response = low_filter(gains, rate)
    n = 8 * rate
    level = 20.0 * np.log10(np.abs(np.fft.rfft(response, n)))
    frequency = np.fft.rfftfreq(n, 1.0 / rate)
    np.testing.assert_allclose(np.interp(CENTRES, frequency, level), gains, atol=0.5)
    between = np.interp(np.sqrt(CENTRES[0] * CENTRES[1]), frequency, level)
    assert between == pytest.approx(0.5 * (gains[0] + gains[1]), abs=0.5)
    assert np.abs(level[frequency > 230.0]).max() < 0.1
    # of all responses of this spectrum the minimum-phase one has most energy early: here nearly all in its first sample
    assert response[0] ** 2 > 0.9 * (response**2).sum()
    np.testing.assert_allclose(low_filter(np.zeros(9), rate), np.eye(1, rate)[0], atol=1e-9)


def test_the_levels_have_the_stated_deviation_and_are_one_per_source() -> None:
    """Of 300 sources: mean 0 and standard deviation 4 dB at 100 Hz, by z-scores; both microphones the same."""
    rate, count = 2000, 300
    pulse = np.zeros((count, 2, rate), np.float32)
    pulse[:, 0, 5] = pulse[:, 1, 9] = 1.0
    out = equalised(np.random.default_rng(1), pulse, 4.0, rate)
    level = 20.0 * np.log10(np.abs(np.fft.rfft(out, axis=2)[:, :, 100]))
    np.testing.assert_allclose(level[:, 0], level[:, 1], atol=0.05)
    assert abs(level[:, 0].mean()) / (4.0 / np.sqrt(count)) < 3.5
    assert abs(level[:, 0].std() / 4.0 - 1.0) * np.sqrt(2.0 * count) < 3.5
    assert np.abs(out[:, 0, :5]).max() < 1e-6


@pytest.mark.parametrize("wrong", [-1.0, 21.0, float("nan")])
def test_a_deviation_out_of_bounds_is_refused(wrong: float) -> None:
    with pytest.raises(ss.ConfigError, match="low_equalisation_db: expected 0 to 20 dB"):
        check_deviation(wrong)
