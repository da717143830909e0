"""Planes of image sources: the faces of slabs, walls that are wound both ways, and reflections there and back."""

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.echogram.echogram import KINDS, MIRRORS, MIRRORS_AND_BACK
from soundspaces_sim.scene.triangles import cross_products
from soundspaces_sim.transport.arrivals.specular_planes import _in_blocks, _near, group_planes
from tests.rooms import plain, table


def _slab(size: tuple[float, float, float], height: float) -> tuple[np.ndarray, np.ndarray]:
    """(Vertices, faces) of a slab of so many m, its middle so high."""
    mesh = trimesh.creation.box(size)
    return np.asarray(mesh.vertices) + [0.0, 0.0, height], np.asarray(mesh.faces)


@pytest.mark.parametrize("thick", [0.002, 0.04, 0.09])
def test_faces_of_a_slab_are_two_planes(thick: float) -> None:
    """Each in its place, whatever the slab's thickness."""
    planes = group_planes(*_slab((2.0, 1.0, thick), 0.7))
    offsets = np.sort(planes.offset[np.abs(planes.normal[:, 2]) > 0.99])
    np.testing.assert_allclose(offsets, [0.7 - 0.5 * thick, 0.7 + 0.5 * thick], atol=1e-12)
    np.testing.assert_allclose(planes.margin[:2], 0.0, atol=1e-12)


def test_a_rough_wall_that_is_wound_both_ways_is_one_plane() -> None:
    """As scans have it: each triangle turned by chance, its corners within 1 cm."""
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.linspace(0.0, 3.0, 13), np.linspace(0.0, 2.0, 9), indexing="ij")
    v = np.column_stack([x.ravel(), y.ravel(), rng.uniform(-0.01, 0.01, x.size)])
    corner = (np.arange(12)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate(
        [
            np.column_stack([corner, corner + 9, corner + 10]),
            np.column_stack([corner, corner + 10, corner + 1]),
        ]
    )
    turned = rng.random(len(faces)) < 0.5
    faces[turned] = faces[turned][:, ::-1]
    planes = group_planes(v, faces)
    assert len(planes.offset) == 1
    assert (planes.of_face == 0).all()


def _sheet(rng: np.random.Generator, across: float, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """(Vertices, faces) 2.1 m long and so wide, any way round, in triangles of 4 cm whose corners stray by `noise` m
    and of which 3 % are missing."""
    i, j = round(across / 0.04), 53
    x, y = np.meshgrid(np.linspace(0.0, across, i + 1), np.linspace(0.0, 2.1, j), indexing="ij")
    v = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    corner = (np.arange(i)[:, None] * j + np.arange(j - 1)).ravel()
    faces = np.concatenate(
        [
            np.column_stack([corner, corner + j, corner + j + 1]),
            np.column_stack([corner, corner + j + 1, corner + 1]),
        ]
    )
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return v @ turn + rng.uniform(-noise, noise, v.shape), faces[rng.random(len(faces)) < 0.97]


@pytest.mark.parametrize(
    ("across", "noise", "number"),
    [(0.16, 0.0, 0), (0.16, 0.004, 0), (0.48, 0.0, 1), (1.2, 0.0, 1), (1.2, 0.004, 1)],
)
def test_a_strip_is_no_mirror(across: float, noise: float, number: int) -> None:
    """As the side of a door's opening: in CAD as on a scan, however it lies."""
    for seed in range(8):
        planes = group_planes(*_sheet(np.random.default_rng(seed), across, noise))
        assert len(planes.offset) == number


def _below_a_slab(thick: float) -> ss.Scene:
    """A floor at 0, and a slab whose underside is 1 m above it; both absorb a fifth."""
    v, f = _slab((30.0, 30.0, thick), 1.0 + 0.5 * thick)
    floor = np.array([[-15, -15, 0], [15, -15, 0], [15, 15, 0], [-15, 15, 0]], float)
    faces = np.concatenate([f, [[8, 9, 10], [8, 10, 11]]])
    return ss.Scene(
        np.concatenate([v, floor]), faces, np.zeros(len(faces), int), table(0.2, 0.0), name="below"
    )


@pytest.mark.parametrize("diffraction", [False, True])
def test_reflections_there_and_back(diffraction: bool) -> None:
    """Between a floor and an underside 1 m above it sound comes by one plane, by both in either order, and there and
    back: six images, each at its distance, with .8 for each reflection."""
    source, listener, height = np.array([0.3, 0.1, 0.35]), np.array([-1.1, 0.6, 0.8]), 1.0
    config = plain(
        walks=16,
        connections={"subpaths": 0},
        specular={"ratio": 1},
        duration=0.05,
        radiance_transfer=False,
        diffraction=diffraction,
    )
    echogram = ss.simulate(_below_a_slab(0.05), source, listener, config)[0, 0]
    apart = float(np.sum((source[:2] - listener[:2]) ** 2))
    # heights to which the source is mirrored, with the number of reflections
    images = [(source[2], 0)]
    for first in (0.0, height):
        z, plane = source[2], first
        for order in range(1, 4):
            z, plane = 2.0 * plane - z, height - plane
            images.append((z, order))
    expected = sorted((apart + (z - listener[2]) ** 2, 0.8**order) for z, order in images)
    found = sorted(echogram.arrivals, key=lambda a: a.delay)
    assert len(found) == 7
    speed = config.c
    for arrival, (square, left) in zip(found, expected, strict=True):
        assert arrival.delay * speed == pytest.approx(np.sqrt(square), rel=1e-9)
        assert arrival.energy[0] == pytest.approx(left / (4.0 * np.pi * square), rel=2e-3)
    kinds = [a.kind for a in found]
    assert kinds.count(KINDS[MIRRORS_AND_BACK]) == 2
    assert kinds.count(KINDS[MIRRORS]) == 5


def test_no_reflection_there_and_back_is_there_twice() -> None:
    """Between a floor and an underside bins hold all images of the fourth order and more, and none before."""
    source, listener, height = np.array([0.3, 0.1, 0.35]), np.array([-1.1, 0.6, 0.8]), 1.0
    scene, seeds = _below_a_slab(0.05), 12
    config = plain(
        walks=1000,
        connections={"subpaths": 0},
        specular={"ratio": 8},
        duration=0.05,
        radiance_transfer=False,
    )
    found = [ss.simulate(scene, source, listener, config, seed)[0, 0] for seed in range(seeds)]
    totals = [float(e.energy[:, 0, 0].sum()) for e in found]
    apart, most = float(np.sum((source[:2] - listener[:2]) ** 2)), config.c * 0.05
    exact, third = 0.0, 0.0
    for first in (0.0, height):
        z, plane = source[2], first
        for order in range(1, 40):
            z, plane = 2.0 * plane - z, height - plane
            square = apart + (z - listener[2]) ** 2
            energy = 0.8**order / (4.0 * np.pi * square) if square < most * most else 0.0
            exact += energy if order > 3 else 0.0
            third += energy if order == 3 else 0.0
    error = float(np.std(totals, ddof=1)) / np.sqrt(seeds)
    assert error < 0.1 * third
    assert abs(float(np.mean(totals)) - exact) < 4.0 * error, (np.mean(totals), exact, error)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_near_a_plane_is_found_as_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = (
        rng.uniform(0.0, 5.0, (1, 3))
        + rng.normal(size=(3000, 1, 3))
        + rng.normal(size=(3000, 3, 3)) * 0.05
    )
    normal = cross_products(corners)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    free, blocks, room = rng.random(3000) < 0.7, _in_blocks(corners), np.empty(3000, np.int64)
    count = 0
    for n in normal[:40]:
        d, offset = float(corners.mean(axis=(0, 1)) @ n), 0.1
        found = _near(normal, corners, free, blocks, n, d, 0.5, offset, room)
        near = (np.abs(corners @ n - d) < offset).all(axis=1)
        np.testing.assert_array_equal(found, np.flatnonzero(free & near & (np.abs(normal @ n) > 0.5)))
        count += len(found)
    assert count > 400
