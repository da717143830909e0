"""The renderer of the direct sound alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.echogram import Arrival, Arrivals
from soundspaces_sim.rendering.renderers import find_renderer

EDGES = np.arange(301) * 0.001
EARLY = Arrivals(
    np.array([0.02]), np.full((1, 4), 1e-3), np.array([[0.0, 1.0, 0.0]]), np.array([[0, -1]])
)


def _echogram(direct: Arrival | None) -> ss.Echogram:
    table = np.zeros((300, 9, 4), np.float32)
    table[20:, 0] = 1e-5
    return ss.Echogram(DEFAULT_BANDS, EDGES, table, direct, EARLY, np.zeros((2, 4)), direct is not None)


def test_nothing_but_the_direct_sound() -> None:
    """1 J from 2 m ahead: 1 / (4 π 2²) of it at 2 m / c (within a band that is flat up to 20 kHz of 22.05), SN3D
    order 1 along X alone; without reverberation the default renderer says the same until the first reflection."""
    direct = Arrival(2.0 / 343.0, np.full(4, 1.0 / (16.0 * np.pi)), np.array([1.0, 0.0, 0.0]))
    echogram = _echogram(direct)
    alone, whole = (
        find_renderer(name)(echogram, 44100, 3).astype(float) for name in ("direct", "default")
    )
    assert alone.shape == whole.shape
    energy = np.sum(alone**2, axis=1)
    np.testing.assert_allclose(energy[0], 1.0 / (16.0 * np.pi) * 20000.0 / 22050.0, rtol=0.02)
    np.testing.assert_allclose(energy[3], energy[0], rtol=1e-6)  # ACN 3: X
    assert energy[1] + energy[2] < 1e-9 * energy[0]
    assert abs(int(np.argmax(np.abs(alone[0]))) - 2.0 / 343.0 * 44100) < 1.0
    dry = replace(echogram, energy=np.zeros_like(echogram.energy))
    begin, mirrored = int(0.0185 * 44100), find_renderer("default")(dry, 44100, 3)
    np.testing.assert_allclose(alone[:, :begin], mirrored[:, :begin], atol=1e-6 * np.abs(whole).max())
    later = slice(int(0.03 * 44100), None)
    assert np.sum(alone[:, later] ** 2) < 1e-9 * energy[0] < 1e-3 * np.sum(whole[0, later] ** 2)


def test_behind_walls_nothing_is_heard() -> None:
    assert not find_renderer("direct")(_echogram(None), 16000, 0).any()
