"""Planes in pieces, as the tops of tables of one height, reflect as the pieces do; and no arrival is louder than
its sources can make it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from tests.marks import ci_slow, few
from tests.rooms import plain, table
from tests.transport.exact_wedge import SPEED, band_energies, band_wave_numbers
from tests.transport.test_diffraction import CONFIG
from tests.transport.test_finite_reflectors import floor, kirchhoff, pressure, quads

_LOUDEST = 16.0  # times the free field: one wall doubles a pressure, a corner of two doubles it twice
_ACROSS, _UP = 2.0, 3.0  # m, of the ends from where x and z are 0


@pytest.mark.parametrize(
    "strips",
    [
        [(-0.5, 0.5)],
        [(0.15, 1.0), (-1.0, -0.15)],
        [(-0.4, 0.4), (0.6, 1.4), (-1.4, -0.6)],
        [(0.1, 0.8), (-0.8, -0.1), (1.0, 1.7), (-1.7, -1.0)],
        [(-0.1, 0.5), (0.7, 1.3), (-0.9, -0.3)],
    ],
)
def test_strips_of_one_plane_reflect_as_kirchhoff_says(strips: list[tuple[float, float]]) -> None:
    """All arrivals after the direct sound, added as pressures, above 176 Hz: below, what one edge makes of another's
    wave counts, of which two edges of one face have a part alone."""
    ends = np.array([[-_ACROSS, 0.0, _UP]]), np.array([[_ACROSS, 0.0, _UP]])
    e = ss.simulate(quads(*[floor(a, b, -60.0, 60.0) for a, b in strips]), *ends, CONFIG)[0, 0]
    k, plane = band_wave_numbers(64), 2.0 * np.hypot(_ACROSS, _UP)
    sound = pressure([a for a in e.early if a.delay * SPEED > 2.0 * _ACROSS + 0.1], k)
    off = 10.0 * np.log10(band_energies(sound) * plane**2 / kirchhoff(strips, _ACROSS, _UP, k))
    assert (np.abs(off[1:]) < (0.6 if len(strips) == 1 else 1.5)).all(), off


def _furnished(rng: np.random.Generator) -> tuple[ss.Scene, np.ndarray]:
    """A box with boxes in it, some of one height, some turned, some through another; and points."""
    size = rng.uniform([3.0, 2.5, 2.2], [12.0, 9.0, 5.0])
    room = trimesh.creation.box(bounds=np.array([np.zeros(3), size]))
    room.invert()
    parts, height = [room], rng.uniform(0.4, 1.2)
    for _ in range(rng.integers(2, 12)):
        extent = np.minimum(rng.uniform(0.05, 2.0, 3), 0.5 * size)
        low = rng.uniform(0.0, size - extent)
        if rng.uniform() < 0.5:
            low[2], extent[2] = height - 0.03, 0.03
        piece = trimesh.creation.box(bounds=np.array([low, low + extent]))
        if rng.uniform() < 0.3:
            turn, angle = np.eye(4), rng.uniform(0.0, 6.0)
            turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            turn[:3, 3] = piece.centroid - turn[:3, :3] @ piece.centroid
            piece.apply_transform(turn)
        parts.append(piece)
    first = np.cumsum([0] + [len(p.vertices) for p in parts[:-1]])
    vertices = np.concatenate([p.vertices for p in parts])
    faces = np.concatenate([p.faces + n for p, n in zip(parts, first, strict=True)])
    material = np.concatenate([np.full(len(p.faces), n % 3) for n, p in enumerate(parts)])
    absorption = 10.0 ** rng.uniform(-2.0, -0.1, (3, 4))
    scene = ss.Scene(
        vertices, faces, material, table(absorption, np.full((3, 4), 0.2)), name="furnished"
    )
    points = rng.uniform(0.1, size - 0.1, (8, 3))
    points[:2] = np.clip(points[:2].round(1), 0.1, size - 0.1)
    inside = np.any([piece.contains(points) for piece in parts[1:]], axis=0)
    return scene, points[~inside]


def assert_not_loud(scene: ss.Scene, points: np.ndarray) -> None:
    echoes = ss.simulate(scene, points, points, plain(walks=8, duration=0.08, diffraction=True))
    for i in range(len(points)):
        for j in range(len(points)):
            for a in echoes[i, j].arrivals:
                free = 4.0 * np.pi * (a.delay * SPEED) ** 2
                assert np.isfinite(a.energy).all()
                assert a.delay == 0.0 or (a.energy * free < 1.000001 * _LOUDEST).all(), (i, j, a)


@pytest.mark.parametrize("name", ["classroom-1", "home-2", "hall-1"])
@ci_slow
def test_no_arrival_of_a_generated_building_is_too_loud(name: str) -> None:
    """Rows of tables, shelves and chairs."""
    scene = ss.load_scene(name)
    points = np.asarray(ss.make_grid(scene, spacing=0.5).points)
    assert_not_loud(scene, points[np.random.default_rng(0).permutation(len(points))[:8]])


@pytest.mark.parametrize("seed", few(range(6), 0, 3))
def test_no_arrival_of_a_random_room_is_too_loud(seed: int) -> None:
    """Furniture of one height among other."""
    assert_not_loud(*_furnished(np.random.default_rng(seed)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6, 66))
def test_no_arrival_of_many_random_rooms_is_too_loud(seed: int) -> None:
    """The same."""
    assert_not_loud(*_furnished(np.random.default_rng(seed)))
