"""Reverberation of a furnished room against a walk in NumPy that shares nothing with the tracer but the mesh.

Eyring's formula is no reference there: its mean over reflections counts gaps behind furniture as if the room's sound
met them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from soundspaces_sim.echogram.measures import echograms_measures
from soundspaces_sim.scene.enclosure import closedness
from tests.marks import ci_slow
from tests.transport.energy_in_flight import energy_in_flight, reverberation_time

_BANDS = (88.0, 355.0)  # where air absorbs next to nothing


def _scene() -> ss.Scene:
    """A furnished bedroom: soft things absorb .8, all else .12; nothing passes, all is scattered."""
    scene = ss.load_scene("room-1")
    soft = np.array([label.startswith(("bed", "sofa", "pillow", "blanket")) for label in scene.labels])
    alpha = np.where(soft[scene.face_label], 0.8, 0.12)
    plain = ss.Scene.from_arrays(scene.vertices, scene.faces, alpha, scattering=1.0)
    return replace(plain, name="furnished")


@ci_slow
def test_a_furnished_room_decays_as_a_walk_in_numpy() -> None:
    scene = _scene()
    rng = np.random.default_rng(3)
    low, high = scene.bounds
    some = low + (high - low) * rng.random((300, 3))
    closed, nearest = closedness(scene, some, 64, 8)
    points = some[(closed > 0.99) & (nearest > 0.35)][:4]
    assert len(points) == 4
    walked = np.array(
        [
            reverberation_time(energy_in_flight(scene, points[0], seed, 2.0, by_angle=True))
            for seed in range(6)
        ]
    )
    config = ss.SimulationConfig(
        walks=200,
        bands=_BANDS,
        speed_of_sound=343.0,
        radiance_transfer=ss.RadianceTransferConfig(subpaths="auto"),
        scattering="table",
    )
    traced = np.array(
        [
            np.mean(echograms_measures(ss.simulate(scene, points[:1], points[1:], config, seed))["t30"])
            for seed in range(6)
        ]
    )
    error = np.hypot(walked.std(ddof=1), traced.std(ddof=1)) / np.sqrt(6)
    assert error < 0.02 * walked.mean()
    assert (
        abs(traced.mean() - walked.mean()) < 3.5 * error + 0.015 * walked.mean()
    )  # patches: notes/laboratory.md
