"""The energy that is left in a scene by time, from a walk in NumPy that shares nothing with the tracer but the mesh.

Nothing passes walls. Where `by_angle`, walls have a real impedance z over air's: at a cosine c they reflect
((z c - 1) / (z c + 1))², of which random incidence (Paris 1928) is the mean, the absorption of the table. A wall that
scatters weighs sound by that of both its directions, over its mean.
"""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.integrate import quad
from scipy.optimize import brentq

import soundspaces_sim as ss

STEP = 0.002  # s
SPEED = 343.0  # m/s


def _reflected(zeta: np.ndarray, cos: np.ndarray) -> np.ndarray:
    return np.asarray(((zeta * cos - 1.0) / (zeta * cos + 1.0)) ** 2)


def _impedance(absorption: float) -> float:
    def mean(zeta: float) -> float:
        return float(
            quad(lambda c: 2.0 * c * (1.0 - _reflected(np.array(zeta), np.array(c))), 0.0, 1.0)[0]
        )

    return float(brentq(lambda zeta: mean(zeta) - absorption, 1.567, 1e4))


def energy_in_flight(
    scene: ss.Scene,
    start: np.ndarray,
    seed: int,
    duration: float,
    rays: int = 4000,
    by_angle: bool = False,
) -> np.ndarray:
    """Energy at multiples of `STEP`, of a source of 1 J; coefficients are those of the table's first band."""
    mesh = trimesh.Trimesh(scene.vertices, scene.faces, process=False)
    table, material = scene.materials, scene.face_material
    kept, scattering = 1.0 - table.absorption[:, 0], table.scattering[:, 0]
    used = np.unique(material)
    zeta = np.ones(len(kept))
    zeta[used] = [_impedance(1.0 - kept[k]) for k in used]

    def factor(row: np.ndarray, cos: np.ndarray) -> np.ndarray:
        return _reflected(zeta[row], cos) / kept[row] if by_angle else np.ones(len(row))

    rng = np.random.default_rng(seed)
    at, weight, clock = np.repeat(start[None], rays, axis=0), np.full(rays, 1.0 / rays), np.zeros(rays)
    toward = rng.standard_normal((rays, 3))
    toward /= np.linalg.norm(toward, axis=1)[:, None]
    energy = np.zeros(round(duration / STEP) + 2)
    while len(at):
        face = mesh.ray.intersects_first(at, toward)
        assert (face >= 0).mean() > 0.99
        at, toward, weight, clock, face = (x[face >= 0] for x in (at, toward, weight, clock, face))
        normal = mesh.face_normals[face]
        normal = normal * -np.sign((normal * toward).sum(axis=1))[:, None]
        corner = mesh.vertices[mesh.faces[face, 0]]
        way = ((corner - at) * normal).sum(axis=1) / (toward * normal).sum(axis=1)
        later = clock + way / SPEED
        for when, sign in ((clock, 1.0), (later, -1.0)):
            rows = np.minimum(np.ceil(when / STEP).astype(int), len(energy) - 1)
            np.add.at(energy, rows, sign * weight)
        at = at + way[:, None] * toward + 1e-5 * normal
        row, cos = material[face], -(toward * normal).sum(axis=1)
        weight, clock = weight * kept[row] * factor(row, cos), later
        mirrored = toward + 2.0 * cos[:, None] * normal
        random = rng.standard_normal(at.shape)
        lambert = normal + random / np.linalg.norm(random, axis=1)[:, None]
        lambert /= np.linalg.norm(lambert, axis=1)[:, None]
        diffuse = rng.random(len(at)) < scattering[row]
        toward = np.where(diffuse[:, None], lambert, mirrored)
        weight *= np.where(diffuse, factor(row, (lambert * normal).sum(axis=1)), 1.0)
        alive = (clock < STEP * (len(energy) - 1)) & (
            weight > 1e-7 / rays
        )  # in narrow gaps steps are short
        at, toward, weight, clock = (x[alive] for x in (at, toward, weight, clock))
    return np.asarray(np.cumsum(energy)[:-2])


def reverberation_time(energy: np.ndarray) -> float:
    """T30 of the energy in steps of `STEP`."""
    left = np.cumsum(energy[::-1])[::-1]
    level = 10.0 * np.log10(np.maximum(left / left[0], 1e-12))
    rows = (level <= -5.0) & (level >= -35.0)
    return float(-60.0 / np.polyfit(STEP * np.flatnonzero(rows), level[rows], 1)[0])
