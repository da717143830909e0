"""What a response has before its first sound: of arrivals their interpolation, of reverberation the ringing of
filters without phase, as large as docs/responses.md states."""

from __future__ import annotations

import numpy as np

import soundspaces_sim as ss
from neighbours.parameters.tests.test_parameters import FRONT, echogram, exponential
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS

RATE, ONSET_S = 16000, 0.1


def _before(rirs: np.ndarray) -> tuple[list[float], float]:
    """(dB per time of windows before the onset re the first 20 ms, share of all energy) of responses (n,
    samples)."""
    energy = (rirs.astype(float) ** 2).sum(axis=0)
    first = round(ONSET_S * RATE)
    after = energy[first : first + round(0.02 * RATE)].mean()
    levels = []
    for near, far in ((0, 1), (1, 2), (2, 5), (5, 10), (10, 20), (20, 50)):
        part = energy[first - round(far * RATE / 1e3) : first - round(near * RATE / 1e3)]
        levels.append(float(10.0 * np.log10(part.mean() / after + 1e-30)))
    return levels, float(energy[:first].sum() / energy.sum())


def test_reverberation_rings_before_its_first_bin_as_stated() -> None:
    silent = np.zeros(round(ONSET_S * 1000))
    found = echogram(np.concatenate([silent, exponential(0.5, 1.0)]), DEFAULT_BANDS, direct=None)
    levels, share = _before(np.stack([ss.ambisonic_rir(found, RATE, seed)[0] for seed in range(30)]))
    np.testing.assert_allclose(levels, [-11.0, -18.0, -23.0, -28.0, -33.0, -40.0], atol=2.0)
    assert 0.002 < share < 0.0035


def test_arrivals_begin_within_a_millisecond() -> None:
    found = echogram(np.zeros(300), DEFAULT_BANDS, direct=(ONSET_S, FRONT, 1.0))
    levels, _ = _before(ss.ambisonic_rir(found, RATE)[:1])
    assert max(levels[1:]) < -150.0
