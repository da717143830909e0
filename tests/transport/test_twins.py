"""A slow, obvious twin of what combines techniques: reflections before and after scattering; its equations are
those of docs/theory.md, written out."""

from __future__ import annotations

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.transport.paths import detector
from tests.rooms import plain, table
from tests.stats import assert_mean, repeat
from tests.transport.exact_wedge import SPEED
from tests.transport.test_finite_reflectors import floor, quads, wall

FLIP = np.array([1.0, 1.0, -1.0])  # to the image in the plane z = 0


def _energies_by_scattering(p: np.ndarray, q: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Energy between path lengths `edges`, m, by a Lambert wall at x = 0 (absorption .3) that stands on a
    mirror at z = 0 (absorption .2), between points before it.

    A ray that leaves the wall never comes back, so a path has one event on the wall, x, and at most one
    reflection before and one after it: its ends are p or p's image, and q or q's. (T4) with the Lambert value
    of (T8) is

        sum over ends of .8^reflections  integral over the wall of  (.7 / pi) cos cos / (4 pi r_p² r_q²) dA.
    """
    step = 0.01
    y, z = np.meshgrid(np.arange(-3.0 + step / 2, 3.0, step), np.arange(step / 2, 2.5, step))
    x = np.stack([np.zeros(y.size), y.ravel(), z.ravel()], axis=1)
    total = np.zeros(len(edges) - 1)
    for p_image in (False, True):
        for q_image in (False, True):
            to_p, to_q = (p * FLIP if p_image else p) - x, (q * FLIP if q_image else q) - x
            r_p, r_q = np.linalg.norm(to_p, axis=1), np.linalg.norm(to_q, axis=1)
            energy = (
                0.7 / np.pi * (to_p[:, 0] / r_p) * (to_q[:, 0] / r_q) / (4.0 * np.pi * (r_p * r_q) ** 2)
            )
            energy *= 0.8 ** (p_image + q_image) * step**2
            total += np.histogram(r_p + r_q, edges, weights=energy)[0]
    return total


def test_reflections_before_and_after_scattering(monkeypatch: pytest.MonkeyPatch) -> None:
    """Subpaths and connections, with mirrors on the way, against the sum over images and the integral over the
    wall."""
    scene = quads(
        floor(0.0, 40.0, -40.0, 40.0), wall(0.0, 2.5, half=3.0), materials=table([0.2, 0.3], [0.0, 1.0])
    )
    scene = ss.Scene(scene.vertices, scene.faces, np.array([0, 0, 1, 1]), scene.materials)
    p, q = np.array([1.2, -0.8, 1.1]), np.array([2.0, 1.3, 0.7])
    monkeypatch.setattr(detector, "GROWTH", detector.Growth(0.1, 0.05, 0.3))
    config = plain(
        walks=12_000, connections={"subpaths": 768}, duration=0.05, radiance_transfer=False, diffraction=False,
        time_grid=((0.0, 0.0005),),
    )  # fmt: skip

    def run(seed: int) -> np.ndarray:
        """Energy in all, and that of the longer half of the paths, after 14 ms."""
        energy = ss.simulate(scene, [p], [q], config, seed)[0, 0].energy[:, 0, 0]
        return np.array([energy.sum(), energy[28:].sum()])

    shorter, longer = _energies_by_scattering(p, q, np.array([0.0, 0.014, 0.05]) * SPEED)
    assert_mean(repeat(run, 16), [shorter + longer, longer], "mixed paths", relative=0.03)
