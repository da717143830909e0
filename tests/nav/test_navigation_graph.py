"""States, moves, distances, fewest actions: against a search that knows nothing of headings' tricks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import networkx
import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.navigation_graph import FORWARD, LEFT, RIGHT, NavigationGraph, heading_index
from tests.nav.conftest import LADDER, T_CORRIDOR


def fake(points: list[tuple[float, float]], edges: list[tuple[int, int]]) -> Any:
    """As much of a dataset as a world needs."""
    config = SimpleNamespace(grid=SimpleNamespace(spacing=1.0, height=1.5))
    manifest = SimpleNamespace(config=config, nodes=tuple(range(len(points))), edges=tuple(edges))
    array = np.array([(x, y, 1.5) for x, y in points], float)
    return SimpleNamespace(scene="fake", path="fake", points=array, manifest=manifest)


def test_tee(data: NavData) -> None:
    graph = data.graph("tee")
    assert len(graph.nodes) == len(T_CORRIDOR) and graph.spacing == 1.0
    junction = T_CORRIDOR.index((3, 3))
    east, west, south = (T_CORRIDOR.index(c) for c in ((4, 3), (2, 3), (3, 2)))
    assert list(graph.neighbour[junction]) == [east, -1, west, south]  # headings 0 90 180 270
    assert graph.distance(T_CORRIDOR.index((0, 3)), T_CORRIDOR.index((3, 0))) == 6.0
    state = 4 * junction + 1  # facing the wall
    assert graph.moves[state, FORWARD] == state
    assert graph.moves[state, LEFT] == 4 * junction + 2 and graph.moves[state, RIGHT] == 4 * junction
    assert graph.moves[4 * junction, FORWARD] == 4 * east


@pytest.mark.parametrize("cells", [T_CORRIDOR, LADDER])
def test_fewest_actions_are_those_of_a_search(data: NavData, cells: list[tuple[int, int]]) -> None:
    """Dijkstra over states, cost 1 000 per step and 1 per action: fewest actions along a shortest path."""
    graph = data.graph("tee" if cells is T_CORRIDOR else "ladder")
    graph = networkx.DiGraph()
    for state, after in enumerate(graph.moves):
        for action, other in enumerate(after):
            if other != state:
                graph.add_edge(state, int(other), weight=1001 if action == FORWARD else 1)
    for goal in graph.nodes:
        ends = [4 * int(goal) + k for k in range(4)]
        lengths = networkx.multi_source_dijkstra_path_length(graph.reverse(), set(ends))
        expected = [
            1 + lengths[s] // 1000 * 1 + lengths[s] % 1000 - lengths[s] // 1000
            for s in range(4 * len(cells))
        ]
        np.testing.assert_array_equal(graph.actions_to(int(goal)), expected)


def test_edges_that_are_no_headings() -> None:
    NavigationGraph(fake([(0, 0), (1, 0.08)], [(0, 1)]))  # 4.6 degrees
    with pytest.raises(ss.DatasetError, match=r"5\.7 degrees off"):
        NavigationGraph(fake([(0, 0), (1, 0.1)], [(0, 1)]))
    with pytest.raises(ss.DatasetError, match="both lie in heading 0 of point 0"):
        NavigationGraph(fake([(0, 0), (1, 0.05), (1, -0.05)], [(0, 1), (0, 2)]))
    with pytest.raises(ss.DatasetError, match="can stand on none"):
        NavigationGraph(fake([], []))


def test_no_way() -> None:
    graph = NavigationGraph(fake([(0, 0), (1, 0), (5, 0)], [(0, 1)]))
    assert (
        graph.hops[0, 2] == -1 and graph.distance(0, 2) == float("inf") and graph.distance(0, 1) == 1.0
    )
    assert (graph.actions_to(2)[:8] == -1).all() and (graph.actions_to(2)[8:] == 1).all()


def test_headings() -> None:
    assert [heading_index(h) for h in (0, 90.0, 270.2, -90, 360)] == [0, 1, 3, 3, 0]
    for bad in (45.0, float("nan"), 91.0):
        with pytest.raises(ss.PointError, match="multiple of 90"):
            heading_index(bad)
