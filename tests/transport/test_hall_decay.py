"""Reverberation of halls against a walk in NumPy that shares nothing with the tracer but the mesh.

Halls have what absorbs on one side, walls that hardly scatter, and rows of closed bodies: what sound does between
the walls, above the seats, tells how long they ring.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.scene.enclosure import closedness
from tests.transport.energy_in_flight import STEP, energy_in_flight, reverberation_time

_BAND = (88.0, 355.0)  # Hz, where air absorbs next to nothing
_OCTAVE = 2  # of the tables, 500 Hz
_DURATION = 3.0  # s
_LISTENERS, _SEEDS = 12, 10


def _hall() -> tuple[ss.Scene, np.ndarray]:
    """With walls of which nothing passes, and places all over it."""
    hall = ss.load_scene("hall-7001")
    table, of = hall.materials, hall.face_material
    absorption, scattering = table.absorption[of, _OCTAVE], table.scattering[of, _OCTAVE]
    plain = ss.Scene.from_arrays(hall.vertices, hall.faces, absorption, scattering=scattering)
    low, high = plain.bounds
    places = low + (high - low) * np.random.default_rng(3).random((600, 3))
    closed, nearest = closedness(plain, places, 64, 8)
    free = (closed > 0.99) & (nearest > 0.35) & (places[:, 2] > low[2] + 0.4)
    return replace(plain, name="hall"), places[free]


@pytest.mark.slow
@pytest.mark.parametrize("law", ["random", "angle"])
def test_a_hall_rings_as_long_as_a_walk_in_numpy(law: str) -> None:
    hall, places = _hall()
    steps = round(_DURATION / STEP)
    walked, traced = [], []
    for seed in range(_SEEDS):
        energy = energy_in_flight(hall, places[0], seed, _DURATION, rays=16000, by_angle=law == "angle")
        walked.append(reverberation_time(energy[:steps]))
        listeners = np.random.default_rng(seed).choice(places[1:], _LISTENERS, replace=False)
        config = ss.SimulationConfig(
            walks=400,
            bands=_BAND,
            speed_of_sound=343.0,
            scattering="table",
            reflection=law,
            diffraction=ss.DiffractionConfig(enabled=False),
            duration=_DURATION,
        )
        echoes = ss.simulate(hall, places[:1], listeners, config, seed)
        energy = np.sum([echoes[0, k].histogram(STEP)[0] for k in range(_LISTENERS)], axis=0)
        traced.append(reverberation_time(energy[:steps]))
    error = np.hypot(np.std(walked, ddof=1), np.std(traced, ddof=1)) / np.sqrt(_SEEDS)
    mean = np.mean(walked)
    assert error < 0.03 * mean
    assert abs(np.mean(traced) - mean) < 3.5 * error, (np.mean(traced), mean, error)
