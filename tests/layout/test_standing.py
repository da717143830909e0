"""Grids of places to stand: what is kept is the graph's nodes, with their edges and distances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build.prepare import plan_job
from soundspaces_sim.core.config import GraphConfig
from soundspaces_sim.layout.navigation_graph import make_graph, only_standing
from soundspaces_sim.layout.records import KEPT, NO_STANDING
from tests.rooms import box, table

ROOM = box((6.0, 5.0, 2.7), table(0.1, 0.1))
SMALL = ss.SimulationConfig(walks=32, duration=0.2)


def test_points_above_tables_go(tmp_path: Path) -> None:
    scene = ss.load_scene("demo")
    config = ss.GridConfig(spacing=1.0, rays=100)
    grid = ss.make_grid(scene, config=config)
    graph = make_graph(scene, grid, GraphConfig())
    job, kept = plan_job(
        scene,
        tmp_path,
        ss.JobConfig(grid=ss.GridConfig(spacing=1.0, rays=100, standing=True), simulation=SMALL),
    )
    nodes = graph.nodes
    assert 0 < len(nodes) < len(grid.points)
    np.testing.assert_array_equal(kept.points, grid.points[nodes])
    assert (kept.status == NO_STANDING).sum() == len(grid.points) - len(nodes)
    np.testing.assert_array_equal(kept.candidates[kept.status == KEPT], kept.points)
    draft = job.plan.draft
    assert draft.nodes == tuple(range(len(nodes))) and len(draft.points) == len(nodes)
    ends = {frozenset(map(tuple, grid.points[list(e)])) for e in graph.edges}
    assert {frozenset(draft.points[k] for k in e) for e in draft.edges} == ends
    np.testing.assert_array_equal(job.geodesic, graph.geodesic[np.ix_(nodes, nodes)])
    assert "where nobody can stand" in repr(kept) and "nobody" not in repr(grid)


def test_a_scene_without_a_place_to_stand_is_refused() -> None:
    grid = ss.make_grid(ROOM, config=ss.GridConfig(spacing=1.0, rays=50))
    graph = make_graph(ROOM, grid, GraphConfig())
    empty = type(graph)(graph.nodes[:0], graph.edges[:0], graph.component, graph.geodesic)
    with pytest.raises(ss.SceneError, match=r"stand at none of the \d+ grid points"):
        only_standing(ROOM, grid, empty)
