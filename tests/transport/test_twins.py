"""Slow, obvious twins of what combines techniques: reflections before and after scattering, reflections before
and after an edge, and the edges of a plate; their equations are those of docs/theory.md, written out."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.transport.diffraction import points
from soundspaces_sim.transport.diffraction.mirrored_edges import MirroredEdges, with_mirrored
from soundspaces_sim.transport.arrivals.wedges import Wedges
from soundspaces_sim.transport.arrivals.specular_planes import SpecularPlanes
from tests.rooms import plain, table
from tests.stats import assert_mean, repeat
from tests.transport.exact_wedge import SPEED
from tests.transport.test_diffraction import CONFIG
from tests.transport.test_finite_reflectors import each_alone as each_alone
from tests.transport.test_finite_reflectors import floor, quads, wall
from tests.transport.test_utd import by_hand

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


def test_reflections_before_and_after_scattering() -> None:
    """Subpaths and connections, with mirrors on the way, against the sum over images and the integral over the
    wall."""
    scene = quads(
        floor(0.0, 40.0, -40.0, 40.0), wall(0.0, 2.5, half=3.0), materials=table([0.2, 0.3], [0.0, 1.0])
    )
    scene = ss.Scene(scene.vertices, scene.faces, np.array([0, 0, 1, 1]), scene.materials)
    p, q = np.array([1.2, -0.8, 1.1]), np.array([2.0, 1.3, 0.7])
    config = plain(
        walks=12_000, connections={"subpaths": 768}, duration=0.05, radiance_transfer=False, diffraction=False,
        receiver_volumes={"radius_max": 0.3}, time_grid=((0.0, 0.0005),),
    )  # fmt: skip

    def run(seed: int) -> np.ndarray:
        """Energy in all, and that of the longer half of the paths, after 14 ms."""
        energy = ss.simulate(scene, [p], [q], config, seed)[0, 0].energy[:, 0, 0]
        return np.array([energy.sum(), energy[28:].sum()])

    shorter, longer = _energies_by_scattering(p, q, np.array([0.0, 0.014, 0.05]) * SPEED)
    assert_mean(repeat(run, 16), [shorter + longer, longer], "mixed paths", relative=0.03)


def _points(low: float, high: float, count: int) -> Iterator[tuple[float, float]]:
    """(Wave number, weight) of Gauss points in log f of a band; the band from 0 Hz is the octave below its
    end."""
    x, weight = np.polynomial.legendre.leggauss(count)
    low = low or high / 2.0
    for at, share in zip(x, weight / 2.0, strict=True):
        yield float(2.0 * np.pi / SPEED * np.sqrt(low * high) * (high / low) ** (at / 2.0)), float(share)


def _about(
    edge: np.ndarray, face: np.ndarray, normal: np.ndarray, at: np.ndarray
) -> tuple[float, float]:
    """(Distance, angle) of a point about an edge through `edge`, angles from its `face` towards that face's
    normal."""
    off = at - edge
    u, v = float(off @ face), float(off @ normal)
    return float(np.hypot(u, v)), float(np.arctan2(v, u) % (2.0 * np.pi))


def _legs(r_p: float, r_q: float, along: float) -> tuple[float, float, float]:
    """Both legs of Keller's path by an edge, m, and the sine of its angle with it; `along` the edge by so many
    m."""
    total = np.hypot(r_p + r_q, along)
    sine = (r_p + r_q) / total
    return r_p / sine, r_q / sine, sine


@pytest.fixture
def without_images_of_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    """Edges have no images in the planes that their faces stand on (`test_mirrored_edges`)."""

    def none(
        geometry: Geometry, wedges: Wedges, planes: SpecularPlanes, large: np.ndarray
    ) -> tuple[Wedges, MirroredEdges]:
        return with_mirrored(geometry, wedges, planes, np.zeros_like(large))

    monkeypatch.setattr(points, "with_mirrored", none)


@pytest.mark.usefixtures("each_alone", "without_images_of_edges")
def test_reflections_before_and_after_an_edge() -> None:
    """Over a screen that stands on a floor: (T32) from the image of either end, times what the floor reflects."""
    rng = np.random.default_rng(3)
    p = np.column_stack(
        [rng.uniform(-4.0, -1.0, 3), rng.uniform(-2.0, 2.0, 3), rng.uniform(0.3, 1.4, 3)]
    )
    q = np.column_stack([rng.uniform(1.0, 4.0, 3), rng.uniform(-2.0, 2.0, 3), rng.uniform(0.3, 1.4, 3)])
    height, left = 1.8, 0.7 * 0.9  # of what comes to the floor, as specular energy
    scene = quads(floor(-40.0, 40.0, -40.0, 40.0), wall(0.0, height), materials=table(0.3, 0.1))
    echoes = ss.simulate(scene, p, q, CONFIG)
    top, down, to_p = (
        np.array([0.0, 0.0, height]),
        np.array([0.0, 0.0, -1.0]),
        np.array([-1.0, 0.0, 0.0]),
    )
    compared = 0
    for i in range(3):
        for j in range(3):
            for kind, a, b in (("mirror, edge", p[i] * FLIP, q[j]), ("edge, mirror", p[i], q[j] * FLIP)):
                (r_a, phi_a), (r_b, phi_b) = (_about(top, down, to_p, x) for x in (a, b))
                assert phi_b - phi_a > np.pi  # in the shadow
                d_a, d_b, sine = _legs(r_a, r_b, b[1] - a[1])
                expected = [
                    sum(
                        share * abs(np.sum(by_hand(2.0, phi_a, phi_b, d_a, d_b, sine, k))) ** 2
                        for k, share in _points(*band, 3)
                    )
                    for band in pairwise(DEFAULT_BANDS)
                ]
                (found,) = [e for e in echoes[i, j].early if e.kind == kind]
                np.testing.assert_allclose(
                    found.energy, left * np.array(expected) / (4.0 * np.pi), rtol=5e-3
                )
                compared += 1
    assert compared == 18


def _taper(detour: float, k: float) -> float:
    """1 up to half a detour of a wavelength or two metres, then down to 0 at it, as the square of a cosine."""
    x = max(2.0 * detour / min(2.0, 2.0 * np.pi / k) - 1.0, 0.0)
    return float(np.cos(0.5 * np.pi * x) ** 2) if x < 1.0 else 0.0


def _share_of_plate(half: tuple[float, float], p: np.ndarray, q: np.ndarray, k: float) -> float:
    """(T36): |p / p_specular|² of a plate at z = 0 of half sides `half`, where the point of reflection is on
    it."""
    up, mirror = np.array([0.0, 0.0, 1.0]), float(np.linalg.norm(p - q * FLIP))
    field = 1.0
    for axis in (0, 1):
        sides = 1.0 + 0.0j
        for sign in (-1.0, 1.0):
            edge, inward = np.zeros(3), np.zeros(3)
            edge[axis], inward[axis] = sign * half[axis], -sign
            ends = sorted(_about(edge, inward, up, x)[::-1] for x in (p, q))
            (phi_s, r_s), (phi_r, r_r) = ends
            d_s, d_r, sine = _legs(r_s, r_r, q[1 - axis] - p[1 - axis])
            detour = d_s + d_r - mirror
            reflected = np.sum(by_hand(2.0, phi_s, phi_r, d_s, d_r, sine, k)[1])
            sides += _taper(detour, k) * reflected * mirror * np.exp(-1j * k * detour)
        field *= abs(sides) ** 2
    return float(field)


@pytest.mark.usefixtures("each_alone")
def test_the_reflection_of_a_plate() -> None:
    """Plates from 0.8 to 3 m, ends so far above them that the direct sound takes nothing of the reflection: the
    specular path's energy in every band is (T29) times (T36)."""
    rng = np.random.default_rng(9)
    factors = []
    for _ in range(6):
        half = rng.uniform(0.4, 1.5), rng.uniform(0.4, 1.5)
        p, q = (np.append(rng.uniform(-0.7, 0.7, 2) * half, rng.uniform(2.2, 3.5)) for _ in range(2))
        plate = quads(floor(-half[0], half[0], -half[1], half[1]), materials=table(0.4, 0.0))
        expected = [
            sum(share * _share_of_plate(half, p, q, k) for k, share in _points(*band, 8))
            for band in pairwise(DEFAULT_BANDS)
        ]
        (found,) = [e for e in ss.simulate(plate, [p], [q], CONFIG)[0, 0].early if e.planes]
        endless = 0.6 / (4.0 * np.pi * np.sum((p - q * FLIP) ** 2))
        np.testing.assert_allclose(found.energy, endless * np.array(expected), rtol=1e-2)
        factors.append(expected)
    assert np.ptp(factors) > 0.5  # the plates matter
