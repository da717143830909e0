"""The renderer without a staircase, and tails without holes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from soundspaces_renderers.smooth import _steps, continued, smooth_rir, step_energies

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.echogram import Arrivals
from soundspaces_sim.rendering.renderers import find_renderer

NONE = Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))
EDGES = np.arange(1001) * 0.001


def _table() -> np.ndarray:
    """Exponential decays with reverberation times 0.9, 0.7, 0.5, 0.3 s, 0 to -7 dB at first; diffuse."""
    table = np.zeros((1000, 9, 4), np.float32)
    decay = 10.0 ** (-6.0 * (EDGES[:-1, None] + 0.0005) / np.array([0.9, 0.7, 0.5, 0.3]))
    table[:, 0] = decay * [1.0, 0.5, 0.3, 0.2]
    return table


def _echogram(table: np.ndarray) -> ss.Echogram:
    return ss.Echogram(DEFAULT_BANDS, EDGES, table, None, NONE, np.zeros((2, 4)), True)


def test_means_over_bands_are_kept() -> None:
    """Whatever the levels, within 60 dB of each other: to 0.001 dB."""
    wanted = 10.0 ** np.random.default_rng(0).uniform(-6.0, 0.0, (500, 4))
    got = step_energies(wanted, DEFAULT_BANDS) @ _steps(DEFAULT_BANDS).mean.T
    np.testing.assert_allclose(10.0 * np.log10(got / wanted), 0.0, atol=1e-3)
    flat = step_energies(np.ones((1, 4)), DEFAULT_BANDS)
    np.testing.assert_allclose(flat, 1.0, rtol=1e-12)
    assert np.all(step_energies(np.zeros((2, 4)), DEFAULT_BANDS) == 0.0)


def test_levels_are_monotone_between_centres() -> None:
    falling = step_energies(np.array([[1.0, 0.1, 0.02, 0.001]]), DEFAULT_BANDS)[0]
    assert np.all(np.diff(falling) <= 0.0)


def test_no_step_at_the_edges_and_the_same_octaves() -> None:
    """Mean spectrum of 60 seeds. Either side of an edge (a sixth of an octave each): the default steps by
    what the bands differ, more than 3 dB at each edge; smooth by less than 1 dB. Energies per band and
    100 ms as the echogram says, within 0.5 dB."""
    rate, seeds = 44100, 60
    echogram = _echogram(_table())
    frequency = np.fft.rfftfreq(rate, 1.0 / rate)
    for name, low, high in (("default", 3.0, 5.0), ("smooth", 0.0, 1.0)):
        make = find_renderer(name)
        rirs = [make(echogram, rate, seed)[0].astype(float) for seed in range(seeds)]
        power = np.mean([np.abs(np.fft.rfft(r, rate)) ** 2 for r in rirs], axis=0)
        for edge in DEFAULT_BANDS[1:-1]:
            above = (frequency > edge * 1.03) & (frequency < edge * 1.155)
            below = (frequency < edge / 1.03) & (frequency > edge / 1.155)
            step = 10.0 * np.log10(power[below].mean() / power[above].mean())
            assert low < abs(step) < high, (name, edge, step)
    spectra = np.array([np.fft.rfft(r, rate) for r in rirs])
    window = rate // 10
    for b, (low, high) in enumerate(pairwise(DEFAULT_BANDS[:4])):
        use = (frequency >= low) & (frequency < high)
        parts = np.fft.irfft(spectra * use, rate)[:, : 4 * window] ** 2
        got = parts.reshape(seeds, 4, window).sum(axis=2).mean(axis=0) / use.mean()
        wanted = echogram.energy[:400, 0, b].reshape(4, 100).sum(axis=1)
        level = 10.0 * np.log10(got / wanted)
        # a band of 176 Hz and 0.1 s has 35 degrees of freedom per seed: its scatter is 0.13 dB
        assert np.all(np.abs(level[1:3]) < 0.5), (b, level)


def test_channels_of_diffuse_sound() -> None:
    """Energy per order as a diffuse field's: 1, 1/3, 1/5 of W's."""
    echogram = _echogram(_table())
    total = np.sum(
        [(smooth_rir(echogram, 16000, s).astype(float) ** 2).sum(axis=1) for s in range(30)], 0
    )
    np.testing.assert_allclose(total[1:4] / total[0], 1 / 3, rtol=0.1)
    np.testing.assert_allclose(total[4:] / total[0], 1 / 5, rtol=0.1)


def test_same_seed_same_sound() -> None:
    echogram = _echogram(_table())
    a, b, c = (smooth_rir(echogram, 16000, s) for s in (5, 5, 6))
    np.testing.assert_array_equal(a, b)
    assert a.dtype == np.float32 and a.shape == (9, 16000) and not np.array_equal(a, c)


def test_tails_go_on() -> None:
    """Late bins that few paths reach: holes are filled, energy is kept per band, what came before the first
    hole below -30 dB is untouched, and the expectation is the decay that was thinned out."""
    table, rng = _table(), np.random.default_rng(3)
    keep = np.minimum(1.0, (table[:, 0] / table[:1, 0]) / 1e-4)  # paths grow rare below -40 dB
    thinned = np.where(rng.uniform(size=keep.shape) < keep, 1.0 / keep, 0.0)
    sparse = (table * thinned[:, None]).astype(np.float32)
    got = continued(sparse, EDGES)
    np.testing.assert_allclose(
        got[:, 0].sum(axis=0, dtype=float), sparse[:, 0].sum(axis=0, dtype=float), rtol=1e-6
    )
    for b in range(4):
        left = sparse[::-1, 0, b].cumsum()[::-1]
        hole = np.flatnonzero((sparse[:, 0, b] == 0.0) & (left < 1e-3 * left[0]))
        assert len(hole) > 20
        np.testing.assert_array_equal(got[: hole[0], :, b], sparse[: hole[0], :, b])
        assert np.all(got[:, 0, b] > 0.0)
        # over 50 ms, between -40 and -60 dB, within what a few Poisson arrivals allow
        late = slice(hole[0], hole[0] + 50)
        wanted = table[late, 0, b].sum()
        assert abs(10.0 * np.log10(got[late, 0, b].sum() / wanted)) < 1.5


def test_whole_tails_and_silence_stay() -> None:
    table = _table()
    np.testing.assert_array_equal(continued(table, EDGES), table)
    np.testing.assert_array_equal(continued(0 * table, EDGES), 0 * table)
