"""Small holes of a mesh are closed, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.scene.holes import close_holes
from soundspaces_sim.scene.labelled import LabelledMesh


def _mesh(vertices: np.ndarray, faces: np.ndarray) -> LabelledMesh:
    return LabelledMesh(
        np.asarray(vertices), np.asarray(faces), ("wall", "floor"), np.arange(len(faces)) % 2, "mesh"
    )


def _fine(size: float, side: float) -> trimesh.Trimesh:
    """A box of this size, m, of triangles with sides of about `side`."""
    whole: trimesh.Trimesh = trimesh.creation.box([size] * 3).subdivide_to_size(side)
    return whole


@pytest.mark.parametrize("missing", [0.001, 0.01, 0.03])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_missing_triangles_are_put_back(missing: float, seed: int) -> None:
    """The area and the volume of the whole come back, wound as they were, but for holes that have grown too large."""
    whole = _fine(2.0, 0.1)
    rng = np.random.default_rng(seed)
    kept = whole.faces[rng.random(len(whole.faces)) >= missing]
    closed = close_holes(_mesh(whole.vertices, kept))
    found = trimesh.Trimesh(closed.vertices, closed.faces, process=True)
    assert "holes" in closed.notes[-1]
    assert found.area == pytest.approx(whole.area, rel=2e-4)
    assert found.is_winding_consistent
    assert found.volume == pytest.approx(whole.volume, rel=5e-4)
    np.testing.assert_array_equal(closed.faces[: len(kept)], kept)


def test_labels_are_those_around() -> None:
    whole = _fine(2.0, 0.1)
    mesh = _mesh(whole.vertices, whole.faces[1:])
    for label in (0, 1):
        one = LabelledMesh(
            mesh.vertices, mesh.faces, mesh.labels, np.full(len(mesh.faces), label), mesh.name
        )
        closed = close_holes(one)
        assert len(closed.faces) == len(whole.faces)
        assert closed.face_label[-1] == label


def test_one_face_of_noisy_points() -> None:
    whole = _fine(2.0, 0.1)
    points = whole.vertices + np.random.default_rng(0).normal(0.0, 0.005, whole.vertices.shape)
    closed = close_holes(_mesh(points, np.delete(whole.faces, [10, 400, 401], axis=0)))
    assert trimesh.Trimesh(closed.vertices, closed.faces, process=True).is_watertight


def _window() -> trimesh.Trimesh:
    whole = _fine(2.0, 0.1)
    middle = whole.triangles_center
    in_window = (np.abs(middle[:, :2]) < 0.2).all(axis=1) & (middle[:, 2] > 0.9)
    whole.update_faces(~in_window)
    return whole


@pytest.mark.parametrize(
    "body",
    [
        pytest.param(_window(), id="a window of 40 cm"),
        pytest.param(
            trimesh.Trimesh(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]), [[0, 1, 2]]),
            id="a small sheet",
        ),
        pytest.param(
            trimesh.Trimesh(
                np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]), [[0, 1, 2], [0, 2, 3]]
            ),
            id="a sheet of two triangles",
        ),
        pytest.param(_fine(2.0, 0.1), id="nothing missing"),
    ],
)
def test_what_is_no_hole_stays(body: trimesh.Trimesh) -> None:
    mesh = _mesh(body.vertices, body.faces)
    assert close_holes(mesh) is mesh


def test_an_open_cup_stays_open() -> None:
    cup = trimesh.creation.box([0.1, 0.1, 0.12])
    cup.update_faces(~(cup.face_normals[:, 2] > 0.9))
    mesh = _mesh(cup.vertices, cup.faces)
    assert close_holes(mesh) is mesh


def test_a_scene_says_what_was_closed() -> None:
    whole = _fine(3.0, 0.15)
    room = trimesh.Trimesh(whole.vertices, np.delete(whole.faces, [5, 77], axis=0)[:, ::-1])
    scene = ss.load_scene(room)
    assert any(note.startswith("2 holes of up to 0.6 m") for note in scene.notes)
    assert len(scene.faces) == len(whole.faces)
