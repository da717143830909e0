"""Directions along which specular subpaths are sent."""

import numpy as np
import pytest

from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.scene.rays.directions import sample_sphere
from soundspaces_sim.transport.paths.guide import (
    CELLS,
    Guide,
    Pilots,
    empty_guide,
    learn_guide,
    make_pilots,
    sample_guided,
    set_density,
)
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.state import World
from soundspaces_sim.transport.tables import harmonics
from tests.marks import CI_SLOW, ci_slow
from tests.rooms import box, plain, table


@kernel
def _sample(first: int, last: int, guide: Guide, uv: np.ndarray, out: np.ndarray) -> None:
    for k in range(first, last):
        (x, y, z), density, _ = sample_guided(guide, uv[k, 0], uv[k, 1])
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = x, y, z, density


@kernel
def _even(first: int, last: int, uv: np.ndarray, out: np.ndarray) -> None:
    for k in range(first, last):
        out[k, 0], out[k, 1], out[k, 2] = sample_sphere(uv[k, 0], uv[k, 1])


@kernel
def _harmonics(first: int, last: int, d: np.ndarray, out: np.ndarray) -> None:
    for k in range(first, last):
        harmonics(d[k, 0], d[k, 1], d[k, 2], out[k])


@kernel
def _scale(first: int, last: int, guide: Guide) -> None:
    for _ in range(first, last):
        set_density(guide)


@kernel
def _learn(first: int, last: int, world: World, points: np.ndarray, keys: np.ndarray, guide: Guide, pilots: Pilots) -> None:  # fmt: skip
    for p in range(first, last):
        learn_guide(world, (points[p, 0], points[p, 1], points[p, 2]), keys[p], guide, pilots)


def _grid(n: int) -> np.ndarray:
    middles = (np.arange(n) + 0.5) / n
    return np.stack(np.meshgrid(middles, middles, indexing="ij"), axis=-1).reshape(-1, 2)


def _guide(density: np.ndarray) -> Guide:
    guide = empty_guide()
    guide.density[:] = density
    over_rows(_scale, 1, guide)
    return guide


def _between_hard_walls(*soft: float) -> Guide:
    """Of a point in a corridor, floor, ceiling and ends of which absorb: sound lives between its long walls."""
    scene = box((8.0, 2.0, 2.5), table([0.02, *soft], 0.0), [1, 1, 0, 0, 1, 1])
    points = np.array([[3.0, 0.7, 1.2]])
    model = make_model(scene, points, plain(duration=0.3, walks=1000))
    guide = empty_guide()
    pilots = make_pilots(4000, model.world.settings.max_length, 4)
    over_rows(_learn, 1, model.world, points - scene.center, point_keys(points, 0), guide, pilots)
    return guide


@pytest.mark.parametrize("learnt", [False, pytest.param(True, marks=CI_SLOW)])
def test_weighted_directions_are_even(learnt: bool) -> None:
    """Integrals of the nine harmonics over the sphere, by a fine grid: 1 and eight zeros, whatever the
    density."""
    drawn = np.random.default_rng(0).uniform(0.3, 4.0, (CELLS, CELLS))
    guide = _between_hard_walls(0.9) if learnt else _guide(drawn)
    assert abs(guide.density.mean() - 1.0) < 1e-9
    uv = _grid(384)
    out, y = np.empty((len(uv), 4)), np.empty((len(uv), 9))
    over_rows(_sample, len(uv), guide, uv, out)
    over_rows(_harmonics, len(uv), np.ascontiguousarray(out[:, :3]), y)
    mean = (y / out[:, 3:]).mean(axis=0)
    np.testing.assert_allclose(np.linalg.norm(out[:, :3], axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(mean, np.eye(9)[0], atol=4e-3)


def test_even_density_is_the_plain_sphere() -> None:
    uv = _grid(32)
    out, plain_sphere = np.empty((len(uv), 4)), np.empty((len(uv), 3))
    over_rows(_sample, len(uv), _guide(np.ones((CELLS, CELLS))), uv, out)
    over_rows(_even, len(uv), uv, plain_sphere)
    np.testing.assert_allclose(out, np.column_stack([plain_sphere, np.ones(len(uv))]), atol=1e-12)


@ci_slow
def test_density_follows_hard_walls() -> None:
    """Subpaths go to and fro between the two hard walls, which face each other along y."""
    guide = _between_hard_walls(0.9)
    uv = _grid(256)
    out = np.empty((len(uv), 4))
    over_rows(_sample, len(uv), guide, uv, out)
    along = np.abs(out[:, 1]) > 0.95  # a twentieth of the sphere
    assert 0.49 < guide.density.min() < 0.51  # half of all is even
    assert along.mean() > 0.25
    assert out[along, 3].mean() > 5.0


@ci_slow
def test_where_nothing_is_mirrored_the_density_stays_even() -> None:
    scene = box((4.0, 3.0, 2.5), table(0.2, 1.0))
    points = np.array([[1.0, 1.0, 1.0]])
    model = make_model(scene, points, plain(duration=0.3, walks=64))
    guide, pilots = empty_guide(), make_pilots(64, model.world.settings.max_length, 4)
    over_rows(_learn, 1, model.world, points - scene.center, point_keys(points, 0), guide, pilots)
    assert guide.density.min() > 0.49 and guide.density.max() < 20.0
