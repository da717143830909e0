"""Points on faces count on the open side of them; points in bodies are refused."""

from __future__ import annotations

import logging

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.errors import PointError
from soundspaces_sim.scene.rays.placing import off_faces
from tests.marks import few
from tests.rooms import box, plain, table

MATERIAL = table([[0.1] * 4, [0.2] * 4], 0.5)
SIZE = np.array([6.0, 4.0, 3.0])
ROOM = box((6.0, 4.0, 3.0), MATERIAL)
QUICK = plain(walks=64, connections={"subpaths": 0}, duration=0.05)


def _with_body(size: tuple[float, float, float], at: tuple[float, float, float], gap: bool) -> ss.Scene:
    body = box(size, MATERIAL)
    faces = np.delete(body.faces, 3, axis=0) if gap else body.faces
    return ss.Scene(
        np.concatenate([ROOM.vertices, body.vertices + np.array(at)]),
        np.concatenate([ROOM.faces, faces + 8]),
        np.repeat([0, 1], [12, len(faces)]),
        MATERIAL,
    )


@pytest.mark.parametrize("inward", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_points_on_walls_edges_and_corners_go_into_the_room(seed: int, inward: bool) -> None:
    """However the room is wound; off each wall by some of what rays start off it, and not along it."""
    rng = np.random.default_rng(seed)
    faces = ROOM.faces[:, ::-1] if inward else ROOM.faces
    scene = ss.Scene(ROOM.vertices, faces, ROOM.face_material, MATERIAL)
    on = rng.random(3) < 0.6
    on[seed % 3] = True
    high = rng.integers(2, size=3).astype(bool)
    inner = rng.uniform(0.1, 0.9, 3) * SIZE
    point = np.where(on, np.where(high, SIZE, 0.0) + rng.uniform(-1e-6, 1e-6, 3), inner)
    moved = off_faces(scene.geometry, point[None] - scene.center)[0] + scene.center
    depth = np.where(high, SIZE - moved, moved)[on]
    epsilon = scene.geometry.epsilon
    assert ((depth > epsilon) & (depth < 4.0 * epsilon)).all()
    np.testing.assert_allclose(moved[~on], inner[~on], atol=1e-9)


def test_points_off_faces_stay_where_they_are() -> None:
    points = np.random.default_rng(0).uniform(0.01, 0.99, (100, 3)) * SIZE - ROOM.center
    np.testing.assert_array_equal(off_faces(ROOM.geometry, points), points)


@pytest.mark.parametrize(
    "place", few([[0.0, 2.0, 1.5], [0.0, 0.0, 1.5], [0.0, 0.0, 0.0]], [0.0, 0.0, 0.0])
)
def test_a_source_on_walls_is_as_loud_as_one_beside_them(place: list[float]) -> None:
    """Levels of 3,000 subpaths differ by some .1 dB; half of them outside would be 3 dB."""
    beside = np.array(place) + 1e-3
    config = plain(walks=3000, duration=0.4)
    levels = [
        10.0 * np.log10(ss.simulate(ROOM, [p], [[4.0, 3.0, 1.5]], config).energy[0, 0].sum())
        for p in (place, beside)
    ]
    assert abs(levels[0] - levels[1]) < 0.4


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize("size", [(0.4, 1.0, 2.0), (0.1, 1.0, 2.0), (0.5, 0.5, 0.5)])
def test_points_in_bodies_are_refused_by_name(size: tuple[float, float, float], gap: bool) -> None:
    """Also where a triangle of the body is missing, and the shortest way out goes by the one beside it: not by the
    edge of both, where rounding, and so who casts the rays, decides. Beside the body, 1 mm off and on it, all is
    well."""
    scene = _with_body(size, (3.0, 1.0, 0.2), gap)
    inside = np.array([3.0, 1.0, 0.2]) + np.array([0.4, 0.5, 0.3]) * size
    with pytest.raises(
        PointError, match=r"listeners: point 1 at \(3\.\d+, .* is inside a body .* holds no air"
    ):
        ss.simulate(scene, [[1.0, 1.0, 1.0]], np.array([[5.0, 3.0, 1.0], inside]), QUICK)
    for off in (1e-3, 0.0):
        e = ss.simulate(scene, [[1.0, 1.0, 1.0]], [[3.0 - off, 1.3, 0.4]], QUICK)
        assert e.energy.sum() > 0.0


def test_narrow_air_is_no_body() -> None:
    """Between two cupboards 5 cm apart, and in a model of a small box."""
    first = _with_body((0.5, 2.0, 2.0), (3.0, 1.0, 0.2), False)
    second = box((0.5, 2.0, 2.0), MATERIAL)
    scene = ss.Scene(
        np.concatenate([first.vertices, second.vertices + [3.55, 1.0, 0.2]]),
        np.concatenate([first.faces, second.faces + len(first.vertices)]),
        np.append(first.face_material, second.face_material + 1),
        MATERIAL,
    )
    assert ss.simulate(scene, [[1.0, 1.0, 1.0]], [[3.525, 1.5, 1.0]], QUICK).energy.sum() > 0.0
    small = box((0.5, 0.4, 0.3), MATERIAL)
    assert ss.simulate(small, [[0.1, 0.1, 0.1]], [[0.4, 0.3, 0.2]], QUICK).energy.sum() > 0.0


def test_a_point_in_something_large_is_told(caplog: pytest.LogCaptureFixture) -> None:
    """A pillar of 1.5 m may be a closet: a point in it is not refused, but said to be silent."""
    scene = _with_body((1.5, 1.5, 2.0), (3.0, 1.0, 0.2), False)
    with caplog.at_level(logging.WARNING, "soundspaces_sim"):
        ss.simulate(scene, [[1.0, 1.0, 1.0]], [[5.0, 3.0, 1.0], [3.7, 1.7, 1.2]], QUICK)
    assert "between listener 1 at (3.700, 1.700, 1.200) m and any other point" in caplog.text
    assert "listener 0" not in caplog.text and "source" not in caplog.text
