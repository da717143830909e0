"""Which side of faces is out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import soundspaces_sim as ss
from soundspaces_sim.scene.windings import outward_sides
from tests.rooms import box, table

MATERIAL = table(0.1, 0.2, 0.05)
ROOM = box((5.0, 4.0, 2.5), MATERIAL)


def _with(*bodies: ss.Scene) -> ss.Scene:
    """The room with bodies in it."""
    parts = [ROOM, *bodies]
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)])
    return ss.Scene(vertices, faces, np.zeros(len(faces), int), MATERIAL)


def _body(size: tuple[float, float, float], at: tuple[float, float, float]) -> ss.Scene:
    body = box(size, MATERIAL)
    return ss.Scene(body.vertices + np.array(at), body.faces, body.face_material, MATERIAL)


def _out(scene: ss.Scene) -> np.ndarray:
    """(F,) whether what counts as outward points away from the middle of a scene of one convex body."""
    away = scene.corners.mean(axis=1) - scene.center
    return np.asarray((away * scene.normals).sum(axis=1) * outward_sides(scene) > 0.0)


def _placed(seed: int, inward: bool) -> ss.Scene:
    """A body that lies anyhow, its triangles in any order; of odd seeds corners are not shared."""
    rng = np.random.default_rng(seed)
    body = _body((0.3, 0.9, 0.2), (0.0, 0.0, 0.0))
    vertices = body.vertices @ Rotation.random(random_state=seed).as_matrix().T + [2.5, 2.0, 1.2]
    faces = body.faces[:, ::-1] if inward else body.faces
    faces = np.stack([np.roll(face, k) for face, k in zip(faces, rng.integers(3, size=12), strict=True)])
    faces = faces[rng.permutation(12)]
    if seed % 2:
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(36).reshape(12, 3)
    return ss.Scene(vertices, faces, np.zeros(12, int), MATERIAL)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("inward", [False, True])
def test_bodies_look_out_however_they_are_wound(seed: int, inward: bool) -> None:
    """Also with a triangle that is missing, and with some that are wound the other way than the rest."""
    rng = np.random.default_rng(seed)
    scene = _placed(seed, inward)
    assert _out(scene).all()
    open_ = ss.Scene(
        scene.vertices, np.delete(scene.faces, rng.integers(12), axis=0), np.zeros(11, int), MATERIAL
    )
    assert _out(open_).mean() == 1.0
    faces = scene.faces.copy()
    some = rng.choice(12, 3, replace=False)
    faces[some] = faces[some, ::-1]
    assert _out(ss.Scene(scene.vertices, faces, np.zeros(12, int), MATERIAL)).all()


def test_rooms_stay_as_they_are_wound() -> None:
    """Their faces look in or out: both are common."""
    for faces in (ROOM.faces, ROOM.faces[:, ::-1]):
        scene = ss.Scene(ROOM.vertices, faces, ROOM.face_material, MATERIAL)
        np.testing.assert_array_equal(outward_sides(scene), 1)


def test_bodies_that_touch_are_turned_apart() -> None:
    """A lintel on a wall, of which one is inside out: they share an edge, and a part of a face."""
    wall, lintel = _body((0.1, 1.0, 2.0), (2.0, 1.0, 0.1)), _body((0.1, 1.0, 0.3), (2.1, 1.0, 2.1))
    lintel = ss.Scene(lintel.vertices, lintel.faces[:, ::-1], lintel.face_material, MATERIAL)
    np.testing.assert_array_equal(outward_sides(_with(wall, lintel)), np.repeat([1, 1, -1], 12))


def test_what_has_no_sides_stays_as_it_is_stored() -> None:
    """A Moebius strip."""
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    radial = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    across = 0.2 * (np.cos(turn / 2)[:, None] * radial + np.sin(turn / 2)[:, None] * [0.0, 0.0, 1.0])
    vertices = np.concatenate([radial - across, radial + across])
    k, n = np.arange(12), (np.arange(12) + 1) % 12
    low, high = np.where(n == 0, n + 12, n), np.where(n == 0, n, n + 12)
    faces = np.concatenate([np.stack([k, low, k + 12], axis=1), np.stack([low, high, k + 12], axis=1)])
    scene = ss.Scene(vertices, faces, np.zeros(24, int), MATERIAL)
    np.testing.assert_array_equal(outward_sides(scene), 1)
