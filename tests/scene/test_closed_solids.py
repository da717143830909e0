"""Which pieces of a mesh are closed solids."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import soundspaces_sim as ss
from soundspaces_sim.scene.closed_solids import closed_solids
from tests.rooms import box, table, two_rooms

MATERIAL = table(0.1, 0.2, 0.05)
ROOM = box((5.0, 4.0, 2.5), MATERIAL)


def _with(*bodies: ss.Scene, shared: bool = False) -> ss.Scene:
    """The room with bodies in it; with `shared`, corners in one place are one vertex."""
    parts = [ROOM, *bodies]
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)])
    if shared:
        vertices, row = np.unique(vertices, axis=0, return_inverse=True)
        faces = row.reshape(-1)[faces]
    return ss.Scene(vertices, faces, np.zeros(len(faces), int), MATERIAL)


def _body(size: tuple[float, float, float], at: tuple[float, float, float]) -> ss.Scene:
    body = box(size, MATERIAL)
    return ss.Scene(body.vertices + np.array(at), body.faces, body.face_material, MATERIAL)


def _solids(scene: ss.Scene) -> list[int]:
    """Faces of each solid."""
    return list(np.bincount(closed_solids(scene).of_face + 1)[1:])


def test_bodies_in_a_room_are_solids_and_rooms_are_not() -> None:
    wall, wardrobe = _body((0.1, 3.0, 2.4), (2.0, 0.5, 0.05)), _body((0.6, 1.0, 2.0), (3.0, 1.0, 0.1))
    closet = _body((1.0, 1.2, 2.2), (3.7, 2.6, 0.1))
    found = closed_solids(_with(wall, wardrobe, closet)).of_face
    np.testing.assert_array_equal(found, np.repeat([-1, 0, 1, -1], 12))


@pytest.mark.parametrize(
    "scene", [ROOM, two_rooms(MATERIAL, door=False), box((0.2, 0.1, 0.05), MATERIAL)]
)
def test_a_piece_as_large_as_the_scene_is_a_room(scene: ss.Scene) -> None:
    """Walls without a thickness are none either."""
    assert _solids(scene) == []


@pytest.mark.parametrize("shared", [False, True])
def test_bodies_that_touch_are_apart(shared: bool) -> None:
    """A lintel on a wall: they share an edge, or a part of a face. One stands on a corner of another."""
    wall, lintel = _body((0.1, 1.0, 2.0), (2.0, 1.0, 0.1)), _body((0.1, 1.0, 0.3), (2.1, 1.0, 2.1))
    beside = _body((0.4, 0.5, 0.6), (2.1, 1.2, 0.2))
    assert _solids(_with(wall, lintel, beside, shared=shared)) == [12, 12, 12]


def test_what_is_open_or_wound_both_ways_is_none() -> None:
    body = _body((0.3, 0.4, 0.5), (1.0, 1.0, 0.5))
    turned = body.faces.copy()
    turned[3] = turned[3, ::-1]
    for faces in (body.faces[1:], turned):
        assert _solids(_with(ss.Scene(body.vertices, faces, np.zeros(len(faces), int), MATERIAL))) == []


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("inward", [False, True])
def test_outward_is_where_normals_point_out(seed: int, inward: bool) -> None:
    """However the body lies, its triangles are ordered, and whether they share corners."""
    rng = np.random.default_rng(seed)
    body = _body((0.3, 0.9, 0.2), (0.0, 0.0, 0.0))
    turn = Rotation.random(random_state=seed).as_matrix()
    vertices = body.vertices @ turn.T + [2.5, 2.0, 1.2]
    faces = body.faces[:, ::-1] if inward else body.faces
    faces = np.stack([np.roll(face, k) for face, k in zip(faces, rng.integers(3, size=12), strict=True)])
    faces = faces[rng.permutation(12)]
    if seed % 2:
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(36).reshape(12, 3)
    placed = ss.Scene(vertices, faces, np.zeros(12, int), MATERIAL)
    found = closed_solids(_with(placed))
    assert found.of_face.tolist() == [-1] * 12 + [0] * 12
    middle = placed.corners.mean(axis=1)
    out = ((middle - vertices.mean(axis=0)) * placed.normals).sum(axis=1) > 0.0
    np.testing.assert_array_equal(found.outward[12:], out)
    assert out.all() or not out.any()
