"""Floors and ways of habitat's pathfinder in rooms whose floors and ways are known."""

from typing import Any

import numpy as np
import pytest
import trimesh
from soundspaces_rlr import habitat
from soundspaces_rlr.errors import RlrError

from soundspaces_sim.scene.scene import Scene

RADIUS = 0.1


def finder(*walls: list[list[float]]) -> habitat.PathFinder:
    """Of a room 6 × 5 × 2.7 m with boxes in it; in habitat x 0 to 6, y 0 to 2.7, z -5 to 0."""
    bounds = [[[0.0, 0.0, 0.0], [6.0, 5.0, 2.7]], *walls]
    mesh: Any = trimesh.util.concatenate([trimesh.creation.box(bounds=np.array(b)) for b in bounds])
    return habitat.PathFinder(Scene.from_arrays(mesh.vertices, mesh.faces, 0.3), 1.5, RADIUS)


def way(paths: habitat.PathFinder, start: list[float], end: list[float]) -> habitat.ShortestPath:
    path = habitat.ShortestPath(start, end)
    assert paths.find_path(path) == np.isfinite(path.geodesic_distance)
    return path


def test_the_floor_is_the_rooms_less_the_agents_radius() -> None:
    paths = finder()
    assert paths.is_loaded
    exact, cell = np.array([6 - 2 * RADIUS, 5 - 2 * RADIUS]), 0.05
    assert (exact - 3 * cell).prod() < paths.navigable_area <= exact.prod()  # cells err towards blocked
    low, high = paths.get_bounds()
    np.testing.assert_allclose(low, [RADIUS, 0.0, -5.0 + RADIUS], atol=0.06)
    np.testing.assert_allclose(high, [6.0 - RADIUS, 0.0, -RADIUS], atol=0.06)  # the roof is no floor
    assert paths.island_radius([3, 0, -2]) == pytest.approx(np.sqrt(paths.navigable_area / np.pi))


def test_random_points_are_even_over_the_floor_and_the_seeds() -> None:
    paths = finder()
    points = np.array([paths.get_random_navigable_point() for _ in range(4000)])
    assert points.dtype == np.float64  # what clients reckon with such points they write as JSON
    assert all(paths.is_navigable(p) for p in points[:200])
    spread = np.array([5.8, 4.8]) / np.sqrt(12.0)
    z = (points[:, [0, 2]].mean(axis=0) - [3.0, -2.5]) / (spread / np.sqrt(len(points)))
    assert np.abs(z).max() < 4.0
    np.testing.assert_allclose(points[:, [0, 2]].std(axis=0), spread, rtol=0.03)
    paths.seed(3)
    first = paths.get_random_navigable_point()
    assert not np.array_equal(first, paths.get_random_navigable_point())
    paths.seed(3)
    assert np.array_equal(first, paths.get_random_navigable_point())


def test_ways_straight_and_around_a_wall() -> None:
    free = way(finder(), [1, 0, -1], [5, 0, -4])
    assert free.geodesic_distance == pytest.approx(5.0, abs=0.08)
    assert len(free.points) == 2
    around = way(finder([[2.9, 0.0, -0.1], [3.1, 4.0, 2.8]]), [1, 0, -1], [5, 0, -1])
    exact = (
        2.0 * np.hypot(1.9 - RADIUS, 3.0 + RADIUS) + 0.2 + 2.0 * RADIUS
    )  # by both corners of the wall
    assert exact - 0.02 < around.geodesic_distance < exact + 0.15  # cells err towards blocked
    assert 3 <= len(around.points) <= 6
    np.testing.assert_allclose(around.points[0], [1, 0, -1], atol=0.04)


def test_the_nearest_of_several_goals_is_the_one_by_walking() -> None:
    """A goal 2 m off behind a wall is farther than one 3.5 m off in the open; one without a way is passed over."""
    paths = finder(
        [[2.9, 0.0, -0.1], [3.1, 4.0, 2.8]], [[4.9, 0.0, -0.1], [5.1, 5.1, 2.8]]
    )  # a wall with a gap, and a room without a door
    start = [2.0, 0.0, -0.5]
    path = habitat.MultiGoalShortestPath(start, [[4.0, 0.0, -0.5], [5.5, 0.0, -2.0], [2.0, 0.0, -4.0]])
    assert paths.find_path(path) and path.closest_end_point_index == 2
    assert path.geodesic_distance == pytest.approx(3.5, abs=0.08)
    alone = way(paths, start, [2.0, 0.0, -4.0])
    assert path.geodesic_distance == alone.geodesic_distance
    np.testing.assert_array_equal(path.points, alone.points)
    path.requested_ends = [[5.5, 0.0, -2.0]]
    assert not paths.find_path(path)
    assert (path.closest_end_point_index, path.geodesic_distance, path.points) == (-1, np.inf, [])
    path.requested_ends = []
    assert not paths.find_path(path) and path.closest_end_point_index == -1
    with pytest.raises(RlrError, match="requested_ends"):
        paths.find_path(habitat.MultiGoalShortestPath(start, [[float("nan"), 0.0, 0.0]]))


def test_rooms_without_a_door_are_islands() -> None:
    paths = finder([[2.9, -0.1, -0.1], [3.1, 5.1, 2.8]])
    assert not np.isfinite(way(paths, [1, 0, -1], [5, 0, -1]).geodesic_distance)
    assert paths.island_radius([1, 0, -1]) == pytest.approx(np.sqrt(2.7 * 4.8 / np.pi), rel=0.03)


def test_places_off_the_floor() -> None:
    paths = finder([[2.0, 2.0, 0.0], [3.0, 3.0, 0.5]])  # a block too high to step on
    assert not paths.is_navigable([2.5, 0.0, -2.5])
    assert paths.is_navigable([1.0, 0.4, -1.0])
    assert not paths.is_navigable([1.0, 0.6, -1.0])
    np.testing.assert_allclose(paths.snap_point([1.0, 1.5, -1.0]), [1.0, 0.0, -1.0], atol=0.04)
    assert paths.island_radius([9.0, 0.0, 0.0]) == 0.0
    with pytest.raises(TypeError, match="is_navigable"):
        paths.is_navigable([1.0, 2.0])


def test_a_scene_without_a_floor() -> None:
    wall = Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 0, 1]], [[0, 1, 2]], 0.3)
    paths = habitat.PathFinder(wall, 1.5, RADIUS)
    assert not paths.is_loaded
    assert np.isnan(paths.snap_point([0, 0, 0])).all()
    assert not way(paths, [0, 0, 0], [1, 0, 0]).points
    with pytest.raises(RlrError, match="no floor for an agent"):
        paths.get_random_navigable_point()
