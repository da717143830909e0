"""Ray casting from kernels against plane geometry."""

import numpy as np
import pytest

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.scene.rays.embree import RayScene, intersect, occluded
from tests.rooms import box, table


@kernel
def _cast(handle, o, d, tfar):  # type: ignore[no-untyped-def]
    origin, direction = (o[0], o[1], o[2]), (d[0], d[1], d[2])
    t, face = intersect(handle, origin, direction, tfar)
    return t, face, occluded(handle, origin, direction, tfar)


def test_distances_to_the_walls_of_a_box() -> None:
    scene = box((6.0, 5.0, 2.7), table(0.1, 0.1))
    rays = RayScene(scene.vertices, scene.faces)
    rng = np.random.default_rng(0)
    for _ in range(200):
        o = rng.uniform([0.1, 0.1, 0.1], [5.9, 4.9, 2.6])
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        walls = np.where(d > 0, (np.array([6.0, 5.0, 2.7]) - o) / d, -o / d)
        t, face, hit = _cast(rays.handle, o, d, np.inf)
        assert t == pytest.approx(walls.min(), rel=1e-5, abs=1e-5)
        assert face // 4 == int(walls.argmin()) and hit
        near = _cast(rays.handle, o, d, 0.9 * walls.min())
        assert near[0] == np.inf and near[1] == -1 and not near[2]


def test_a_miss_is_infinite() -> None:
    rays = RayScene(np.eye(3), np.array([[0, 1, 2]]))
    t, face, hit = _cast(rays.handle, np.zeros(3), np.array([0.0, 0.0, -1.0]), np.inf)
    assert t == np.inf and face == -1 and not hit
