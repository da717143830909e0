"""Areas, normals and connected pieces against values from elsewhere."""

from typing import Any

import numpy as np
import pytest
import trimesh

from soundspaces_sim.scene.triangles import (
    areas,
    beyond_sides,
    boxes,
    corners_of,
    cross_products,
    lone_sides,
    longest_edges,
    middles,
    pieces_of,
    side_numbers,
    welded,
    welded_faces,
)


def test_areas_and_normals_of_a_3_4_5_triangle() -> None:
    corners = np.array([[[0, 0, 0], [3, 0, 0], [0, 4, 0]]], float)
    np.testing.assert_allclose(areas(corners), [6.0])
    np.testing.assert_allclose(cross_products(corners), [[0.0, 0.0, 12.0]])
    np.testing.assert_allclose(longest_edges(corners), [25.0])
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.7)
    np.testing.assert_allclose(areas(np.asarray(ball.triangles)), ball.area_faces, rtol=1e-12)


def test_pieces_of_loose_and_welded_corners() -> None:
    """Three boxes, one of them with every corner stored anew: as many pieces as trimesh finds."""
    boxes = [trimesh.creation.box(bounds=[[x, 0, 0], [x + 1, 1, 1]]) for x in (0.0, 1.5, 3.0)]
    boxes[1].unmerge_vertices()
    mesh: Any = trimesh.util.concatenate(boxes)
    loose = pieces_of(np.asarray(mesh.faces), len(mesh.vertices))
    assert loose.max() + 1 == 14  # the middle box falls into its twelve triangles
    points, faces = welded(np.asarray(mesh.triangles), 5)
    pieces = pieces_of(faces, len(points))
    assert len(points) == 24
    np.testing.assert_array_equal(pieces, np.repeat([0, 1, 2], 12))
    mesh.merge_vertices()
    assert mesh.body_count == 3


def _soup(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles between vertices of which some are in one place, and some, which are not finite, unused."""
    rng = np.random.default_rng(number)
    vertices = rng.normal(size=(number, 3)).round(1) + rng.choice([0.0, 1e-7], (number, 3))
    vertices[-3:] = np.nan, np.inf, -np.inf
    return vertices, rng.integers(0, number - 3, (2 * number, 3))


def test_to_the_bit_as_numpy_measures() -> None:
    vertices, faces = _soup(9000)  # more than one thread has
    corners = vertices[faces]
    np.testing.assert_array_equal(corners_of(vertices, faces), corners)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_array_equal(cross_products(corners), cross)
    np.testing.assert_array_equal(areas(corners), 0.5 * np.linalg.norm(cross, axis=1))
    np.testing.assert_array_equal(middles(corners), corners.mean(axis=1))
    edges = ((corners - corners[:, [1, 2, 0]]) ** 2).sum(axis=2).max(axis=1)
    np.testing.assert_array_equal(longest_edges(corners), edges)
    for found, expected in zip(boxes(corners), (corners.min(axis=1), corners.max(axis=1)), strict=True):
        np.testing.assert_array_equal(found, expected)
    corners[7, 1, 2] = np.nan
    assert all(np.isnan(found[7, 2]) for found in boxes(corners))


@pytest.mark.parametrize("number", [40, 60_000])
def test_vertices_are_welded_as_corners_are(number: int) -> None:
    vertices, faces = _soup(number)
    for found, expected in zip(
        welded_faces(vertices, faces, 5), welded(vertices[faces], 5), strict=True
    ):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("number", [40, 60_000])
def test_sides_between_the_same_points_are_one(number: int) -> None:
    _, faces = _soup(number)
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    expected = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)[1]
    np.testing.assert_array_equal(side_numbers(faces).ravel(), expected.ravel())
    far = faces + 2**40  # whose products are beyond any number
    np.testing.assert_array_equal(side_numbers(far), side_numbers(faces))
    assert side_numbers(faces[:0]).shape == (0, 3)


def test_the_face_beyond_a_side() -> None:
    """As side numbers have it: of sides that two faces have, the other one; of the rest, none."""
    rng = np.random.default_rng(8)
    for points in (4, 12, 40):
        faces = rng.integers(0, points, (60, 3))
        side = side_numbers(faces)
        real = np.flatnonzero((faces != np.roll(faces, 1, axis=1)).all(axis=1))
        alone = np.zeros(faces.shape, bool)
        number = side[real]
        alone[real] = np.bincount(number.ravel())[number] == 1
        np.testing.assert_array_equal(lone_sides(faces, points), alone)
        owner = np.repeat(np.arange(60), 3)
        expected = np.full((60, 3), -1)
        for f, k in np.ndindex(60, 3):
            owners = owner[side.ravel() == side[f, k]]
            if len(owners) == 2:
                expected[f, k] = owners.sum() - f
        np.testing.assert_array_equal(beyond_sides(faces, points), expected)
        assert points < 40 or (expected >= 0).sum() > 20
    assert beyond_sides(faces[:0], 0).shape == (0, 3)
