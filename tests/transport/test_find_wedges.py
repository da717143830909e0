"""Which edges of a mesh diffract sound."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import soundspaces_sim as ss
from soundspaces_sim.transport.arrivals.find_wedges import find_wedges
from soundspaces_sim.transport.arrivals.scene_edges import (
    _NEARER,
    _PLACES,
    _covered,
    find_mutual_visibility,
)
from soundspaces_sim.transport.arrivals.wedges import Wedges
from tests.rooms import box, edges_alone, sphere, table, two_rooms


def _cuboid(low: list[float], high: list[float], cuts: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A closed block, each side cut into cuts² squares of two triangles."""
    corners, at = [], np.linspace(0.0, 1.0, cuts + 1)
    span = np.subtract(high, low)
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (0.0, 1.0):
            for i in range(cuts):
                for j in range(cuts):
                    quad = np.empty((4, 3))
                    quad[:, axis] = side
                    quad[:, u] = at[[i, i + 1, i + 1, i]]
                    quad[:, v] = at[[j, j, j + 1, j + 1]]
                    quad = np.array(low) + quad * span
                    corners += [quad[[0, 1, 2]], quad[[0, 2, 3]]]
    vertices = np.concatenate(corners)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _in_box(vertices: np.ndarray, faces: np.ndarray) -> ss.Scene:
    """A mesh inside a room of 6 x 5 x 3 m."""
    room = box((6.0, 5.0, 3.0), table(0.3, 0.4))
    v = np.concatenate([room.vertices, vertices])
    f = np.concatenate([room.faces, faces + len(room.vertices)])
    return ss.Scene(v, f, np.zeros(len(f), int), room.materials, name="block")


def _inside(wedges: Wedges, scene: ss.Scene) -> Wedges:
    """Without the edges of the room's own hull, which look outward."""
    low, high = scene.bounds[0] - scene.center, scene.bounds[1] - scene.center
    middle = wedges.start + 0.5 * wedges.length[:, None] * wedges.along
    hull = (np.minimum(middle - low, high - middle) < 1e-6).sum(axis=1) >= 2
    return Wedges(*(column[~hull] for column in wedges))


def test_a_block_has_twelve_edges() -> None:
    """1 x 0.6 x 0.8 m in mid-air: twelve corners of 90 degrees."""
    scene = _in_box(*_cuboid([2.0, 2.0, 1.0], [3.0, 2.6, 1.8]))
    wedges = _inside(find_wedges(scene), scene)
    assert sorted(np.round(wedges.length, 9)) == [0.6] * 4 + [0.8] * 4 + [1.0] * 4
    np.testing.assert_allclose(wedges.n, 1.5, atol=1e-9)
    np.testing.assert_allclose((wedges.face * wedges.normal).sum(axis=1), 0.0, atol=1e-12)
    outside = (
        wedges.start
        + scene.center
        + 0.3 * wedges.offset / np.linalg.norm(wedges.offset, axis=1)[:, None]
    )
    assert ((outside < [2.0, 2.0, 1.0]) | (outside > [3.0, 2.6, 1.8])).any(axis=1).all()


def test_a_block_on_the_floor_has_eight() -> None:
    """Where it stands on the floor, and where its back is at a wall, nothing is diffracted."""
    scene = _in_box(*_cuboid([2.0, 2.0, 0.0], [3.0, 2.6, 0.8]))
    assert len(_inside(find_wedges(scene), scene).length) == 8
    scene = _in_box(*_cuboid([0.0, 2.0, 0.0], [1.0, 2.6, 0.8]))
    assert (
        len(_inside(find_wedges(scene), scene).length) == 5
    )  # the front's four but the foot, two along the top


@pytest.mark.parametrize("cuts", [2, 3, 7])
def test_tessellation_changes_nothing(cuts: int) -> None:
    """A block cut into small triangles has the same edges, and gives the same arrivals, to the bit, where
    no reflection meets an edge: rays may say either there."""
    low, high = [2.0, 2.0, 0.8], [3.1, 2.7, 1.9]
    plain_, fine = _in_box(*_cuboid(low, high)), _in_box(*_cuboid(low, high, cuts))
    for a, b in zip(find_wedges(plain_), find_wedges(fine), strict=True):
        np.testing.assert_array_equal(a, b)
    config = edges_alone()
    points = np.array([[1.5, 2.3, 1.2], [2.9, 3.0, 1.31], [2.2, 1.5, 1.2], [3.6, 2.6, 1.7]])
    echoes = [ss.simulate(scene, points, points, config) for scene in (plain_, fine)]
    diffracted = 0
    for s in range(4):
        for l in range(4):
            one, other = (e[s, l].arrivals for e in echoes)
            diffracted += sum(bool(x.edges) for x in one)
            for x, y in zip(one, other, strict=True):
                assert x.delay == y.delay and (x.edges, x.planes) == (y.edges, y.planes)
                np.testing.assert_array_equal(x.energy, y.energy)
    assert diffracted >= 4


def test_small_triangles_have_edges_however_they_are_turned() -> None:
    """Sides of 3 to 5 cm, of a block and a room that stand aslant, lie on their lines."""
    turn = Rotation.from_euler("zyx", [30.0, 17.0, 8.0], degrees=True)
    scene = _in_box(*_cuboid([2.0, 2.0, 0.8], [3.1, 2.7, 1.9], 24))
    aslant = ss.Scene(
        scene.vertices @ turn.as_matrix().T, scene.faces, scene.face_material, scene.materials
    )
    expected, found = find_wedges(scene), find_wedges(aslant)
    np.testing.assert_allclose(np.sort(found.length), np.sort(expected.length), atol=1e-6)
    np.testing.assert_allclose(np.sort(found.n), np.sort(expected.n), atol=1e-6)


def test_walls_cut_differently_at_a_corner_share_it() -> None:
    """One side of a corner in one piece, the other in three, none of which end where the first does."""
    v, f = _cuboid([2.0, 2.0, 1.0], [3.0, 3.0, 2.0])
    fine, g = _cuboid([2.0, 2.0, 1.0], [3.0, 3.0, 2.0], 3)
    top, others = v[f][:, :, 2].min(axis=1) > 1.999, fine[g][:, :, 2].min(axis=1) <= 1.999
    corners = np.concatenate([v[f][top], fine[g][others]])
    scene = _in_box(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    wedges = _inside(find_wedges(scene), scene)
    assert len(wedges.length) == 12
    np.testing.assert_allclose(wedges.n, 1.5, atol=1e-9)


def test_a_door_has_a_frame_of_three_borders() -> None:
    scene = two_rooms(table(0.3, 0.4))
    wedges = _inside(find_wedges(scene), scene)
    assert sorted(np.round(wedges.length, 6)) == [0.9, 2.0, 2.0]
    np.testing.assert_array_equal(wedges.n, 2.0)


def test_round_and_small_things_have_none() -> None:
    """A fine sphere turns by less than 20 degrees at a time; a stick of 0.2 m is tiny."""
    assert len(find_wedges(sphere(2.0, table(0.3, 0.4), 4)).length) == 0
    scene = _in_box(*_cuboid([2.0, 2.0, 1.0], [2.2, 2.2, 1.2]))
    assert len(_inside(find_wedges(scene), scene).length) == 0


def test_points_far_from_the_origin_change_nothing() -> None:
    scene = _in_box(*_cuboid([2.0, 2.0, 1.0], [3.0, 2.6, 1.8]))
    moved = ss.Scene(scene.vertices + 512.0, scene.faces, scene.face_material, scene.materials)
    for a, b in zip(find_wedges(scene), find_wedges(moved), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize(("thickness", "indices"), [(0.001, {2.0}), (0.02, {1.5})])
def test_a_plate_has_one_border_until_it_is_thick(thickness: float, indices: set[float]) -> None:
    scene = _in_box(*_cuboid([2.0, 2.0, 1.0], [3.0, 2.0 + thickness, 2.0]))
    wedges = _inside(find_wedges(scene), scene)
    assert set(np.round(wedges.n, 6)) == indices
    assert len(wedges.length) == (4 if thickness < 0.002 else 8)


def test_mutual_visibility_is_the_same_from_both_wedges() -> None:
    """Every pair of wedges that see each other has two rows, each the other's reverse, with the angles about
    its own."""
    rng = np.random.default_rng(7)
    blocks = [
        _cuboid(list(low), list(low + rng.uniform(0.4, 1.0, 3))) for low in rng.uniform(0.2, 1.5, (4, 3))
    ]
    v = np.concatenate([v for v, _ in blocks])
    f = np.arange(len(v)).reshape(-1, 3)
    scene = _in_box(v, f)
    wedges = find_wedges(scene)
    mutual = find_mutual_visibility(scene, wedges)
    own = np.repeat(np.arange(len(wedges.length)), np.diff(mutual.start))
    assert len(own) > 100 and (np.diff(own * len(wedges.length) + mutual.wedge) > 0).all()
    np.testing.assert_array_equal(mutual.wedge[mutual.reverse], own)
    np.testing.assert_array_equal(own[mutual.reverse], mutual.wedge)
    for row in rng.permutation(len(own))[:50]:
        e, f = own[row], mutual.wedge[row]
        ends = (
            wedges.start[f]
            + np.array([[0.0], [1.0]]) * wedges.length[f] * wedges.along[f]
            - wedges.start[e]
        )
        angle = np.arctan2(ends @ wedges.normal[e], ends @ wedges.face[e])
        np.testing.assert_allclose(
            np.cos(mutual.phi[row]), np.cos(sorted(angle % (2.0 * np.pi))), atol=1e-9
        )


def test_what_nearer_edges_are_before() -> None:
    """Against every edge and place in turn."""
    rng = np.random.default_rng(0)
    far = np.sort(rng.uniform(0.1, 2.0, 40).round(1))
    ends = np.sort(rng.uniform(-1.0, 3.0, (40, 2)), axis=1)
    length = rng.uniform(0.5, 2.0, 40)
    for m, part in enumerate(_covered(far, ends, length)):
        low, high = max(0.0, ends[m, 0]), min(length[m], ends[m, 1])
        places = low + (high - low) * (np.arange(_PLACES) + 0.5) / _PLACES
        nearer = ends[far < _NEARER * far[m]]
        hidden = [any(a <= x <= b for a, b in nearer) for x in places]
        assert part == (np.mean(hidden) if low < high else 1.0)
