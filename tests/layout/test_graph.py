"""Where an agent can stand and walk: scenes with known answers."""

from __future__ import annotations

import networkx
import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.layout.grid import make_grid
from soundspaces_sim.layout.navigation_graph import make_graph
from soundspaces_sim.layout.records import Grid, WalkGraph, to_networkx
from tests.marks import few
from tests.rooms import box, table, two_rooms

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def _furnish(room: ss.Scene, *boxes: Box) -> ss.Scene:
    """A room with boxes, given by their lowest and highest corners."""
    vertices, faces = [room.vertices], [room.faces]
    n = len(room.vertices)
    for low, high in boxes:
        mesh = trimesh.creation.box(bounds=[low, high])
        vertices.append(np.asarray(mesh.vertices))
        faces.append(np.asarray(mesh.faces) + n)
        n += len(mesh.vertices)
    all_faces = np.concatenate(faces)
    return ss.Scene(
        np.concatenate(vertices), all_faces, np.zeros(len(all_faces), int), room.materials, name="room"
    )


ROOM = box((6.0, 4.0, 2.6), table(0.2, 0.5))


def _graph(scene: ss.Scene, spacing: float = 0.5) -> tuple[Grid, WalkGraph]:
    grid = make_grid(scene, spacing)
    return grid, make_graph(scene, grid)


def _crosses(grid: Grid, graph: WalkGraph, axis: int, at: float) -> np.ndarray:
    """Edges from one side of the plane x[axis] = at to the other."""
    side = grid.points[graph.edges][:, :, axis] > at
    return np.asarray(graph.edges[side[:, 0] != side[:, 1]])


def test_an_empty_room_is_a_lattice() -> None:
    """12 x 8 points: every point a node, 2 n m - n - m edges, distances Euclidean within 1.3 %."""
    grid, graph = _graph(ROOM)
    assert len(grid) == 96 and len(graph.nodes) == 96 and len(graph.edges) == 2 * 96 - 12 - 8
    assert np.all(graph.component == 0)
    straight = np.linalg.norm(grid.points[:, None] - grid.points[None], axis=2)
    far = straight > 0
    ratio = graph.geodesic[far] / straight[far]
    assert ratio.min() > 1.0 - 1e-6 and ratio.max() < 1.014
    np.testing.assert_array_equal(graph.geodesic, graph.geodesic.T)


def test_a_sofa_blocks_and_a_rug_does_not() -> None:
    sofa = _furnish(ROOM, ((2.5, 0.0, 0.0), (3.5, 2.5, 0.45)))
    grid, graph = _graph(sofa)
    assert len(_crosses(grid, graph, 0, 3.0)) == 3  # y = 2.75, 3.25, 3.75
    inside = (grid.points[:, 0] > 2.5) & (grid.points[:, 0] < 3.5) & (grid.points[:, 1] < 2.5)
    assert np.all(graph.component[inside] == -1)
    a, b = (
        int(np.flatnonzero(np.all(np.isclose(grid.points[:, :2], p), axis=1))[0])
        for p in ((1.75, 0.25), (4.25, 0.25))
    )
    taut = 2.0 * np.hypot(0.75 - 0.1, 2.35) + 1.2  # around two corners, 0.1 m away from them
    over_points = 2.0 * np.hypot(0.5, 2.5) + 1.5  # by way of (2.25, 2.75) and (3.75, 2.75)
    assert taut < graph.geodesic[a, b] < 1.014 * over_points
    rug = _furnish(ROOM, ((2.5, 0.0, 0.0), (3.5, 2.5, 0.015)))
    assert len(_graph(rug)[1].edges) == 2 * 96 - 12 - 8


def test_a_table_blocks_though_it_is_hollow() -> None:
    top = ((2.5, 0.0, 0.70), (3.5, 4.0, 0.75))
    legs = [((x, y, 0.0), (x + 0.05, y + 0.05, 0.7)) for x in (2.5, 3.45) for y in (0.0, 3.95)]
    grid, graph = _graph(_furnish(ROOM, top, *legs))
    assert len(_crosses(grid, graph, 0, 3.0)) == 0 and graph.component.max() == 1
    a, b = grid.points[:, 0].argmin(), grid.points[:, 0].argmax()
    assert np.isinf(graph.geodesic[a, b])


@pytest.mark.parametrize("x", few([2.95, 3.0, 3.05, 3.1, 2.9999999, 3.0000001], 3.0, 3.05, 2.9999999))
def test_a_thin_wall_blocks_wherever_it_stands(x: float) -> None:
    """Also on the boundary between two columns, where rounding must not lose it."""
    wall = _furnish(ROOM, ((x, 0.0, 0.0), (x, 4.0, 2.6)))
    grid, graph = _graph(wall)
    assert len(_crosses(grid, graph, 0, 3.02)) == 0 and graph.component.max() == 1


def test_a_railing_blocks() -> None:
    """Two thin bars and posts, with room above and below: thinner than any column."""
    bars = [((2.98, 0.0, z), (3.0, 4.0, z + 0.03)) for z in (0.5, 0.95)]
    posts = [((2.98, y, 0.0), (3.0, y + 0.02, 0.98)) for y in (0.0, 2.0, 3.98)]
    grid, graph = _graph(_furnish(ROOM, *bars, *posts))
    assert len(_crosses(grid, graph, 0, 3.0)) == 0 and graph.component.max() == 1


def test_a_door_connects_and_a_closed_wall_does_not() -> None:
    """The door spans y = 1.5 to 2.4: a 0.5 m grid walks through at 1.75 and, 0.15 m from the jamb, at 2.25."""
    grid, graph = _graph(two_rooms(table(0.2, 0.5)))
    through = grid.points[_crosses(grid, graph, 0, 4.0)]
    np.testing.assert_allclose(np.unique(through[:, :, 1]), [1.75, 2.25])
    assert graph.component.max() == 0
    closed = _graph(two_rooms(table(0.2, 0.5), door=False))[1]
    assert closed.component.max() == 1 and np.isinf(closed.geodesic).any()


def test_a_door_between_grid_lines_still_shortens_the_way() -> None:
    """No edge goes through, the components are two, but one can walk, and the distance says so.

    At 1 m the rows y = 1.5 and 2.5 pass the door (1.5 to 2.4) by its jambs.
    """
    scene = two_rooms(table(0.2, 0.5))
    grid, graph = _graph(scene, 4.0)
    assert len(grid) == 2 and len(graph.edges) == 1  # at y = 2: through the door
    grid, graph = _graph(scene, 1.0)
    assert len(_crosses(grid, graph, 0, 4.0)) == 0
    np.testing.assert_array_equal(graph.component, (grid.points[:, 0] > 4.0).astype(int))
    a, b = (
        int(np.flatnonzero(np.all(np.isclose(grid.points[:, :2], p), axis=1))[0])
        for p in ((3.5, 1.5), (4.5, 1.5))
    )
    # 0.1 m from the jamb and up to two cells of 0.03 m; 8 directions over cells make up to 1.0824 of it
    shortest, longest = 2.0 * np.hypot(0.5, 0.1), 1.0824 * 2.0 * np.hypot(0.5, 0.16)
    assert shortest <= graph.geodesic[a, b] <= longest


def _two_storeys(stair: bool) -> ss.Scene:
    """6 x 4 m, floors at 0 and 2.8 m, an opening of 1.2 m along one wall; 16 steps of 17.5 cm."""
    shell = box((6.0, 4.0, 5.6), table(0.2, 0.5))
    slab = ((0.0, 1.2, 2.6), (6.0, 4.0, 2.8)), ((0.0, 0.0, 2.6), (1.0, 1.2, 2.8))
    steps = [
        ((1.0 + 0.28 * (15 - i), 0.0, 0.0), (1.0 + 0.28 * (16 - i), 1.1, 0.175 * (i + 1)))
        for i in range(16)
    ]
    return _furnish(shell, *slab, *(steps if stair else []))


def test_a_stair_connects_two_storeys() -> None:
    grid, graph = _graph(_two_storeys(stair=True))
    np.testing.assert_allclose(grid.floors, [0.0, 2.8], atol=0.01)
    x, y, z = grid.points.T
    on = (y < 1.1) & (x > 1.0) & (x < 1.0 + 16 * 0.28)
    assert set(np.round(z[~on], 2)) == {1.5, 4.3}
    np.testing.assert_allclose(z[on], 1.5 + 0.175 * (16 - np.floor((x[on] - 1.0) / 0.28)), atol=1e-5)
    low = int(np.argmin(np.linalg.norm(grid.points - [5.75, 0.75, 1.5], axis=1)))
    high = int(np.argmin(np.linalg.norm(grid.points - [0.75, 0.75, 4.3], axis=1)))
    # 0.27 m to the lowest step, 0.25 m from the highest; a stair is no shorter than its slope, no longer
    # than treads and risers.
    assert 0.52 + np.hypot(16 * 0.28, 2.8) < graph.geodesic[low, high] < 0.52 + 16 * 0.28 + 2.8
    apart = _graph(_two_storeys(stair=False))
    assert np.isinf(apart[1].geodesic[low, high]) and set(apart[0].storey) == {0, 1}


def test_points_near_a_wall_are_no_places_to_stand() -> None:
    grid, graph = _graph(box((4.16, 4.16, 2.6), table(0.2, 0.5)), 0.5)
    assert len(grid) == 64 and len(graph.nodes) == 64  # 0.33 m away
    grid = make_grid(box((4.0, 4.0, 2.6), table(0.2, 0.5)), 1.0)
    moved = Grid(grid.points - [0.42, 0.0, 0.0], 1.0, 1.5, grid.floors, grid.storey, grid.candidates,
                 grid.status, grid.closedness, grid.clearance)  # fmt: skip
    graph = make_graph(box((4.0, 4.0, 2.6), table(0.2, 0.5)), moved)
    assert np.all(graph.component[moved.points[:, 0] < 0.1] == -1)


def test_networkx_export() -> None:
    grid, graph = _graph(ROOM, 1.0)
    exported = to_networkx(graph, grid.points)
    assert exported.number_of_nodes() == 24 and exported.number_of_edges() == len(graph.edges)
    assert exported.nodes[0]["point"] == tuple(grid.points[0])
    a, b = grid.points[:, :2].sum(axis=1).argmin(), grid.points[:, :2].sum(axis=1).argmax()
    assert networkx.shortest_path_length(exported, a, b, weight="length") == pytest.approx(8.0)


@pytest.mark.parametrize("spacing", few([1.0, 0.5], 1.0))
def test_demo_is_one_apartment(spacing: float) -> None:
    """From every place to stand one walks to every other, along edges: doors lie on the grids' lines."""
    scene = ss.load_scene("demo")
    grid, graph = _graph(scene, spacing)
    assert graph.component.max() == 0 and len(graph.nodes) > 50
    assert np.isfinite(graph.geodesic[np.ix_(graph.nodes, graph.nodes)]).all()
    assert len(graph.nodes) < len(grid)  # tables and sofas are no floor
