"""What is kept of a scene while objects move, and that results tell nothing of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import trimesh
from soundspaces_rlr import preparation
from soundspaces_rlr.api import BoxMaterialCategories, Config, Context
from soundspaces_rlr.errors import RlrError

from neighbours.rlr_audio_propagation.tests.rooms import MONO, populate, quick, response
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.arrivals.prepared import prepare_planes
from soundspaces_sim.transport.preparation import make_model

HALL = (16.0, 11.0, 3.0)
SOURCE, EAR = (2.0, 2.0, 1.5), (13.0, 8.0, 1.4)
TURN = [np.cos(0.4), 0.0, 0.0, np.sin(0.4)]
Pose = tuple[Sequence[float], Sequence[float]]  # position, quaternion


def hall(poses: Sequence[Pose], config: Config | None = None) -> Context:
    """A hall with boxes of .8 m in it."""
    context = Context(config or quick(max_ir_length=0.4))
    context.add_object()
    context.set_object_box(0, [0, 0, 0], HALL, BoxMaterialCategories())
    for i, pose in enumerate(poses, start=1):
        context.add_object()
        context.set_object_box(i, [-0.4, -0.4, 0], [0.4, 0.4, 0.8], BoxMaterialCategories())
        put(context, i, pose)
    return populate(context, [SOURCE], [(EAR, MONO)])


def put(context: Context, index: int, pose: Pose) -> None:
    context.set_object_position(index, pose[0])
    context.set_object_orientation_quaternion(index, pose[1])


def made_anew(context: Context) -> tuple[int, int]:
    """Parts of the scene at hand that the one before did not have, and all of its parts."""
    now, before = context._kept._now, context._kept._before
    return len(now.keys() - before.keys()), len(now)


STILL = [1.0, 0.0, 0.0, 0.0]
ASIDE: Pose = ([6.0, 3.0, 1.0], STILL)  # in the air
STEPS: dict[str, list[Pose]] = {
    "in the air": [ASIDE, ([6.5, 3.2, 1.1], TURN)],
    "onto the floor, face on face": [ASIDE, ([6.0, 3.0, 0.0], STILL)],
    "into the other box's side": [ASIDE, ([10.8, 7.0, 0.0], STILL)],
    "there and back": [ASIDE, ([14.0, 3.0, 0.5], TURN), ASIDE],
    "out through a wall, so that bounds change": [ASIDE, ([15.9, 3.0, 0.5], STILL)],
}


@pytest.mark.parametrize("steps", STEPS.values(), ids=STEPS)
def test_a_moved_object_sounds_as_in_a_scene_made_afresh(steps: list[Pose]) -> None:
    other: Pose = ([10.0, 7.0, 0.0], STILL)
    moved = hall([steps[0], other])
    moved.simulate()
    for pose in steps[1:]:
        put(moved, 1, pose)
        moved.simulate()
    fresh = hall([steps[-1], other])
    fresh.simulate()
    assert np.array_equal(response(moved), response(fresh))
    assert response(moved).any()


def test_only_what_has_moved_is_made_again() -> None:
    context = hall([([8.0, 5.5, 1.0], STILL), ([12.0, 5.5, 1.0], STILL)])
    context.simulate()
    new, all_parts = made_anew(context)
    assert new == all_parts == 3
    put(context, 1, ([8.3, 5.7, 1.0], STILL))
    context.simulate()
    assert made_anew(context) == (1, all_parts)
    put(context, 1, ([8.3, 5.7, 1.0], STILL))  # where it is already
    context.set_source_position(0, [3.0, 2.0, 1.5])
    context.simulate()
    assert made_anew(context) == (1, all_parts)  # the same scene still


def test_what_is_kept_does_not_grow() -> None:
    context = hall([ASIDE], quick(max_ir_length=0.2))
    for x in np.linspace(4.0, 12.0, 12):
        put(context, 1, ([x, 3.0, 1.0], STILL))
        context.simulate()
    assert len(context._kept._now) + len(context._kept._before) < 50


def furnished() -> Scene:
    """A hall of small and large triangles without faces that coincide."""
    parts = [trimesh.creation.box(bounds=np.array([np.zeros(3), HALL]))]
    random = np.random.default_rng(0)
    for i in range(12):
        box = trimesh.creation.box(random.uniform(0.3, 1.5, 3))
        box = box.subdivide() if i % 2 else box
        box.apply_transform(trimesh.transformations.random_rotation_matrix(random.random(3)))
        box.apply_translation(random.uniform([1.5, 1.5, 1.2], np.array(HALL) - [1.5, 1.5, 1.2]))
        parts.append(box)
    mesh: Any = trimesh.util.concatenate(parts)
    return Scene.from_arrays(mesh.vertices, mesh.faces, 0.2, 0.4)


def test_planes_of_one_object_are_the_engines() -> None:
    scene = furnished()
    model = make_model(scene, np.array([SOURCE]))
    engines = model.prepared.part(prepare_planes)
    planes = preparation._planes(scene, np.zeros(len(scene.faces), np.int64), preparation.Kept())
    assert len(planes.offset) == len(engines.offset) >= 6
    for face in np.flatnonzero(planes.of_face >= 0):
        theirs = model.world.geometry.plane[face]
        assert planes.offset[planes.of_face[face]] == engines.offset[theirs]
        assert np.array_equal(planes.normal[planes.of_face[face]], engines.normal[theirs])
    assert ((planes.of_face >= 0) == (model.world.geometry.plane >= 0)).all()


def test_a_face_beyond_all_measure() -> None:
    """Ground of 10 km beside a box; one of 100 km is refused."""

    def beside(reach: float) -> Context:
        context = hall([ASIDE])
        context.add_object()
        ground = np.array([[-reach, -reach, -1.0], [reach, -reach, -1.0], [0.0, reach, -1.0]])
        context.add_mesh_vertices(ground.ravel().tolist())
        context.add_mesh_indices([0, 1, 2], 3, "default")
        context.finalize_object_mesh(2)
        return context

    with pytest.raises(RlrError, match="20,000 m is the most"):
        beside(5e4).simulate()
    context = beside(5e3)
    context.simulate()
    assert response(context).any()
    assert len(context._kept._now) < 100
