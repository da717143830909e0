"""Reverberation of a furnished room against a walk in NumPy that shares nothing with the tracer but the mesh.

Eyring's formula is no reference there: its mean over reflections counts gaps behind furniture as if the room's sound
met them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.echogram.measures import echograms_measures
from soundspaces_sim.scene.enclosure import closedness
from tests.marks import ci_slow

_BANDS = (88.0, 355.0)  # where air absorbs next to nothing
_STEP = 0.002  # s


def _scene() -> ss.Scene:
    """A furnished bedroom: soft things absorb .8, all else .12; nothing passes, all is scattered."""
    scene = ss.load_scene("room-1")
    soft = np.array([label.startswith(("bed", "sofa", "pillow", "blanket")) for label in scene.labels])
    alpha = np.where(soft[scene.face_label], 0.8, 0.12)
    plain = ss.Scene.from_arrays(scene.vertices, scene.faces, alpha, scattering=1.0)
    return replace(plain, name="furnished")


def _times(energy: np.ndarray) -> float:
    """T30 of the energy in a room, by bins of `_STEP`."""
    left = np.cumsum(energy[::-1])[::-1]
    level = 10.0 * np.log10(left / left[0] + 1e-30)
    rows = (level <= -5.0) & (level >= -35.0)
    return float(-60.0 / np.polyfit(_STEP * np.flatnonzero(rows), level[rows], 1)[0])


def _walk(scene: ss.Scene, start: np.ndarray, seed: int, rays: int = 4000) -> float:
    """T30 of all energy in flight, of rays that Lambert's law reflects."""
    mesh = trimesh.Trimesh(scene.vertices, scene.faces, process=False)
    absorbed = scene.materials.absorption[scene.face_material, 0]  # the same at all frequencies
    rng = np.random.default_rng(seed)
    at, weight, clock = np.repeat(start[None], rays, axis=0), np.ones(rays), np.zeros(rays)
    toward = rng.standard_normal((rays, 3))
    energy = np.zeros(1002)
    while len(at):
        toward /= np.linalg.norm(toward, axis=1)[:, None]
        face = mesh.ray.intersects_first(at, toward)
        assert (face >= 0).mean() > 0.999
        at, toward, weight, clock, face = (x[face >= 0] for x in (at, toward, weight, clock, face))
        normal = mesh.face_normals[face]
        normal = normal * -np.sign((normal * toward).sum(axis=1))[:, None]
        corner = mesh.vertices[mesh.faces[face, 0]]
        way = ((corner - at) * normal).sum(axis=1) / (toward * normal).sum(axis=1)
        later = clock + way / 343.0
        for when, sign in ((clock, 1.0), (later, -1.0)):
            rows = np.minimum(np.ceil(when / _STEP).astype(int), len(energy) - 1)
            np.add.at(energy, rows, sign * weight)
        at = at + way[:, None] * toward + 1e-5 * normal
        weight, clock = weight * (1.0 - absorbed[face]), later
        random = rng.standard_normal(at.shape)
        toward = normal + random / np.linalg.norm(random, axis=1)[:, None]  # Lambert's law
        alive = (clock < _STEP * (len(energy) - 1)) & (weight > 1e-7)  # in narrow gaps steps are short
        at, toward, weight, clock = (x[alive] for x in (at, toward, weight, clock))
    return _times(np.cumsum(energy)[:-2])


@ci_slow
def test_a_furnished_room_decays_as_a_walk_in_numpy() -> None:
    scene = _scene()
    rng = np.random.default_rng(3)
    low, high = scene.bounds
    some = low + (high - low) * rng.random((300, 3))
    closed, nearest = closedness(scene, some, 64, 8)
    points = some[(closed > 0.99) & (nearest > 0.35)][:4]
    assert len(points) == 4
    walked = np.array([_walk(scene, points[0], seed) for seed in range(6)])
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
