"""What planes are drawn into cells says where there is nothing to reflect, and never where there is something."""

from __future__ import annotations

import numpy as np
import pytest

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.transport.arrivals.specular_planes import (
    NEAR,
    THERE,
    Cover,
    SpecularPlanes,
    cover_at,
    make_cover,
)


@kernel
def _cover(cover: Cover, a: int, x: np.ndarray, out: np.ndarray) -> None:
    for i in range(len(x)):
        out[i] = cover_at(cover, a, (x[i, 0], x[i, 1], x[i, 2]))


def _at(cover: Cover, a: int, x: np.ndarray) -> np.ndarray:
    out = np.zeros(len(x), np.int64)
    _cover(cover, a, np.ascontiguousarray(x), out)
    return out


def _apart(corners: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(n,) m from places (n, 2) to triangles (F, 3, 2)."""
    least = np.full(len(x), np.inf)
    for triangle in corners:
        inside = np.zeros((3, len(x)), bool)
        for k in range(3):
            a, b = triangle[k], triangle[(k + 1) % 3]
            t = np.clip(((x - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
            least = np.minimum(least, np.linalg.norm(x - a - t[:, None] * (b - a), axis=1))
            d = b - a
            inside[k] = d[0] * (x - a)[:, 1] - d[1] * (x - a)[:, 0] > 0.0
        least[inside.all(axis=0) | (~inside).all(axis=0)] = 0.0
    return least


@pytest.mark.parametrize("scale", [1.0, 40.0, 3e4])
def test_cells_hold_all_of_random_triangles_and_little_else(scale: float) -> None:
    """Against distances from triangles, in planes of up to some 100 km; cells grow, their number does not."""
    rng = np.random.default_rng(int(scale))
    flat = scale * (rng.uniform(-2.0, 2.0, (5, 1, 2)) + rng.uniform(-1.5, 1.5, (5, 3, 2)))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    corners = flat @ turn[:2] + 0.7 * turn[2]
    planes = SpecularPlanes(turn[2:], np.array([0.7]), np.zeros(1), np.zeros(len(flat), int))
    cover, _ = make_cover(planes.of_face, corners, planes)
    x = scale * rng.uniform(-4.0, 4.0, (4000, 2))
    apart, found = _apart(flat, x), _at(cover, 0, x @ turn[:2] + 0.7 * turn[2])
    size = float(cover.size[0])
    assert len(cover.cell) < 250_000
    assert (found[apart < 0.5 * size] == THERE).all()
    assert (found[apart < 0.9] >= NEAR).all()
    assert (found[apart > 6.0 * size + 0.1] < THERE).all()
    assert (found[apart > np.sqrt(2.0) * (1.0 + 6.0 * size)] == 0).all()
    assert min((found == 0).sum(), (found == THERE).sum()) > 100


def test_no_planes() -> None:
    none = SpecularPlanes(np.empty((0, 3)), np.empty(0), np.empty(0), np.empty(0, int))
    cover, area = make_cover(none.of_face, np.empty((0, 3, 3)), none)
    assert cover.cell.dtype == np.uint8 and cover.shape.shape == (0, 2) and area.shape == (0,)


def test_area_is_of_what_hangs_together() -> None:
    """Three rectangles, of which two share a side: 2 m by 3 m of both, and cells up to .125 m about
    them, whatever way triangles are wound and however often they are there."""

    def rectangle(low: tuple[float, float], high: tuple[float, float]) -> np.ndarray:
        (a, b), (c, d) = low, high
        return np.array([[(a, b), (c, b), (c, d)], [(a, b), (a, d), (c, d)]])

    flat = np.concatenate(
        [rectangle((0, 0), (1.2, 3)), rectangle((1.2, 0), (2, 3)), rectangle((5, 0), (7, 2))]
    )
    flat = np.concatenate([flat, flat[:1, ::-1]])
    corners = np.concatenate([flat, np.zeros((len(flat), 3, 1))], axis=2)
    planes = SpecularPlanes(np.eye(3)[2:], np.zeros(1), np.zeros(1), np.zeros(len(flat), int))
    area = make_cover(planes.of_face, corners, planes)[1]
    assert 6.0 <= area[0] <= 2.25 * 3.25
