"""Directions along which specular walks are sent."""

import numpy as np

from soundspaces_sim.base.kernel import kernel, over_rows
from soundspaces_sim.rays.directions import sample_sphere
from soundspaces_sim.transport.guide import Guide, _guide, make_guide, sample_guided
from soundspaces_sim.transport.planes import group_planes
from soundspaces_sim.transport.surface import make_surfaces
from soundspaces_sim.transport.tables import harmonics
from tests.rooms import box, table


@kernel
def _sample(first: int, last: int, guide: Guide, uv: np.ndarray, out: np.ndarray) -> None:
    for k in range(first, last):
        (x, y, z), density = sample_guided(guide, uv[k, 0], uv[k, 1])
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = x, y, z, density


@kernel
def _even(first: int, last: int, uv: np.ndarray, out: np.ndarray) -> None:
    for k in range(first, last):
        out[k, 0], out[k, 1], out[k, 2] = sample_sphere(uv[k, 0], uv[k, 1])


@kernel
def _harmonics(first: int, last: int, d: np.ndarray, out: np.ndarray) -> None:
    for k in range(first, last):
        harmonics(d[k, 0], d[k, 1], d[k, 2], out[k])


def _grid(n: int) -> np.ndarray:
    middles = (np.arange(n) + 0.5) / n
    return np.stack(np.meshgrid(middles, middles, indexing="ij"), axis=-1).reshape(-1, 2)


def _between_hard_walls() -> Guide:
    """A corridor, floor, ceiling and ends of which are soft: sound lives between its long walls."""
    soft, hard = 0.9, 0.02
    scene = box((8.0, 2.0, 2.5), table([hard, soft], 0.0), [1, 1, 0, 0, 1, 1])
    planes = group_planes(scene.vertices - scene.center, scene.faces)
    surfaces = make_surfaces(*scene.materials.in_bands((0, 176, 775, 3409, 20000)))
    geometry = scene.geometry._replace(plane=planes.of_face)
    return make_guide(geometry, surfaces, scene.corners - scene.center, 100.0)


def test_weighted_directions_are_even() -> None:
    """Integrals of the nine harmonics over the sphere, by a fine grid: 1 and eight zeros, whatever the density."""
    rng = np.random.default_rng(0)
    for guide in (_guide(rng.uniform(0.3, 4.0, (64, 64))), _between_hard_walls()):
        uv = _grid(1024)
        out, y = np.empty((len(uv), 4)), np.empty((len(uv), 9))
        over_rows(_sample, len(uv), guide, uv, out)
        over_rows(_harmonics, len(uv), np.ascontiguousarray(out[:, :3]), y)
        mean = (y / out[:, 3:]).mean(axis=0)
        np.testing.assert_allclose(np.linalg.norm(out[:, :3], axis=1), 1.0, atol=1e-12)
        np.testing.assert_allclose(mean, np.eye(9)[0], atol=2e-3)


def test_even_density_is_the_plain_sphere() -> None:
    uv = _grid(32)
    out, plain = np.empty((len(uv), 4)), np.empty((len(uv), 3))
    over_rows(_sample, len(uv), _guide(np.ones((8, 8))), uv, out)
    over_rows(_even, len(uv), uv, plain)
    np.testing.assert_allclose(out, np.column_stack([plain, np.ones(len(uv))]), atol=1e-12)


def test_density_follows_hard_walls() -> None:
    """Walks go to and fro between the two hard walls, which face each other along y."""
    guide = _between_hard_walls()
    uv = _grid(256)
    out = np.empty((len(uv), 4))
    over_rows(_sample, len(uv), guide, uv, out)
    along = np.abs(out[:, 1]) > 0.9  # a tenth of the sphere
    assert 0.49 < guide.density.min() < 0.51  # half of all is even
    assert along.mean() > 0.2
    assert out[along, 3].mean() > 2.0
