"""Patches: what scatters is on them, sound does not leak between them, and threads do not matter."""

from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.kernel import kernel, set_thread_count, thread_count
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.transport.arrivals.prepared import prepare_wedges
from soundspaces_sim.transport.bsdf.finite_size import size_scattering
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.radiance_transfer.patch_construction import make_patches
from soundspaces_sim.transport.radiance_transfer.patches import (
    CELL_SIZE,
    PATCH_SIZE,
    inverse,
    patch_at,
)
from soundspaces_sim.transport.radiance_transfer.shared_and_own import (
    trace_transfer_subpaths,
)
from soundspaces_sim.transport.state import World
from tests.marks import ci_slow
from tests.rooms import box, plain, table, two_rooms

MATERIAL = table(0.2, 0.3)


def _model(scene: ss.Scene) -> Model:
    return make_model(scene, np.array([[1.0, 1.0, 1.2]]), plain(duration=0.5))


@kernel
def _find_patches(world: World, faces: np.ndarray, points: np.ndarray, patch: np.ndarray) -> None:
    """Fill `patch` (n,): those of points (n, 3) of `faces`, seen from above."""
    for i in range(len(faces)):
        patch[i] = patch_at(world.patches, world.geometry, faces[i], row(points, i), (0.0, 0.0, 1.0))


def _on_floor(model: Model, x: np.ndarray, y: float) -> np.ndarray:
    """(n,) patch of the floor, seen from above, at places (x, y)."""
    scene, faces = model.scene, []
    floor = np.flatnonzero(
        (np.abs(scene.normals[:, 2]) > 0.9) & (scene.corners[:, :, 2].max(axis=1) < 1e-9)
    )
    places = np.column_stack([x, np.full_like(x, y), np.zeros_like(x)])
    for place in places:
        a, b, c = (scene.corners[floor] - place).transpose(1, 0, 2)[:, :, :2]
        sides = [u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] for u, v in ((a, b), (b, c), (c, a))]
        faces.append(floor[(np.sign(sides).min(axis=0) == np.sign(sides).max(axis=0)).argmax()])
    patch = np.empty(len(faces), np.int64)
    _find_patches(model.world, np.array(faces), places - scene.center, patch)
    return patch


def test_all_that_an_empty_room_scatters_is_on_patches() -> None:
    """1 / weight is the integral of rho s over a patch: in all (1 - .2) .3 of 126 m², inside and outside."""
    scene = box((6.0, 5.0, 3.0), MATERIAL)
    patches = _model(scene).world.patches
    np.testing.assert_allclose(inverse(patches.weight).sum(axis=0), 0.8 * 0.3 * 2.0 * 126.0, rtol=0.01)
    assert np.all(inverse(patches.weight) <= 0.8 * 0.3 * (1.5 * PATCH_SIZE) ** 2)
    assert np.all(np.diff(patches.places.start) > 0)
    for c in range(len(patches.weight)):
        share = patches.places.upto[patches.places.start[c] : patches.places.start[c + 1]]
        assert np.all(np.diff(share) > 0.0) and share[-1] == pytest.approx(1.0)


def test_numbers_of_neighbours_follow_each_other() -> None:
    """Patches of a cell of the coarse lattice have consecutive numbers, each piece lies at most a patch from its
    patch's middle, and what lies on it is found again: patch by patch on the floor."""
    model = _model(two_rooms(MATERIAL))
    patches = model.world.patches
    cell = np.floor(patches.middle / CELL_SIZE)
    runs = 1 + int((np.diff(cell, axis=0) != 0.0).any(axis=1).sum())
    assert runs == len(np.unique(cell, axis=0)) > 8
    own = np.repeat(np.arange(len(cell)), np.diff(patches.places.start))
    far = np.linalg.norm(patches.places.corners.mean(axis=1) - patches.middle[own], axis=1)
    assert far.max() < np.sqrt(3.0) * PATCH_SIZE
    assert np.bincount(patches.of_piece[patches.of_piece >= 0]).min() > 0
    x = np.linspace(0.3, 3.7, 18) + 1e-3
    on_floor = _on_floor(model, x, 1.9)
    found = on_floor >= 0
    middle = patches.middle[on_floor[found]] + model.scene.center
    assert found.sum() > 12 and np.abs(middle[:, 0] - x[found]).max() < PATCH_SIZE
    np.testing.assert_allclose(middle[:, 2], 0.0, atol=1e-6)


def test_a_wall_that_ends_above_the_floor_parts_patches() -> None:
    """One cell of the lattice spans the place of the wall, x = 4."""
    x = np.linspace(3.6, 4.5, 19) + 1e-3
    found = []
    for scene in (box((8.0, 4.0, 2.5), MATERIAL), two_rooms(MATERIAL, door=False, gap=0.1)):
        patch = _on_floor(_model(scene), x, 1.9)
        left, right = (set(patch[side]) - {-1} for side in (x < 4.0, x > 4.0))
        assert left and right
        found.append(left & right)
    assert found[0] and not found[1]


def test_floor_below_a_table_is_another_patch_than_floor_beside_it() -> None:
    room = box((8.0, 4.0, 2.5), MATERIAL)
    top = np.array([[4.03, 1.0, 0.3], [5.5, 1.0, 0.3], [5.5, 3.0, 0.3], [4.03, 3.0, 0.3]])
    scene = ss.Scene(
        np.concatenate([room.vertices, top]),
        np.concatenate([room.faces, [[8, 9, 10], [8, 10, 11]]]), np.zeros(14, int), room.materials,
    )  # fmt: skip
    x = np.linspace(3.6, 4.5, 19) + 1e-3
    patch = _on_floor(_model(scene), x, 1.9)
    beside, below = set(patch[x < 4.03]) - {-1}, set(patch[x > 4.03]) - {-1}
    assert beside and below and not beside & below


def test_a_scene_of_small_things_has_no_patches() -> None:
    """Each of a cube's sides is smaller than a patch must be, .096 m²."""
    cube = box((0.3, 0.3, 0.3), MATERIAL)
    scattered = np.full((12, 2, 4), 0.24)
    patches = make_patches(cube.geometry, cube.corners - cube.center, scattered, PATCH_SIZE)
    assert patches.weight.shape == (0, 4) and np.all(patches.of_piece == -1)


def _prepared() -> list[Any]:
    """What the demo scene is prepared to be, and transfer subpaths for points of two rooms; nothing is read
    from disk."""
    scene, config = (
        ss.load_scene("demo"),
        ss.SimulationConfig(duration=0.1, radiance_transfer=ss.RadianceTransferConfig(enabled=False)),
    )
    corners = scene.corners - scene.center
    by_size = size_scattering(scene, config.bands, config.c)
    scattered = np.stack([0.5 * by_size + 0.1, 0.3 * by_size + 0.2], axis=1)
    patches = make_patches(scene.geometry, corners, scattered, PATCH_SIZE)

    edges, links = prepare_wedges(scene, config)
    shared = trace_transfer_subpaths(_model(two_rooms(MATERIAL)).world, 0)
    return [by_size, *patches[:-1], *patches.places, *edges, *links, *shared]


@ci_slow
def test_threads_do_not_matter() -> None:
    found, before = [], thread_count()
    for threads in (1, 3):
        set_thread_count(threads)
        try:
            found.append(_prepared())
        finally:
            set_thread_count(before)
    for other in found[1:]:
        for a, b in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(a, b)
