"""Areas, normals and connected pieces against values from elsewhere."""

from typing import Any

import numpy as np
import trimesh

from soundspaces_sim.scene.triangles import areas, cross_products, longest_edges, pieces_of, welded


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
