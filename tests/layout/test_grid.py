"""Placement and pruning."""

import re

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.layout.grid import pruning_text
from soundspaces_sim.layout.records import KEPT, OUTSIDE
from soundspaces_sim.scene.enclosure import check_inside, closedness
from soundspaces_sim.scene.storeys import floor_heights
from tests.rooms import box, plane, table

ROOM = box((6.0, 5.0, 2.7), table(0.1, 0.1))


def test_four_points_per_square_metre_at_half_a_metre() -> None:
    grid = ss.make_grid(ROOM, spacing=0.5)
    assert len(grid) == 12 * 10
    assert np.all(grid.points[:, 2] == 1.5)
    assert np.allclose(np.diff(np.unique(grid.points[:, 0])), 0.5, atol=1e-9)
    assert not np.any(np.signbit(grid.points) & (grid.points == 0.0))


def test_closedness_of_a_closed_box_is_one_and_of_nothing_zero() -> None:
    closed, clearance = closedness(ROOM, np.array([[3.0, 2.5, 1.35]]))
    assert closed[0] == 1.0
    assert clearance[0] == pytest.approx(1.35, abs=0.01)
    far, _ = closedness(ROOM, np.array([[300.0, 2.5, 1.35]]))
    assert far[0] < 0.01


def test_closedness_above_a_plane() -> None:
    """Half of the rays hit an endless plane once and then escape: C = 1 / (2 B)."""
    closed, _ = closedness(plane(1e4, table(0.1, 0.1)), np.array([[0.0, 0.0, 1.0]]), rays=20000)
    assert closed[0] == pytest.approx(0.05, abs=4 * 0.5 / np.sqrt(20000) / 10)


def test_points_outside_a_concave_room_are_pruned() -> None:
    small = box((3.0, 3.0, 2.5), table(0.1, 0.1))
    vertices = np.concatenate([small.vertices, small.vertices + [6.0, 4.0, 0.0]])
    faces = np.concatenate([small.faces, small.faces + 8])
    scene = ss.Scene(vertices, faces, np.zeros(len(faces), int), table(0.1, 0.1))
    grid = ss.make_grid(scene, spacing=0.5)
    inside = ((grid.points[:, :2] < 3.0).all(axis=1)) | ((grid.points[:, :2] > [6.0, 4.0]).all(axis=1))
    assert inside.all()
    # 18 x 14 candidates over both, of which 6 x 6 lie in each
    assert (grid.status == KEPT).sum() == len(grid) == 72 and (grid.status == OUTSIDE).sum() == 180


def test_no_point_survives() -> None:
    with pytest.raises(ss.SceneError, match=r"none of .* survived.*closed-ness.*min_closedness"):
        ss.make_grid(plane(2.0, table(0.1, 0.1)), spacing=0.5)


def test_how_closed_the_points_outside_are_is_said() -> None:
    """Two rooms apart: those between have a closed-ness below what is needed, whatever that of others is."""
    small = box((3.0, 3.0, 2.5), table(0.1, 0.1))
    vertices = np.concatenate([small.vertices, small.vertices + [6.0, 4.0, 0.0]])
    faces = np.concatenate([small.faces, small.faces + 8])
    scene = ss.Scene(vertices, faces, np.zeros(len(faces), int), table(0.1, 0.1))
    config = ss.GridConfig(spacing=1.0, rays=100)
    text = pruning_text(ss.make_grid(scene, config=config), config)
    found = re.search(r"45 lie outside \(closed-ness at most (0\.\d\d), needed 0\.5\)", text)
    assert found is not None and float(found[1]) < 0.5


def test_floor_of_a_slab_is_its_top() -> None:
    np.testing.assert_allclose(floor_heights(ss.load_scene("demo")), [0.0], atol=1e-9)


@pytest.mark.parametrize("spacing", [0.0, -1.0, float("nan")])
def test_bad_spacing(spacing: float) -> None:
    with pytest.raises(ss.ConfigError, match=r"grid\.spacing"):
        ss.make_grid(ROOM, spacing=spacing)


@pytest.mark.parametrize("point", [[100.0, 1.0, 1.0], [-0.5, 2.0, 1.0], [3.0, 2.0, 5.0]])
def test_points_outside_are_refused(point: list[float]) -> None:
    with pytest.raises(ss.PointError, match=r"sources: point 0 .*outside the scene 'box'"):
        ss.simulate(ROOM, [point], [[1.0, 1.0, 1.0]])


@pytest.mark.parametrize("points", [[], [[1.0, 2.0]], [[np.nan, 1.0, 1.0]], [[[1.0, 2.0, 3.0]]]])
def test_malformed_points_are_refused(points: object) -> None:
    with pytest.raises(ss.PointError, match="listeners"):
        ss.simulate(ROOM, [[1.0, 1.0, 1.0]], points)  # type: ignore[arg-type]


def test_a_lone_wall_has_no_outside() -> None:
    check_inside(plane(2.0, table(0.1, 0.1)), np.array([[0.0, 0.0, 50.0]]), "points")
