"""Which edges of a mesh bend sound."""

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.transport.diffraction.wedges import Edges, find_edges, find_links
from tests.rooms import box, plain, sphere, table, two_rooms


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


def _inside(edges: Edges, scene: ss.Scene) -> Edges:
    """Without the edges of the room's own hull, which look outward."""
    low, high = scene.bounds[0] - scene.center, scene.bounds[1] - scene.center
    middle = edges.start + 0.5 * edges.length[:, None] * edges.along
    hull = (np.minimum(middle - low, high - middle) < 1e-6).sum(axis=1) >= 2
    return Edges(*(column[~hull] for column in edges))


def test_a_block_has_twelve_edges() -> None:
    """1 x 0.6 x 0.8 m in mid-air: twelve corners of 90 degrees."""
    scene = _in_box(*_cuboid([2.0, 2.0, 1.0], [3.0, 2.6, 1.8]))
    edges = _inside(find_edges(scene), scene)
    assert sorted(np.round(edges.length, 9)) == [0.6] * 4 + [0.8] * 4 + [1.0] * 4
    np.testing.assert_allclose(edges.wedge, 1.5, atol=1e-9)
    np.testing.assert_allclose((edges.face * edges.turn).sum(axis=1), 0.0, atol=1e-12)
    outside = edges.start + scene.center + 0.3 * edges.lift / np.linalg.norm(edges.lift, axis=1)[:, None]
    assert ((outside < [2.0, 2.0, 1.0]) | (outside > [3.0, 2.6, 1.8])).any(axis=1).all()


def test_a_block_on_the_floor_has_eight() -> None:
    """Where it stands on the floor, and where its back is at a wall, nothing bends."""
    scene = _in_box(*_cuboid([2.0, 2.0, 0.0], [3.0, 2.6, 0.8]))
    assert len(_inside(find_edges(scene), scene).length) == 8
    scene = _in_box(*_cuboid([0.0, 2.0, 0.0], [1.0, 2.6, 0.8]))
    assert (
        len(_inside(find_edges(scene), scene).length) == 5
    )  # the front's four but the foot, two along the top


@pytest.mark.parametrize("cuts", [2, 3, 7])
def test_tessellation_changes_nothing(cuts: int) -> None:
    """A block cut into small triangles has the same edges, and gives the same arrivals, to the bit."""
    low, high = [2.0, 2.0, 0.8], [3.1, 2.7, 1.9]
    plain_, fine = _in_box(*_cuboid(low, high)), _in_box(*_cuboid(low, high, cuts))
    for a, b in zip(find_edges(plain_), find_edges(fine), strict=True):
        np.testing.assert_array_equal(a, b)
    config = plain(
        walks=16, joined_walks=0, specular_ratio=1, duration=0.05, merging=False, diffraction=True
    )
    points = np.array([[1.5, 2.3, 1.2], [2.9, 3.0, 1.3], [2.2, 1.5, 1.2], [3.6, 2.6, 1.6]])
    echoes = [ss.simulate(scene, points, points, config) for scene in (plain_, fine)]
    bent = 0
    for s in range(4):
        for l in range(4):
            one, other = ([x for x in e[s, l].arrivals if not x.planes] for e in echoes)
            bent += sum(bool(x.edges) for x in one)
            for x, y in zip(one, other, strict=True):
                assert x.delay == y.delay and x.edges == y.edges
                np.testing.assert_array_equal(x.energy, y.energy)
    assert bent >= 4


def test_walls_cut_differently_at_a_corner_share_it() -> None:
    """One side of a corner in one piece, the other in three, none of which end where the first does."""
    v, f = _cuboid([2.0, 2.0, 1.0], [3.0, 3.0, 2.0])
    fine, g = _cuboid([2.0, 2.0, 1.0], [3.0, 3.0, 2.0], 3)
    top, others = v[f][:, :, 2].min(axis=1) > 1.999, fine[g][:, :, 2].min(axis=1) <= 1.999
    corners = np.concatenate([v[f][top], fine[g][others]])
    scene = _in_box(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    edges = _inside(find_edges(scene), scene)
    assert len(edges.length) == 12
    np.testing.assert_allclose(edges.wedge, 1.5, atol=1e-9)


def test_a_door_has_a_frame_of_three_borders() -> None:
    scene = two_rooms(table(0.3, 0.4))
    edges = _inside(find_edges(scene), scene)
    assert sorted(np.round(edges.length, 6)) == [0.9, 2.0, 2.0]
    np.testing.assert_array_equal(edges.wedge, 2.0)


def test_round_and_small_things_have_none() -> None:
    """A fine sphere turns by less than 20 degrees at a time; a stick of 0.2 m is tiny."""
    assert len(find_edges(sphere(2.0, table(0.3, 0.4), 4)).length) == 0
    scene = _in_box(*_cuboid([2.0, 2.0, 1.0], [2.2, 2.2, 1.2]))
    assert len(_inside(find_edges(scene), scene).length) == 0


def test_points_far_from_the_origin_change_nothing() -> None:
    scene = _in_box(*_cuboid([2.0, 2.0, 1.0], [3.0, 2.6, 1.8]))
    moved = ss.Scene(scene.vertices + 512.0, scene.faces, scene.face_material, scene.materials)
    for a, b in zip(find_edges(scene), find_edges(moved), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize(("thickness", "wedges"), [(0.001, {2.0}), (0.02, {1.5})])
def test_a_plate_has_one_border_until_it_is_thick(thickness: float, wedges: set[float]) -> None:
    scene = _in_box(*_cuboid([2.0, 2.0, 1.0], [3.0, 2.0 + thickness, 2.0]))
    edges = _inside(find_edges(scene), scene)
    assert set(np.round(edges.wedge, 6)) == wedges
    assert len(edges.length) == (4 if thickness < 0.002 else 8)


def test_links_are_the_same_from_both_edges() -> None:
    """Every pair of edges that see each other has two rows, each the other's twin, with the angles from its own."""
    rng = np.random.default_rng(7)
    blocks = [
        _cuboid(list(low), list(low + rng.uniform(0.4, 1.0, 3))) for low in rng.uniform(0.2, 1.5, (4, 3))
    ]
    v = np.concatenate([v for v, _ in blocks])
    f = np.arange(len(v)).reshape(-1, 3)
    scene = _in_box(v, f)
    edges = find_edges(scene)
    links = find_links(scene, edges)
    own = np.repeat(np.arange(len(edges.length)), np.diff(links.start))
    assert len(own) > 100 and (np.diff(own * len(edges.length) + links.edge) > 0).all()
    np.testing.assert_array_equal(links.edge[links.twin], own)
    np.testing.assert_array_equal(own[links.twin], links.edge)
    for row in rng.permutation(len(own))[:50]:
        e, f = own[row], links.edge[row]
        ends = (
            edges.start[f] + np.array([[0.0], [1.0]]) * edges.length[f] * edges.along[f] - edges.start[e]
        )
        angle = np.arctan2(ends @ edges.turn[e], ends @ edges.face[e])
        np.testing.assert_allclose(
            np.cos(links.there[row]), np.cos(sorted(angle % (2.0 * np.pi))), atol=1e-9
        )
