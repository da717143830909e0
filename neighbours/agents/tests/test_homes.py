"""Which homes a study takes, and the points of its datasets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from soundspaces_agents import homes
from soundspaces_agents.homes import LEAST_FLOOR, choose_homes, largest_piece, read_choice
from soundspaces_agents.pipeline import build_home

import soundspaces_sim as ss
from soundspaces_sim.nav.navigation_graph import NavigationGraph

GRID = ss.GridConfig(spacing=0.75, standing=True, rays=100)


def test_homes_are_taken_in_turn_by_the_size_of_their_piece(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of pieces of 44, 45, 10, 90 and 45 points, 24.75 m² are too little; the second and the fourth are the first
    two that are taken, and what was looked at is not looked at again."""
    sizes = {"home-0": 44, "home-1": 45, "home-2": 10, "home-3": 90, "home-4": 45}
    asked: list[str] = []

    def piece(name: str, _grid: ss.GridConfig) -> np.ndarray:
        asked.append(name)
        return np.zeros((sizes[name], 3))

    monkeypatch.setattr(homes, "load_scene", lambda name: name)
    monkeypatch.setattr(homes, "largest_piece", piece)
    path = tmp_path / "homes.json"
    assert LEAST_FLOOR == 25.0
    assert choose_homes(2, GRID, path) == ("home-1", "home-3")
    assert choose_homes(3, GRID, path) == ("home-1", "home-3", "home-4")
    assert choose_homes(1, GRID, path) == ("home-1",) and asked == list(sizes)
    assert [(one.home, one.points) for one in read_choice(path).seen] == list(sizes.items())
    with pytest.raises(ss.ConfigError, match=r"chosen on a grid of 0\.75 m by 25 m², now 0\.5 m"):
        choose_homes(1, ss.GridConfig(spacing=0.5), path)
    path.write_text("[]")
    with pytest.raises(ss.ConfigError, match="not a record of homes"):
        read_choice(path)


def test_a_home_is_one_piece(tmp_path: Path) -> None:
    """From every point of its dataset one can walk to every other, by steps of the grid's spacing; which points they
    are, is told without the walking graph's pieces: none is left out that a step leads to."""
    scene = ss.load_scene("home-1")
    points = largest_piece(scene, GRID)
    config = ss.JobConfig(grid=GRID, simulation=ss.SimulationConfig(walks=16, duration=0.2))
    ds = ss.open_dataset(build_home("home-1", tmp_path, config, 1))
    graph = NavigationGraph(ds)
    np.testing.assert_array_equal(ds.points, points)
    assert len(graph.nodes) == len(points) and (graph.hops >= 0).all()
    start, heading = np.nonzero(graph.neighbour >= 0)
    steps = points[graph.neighbour[start, heading], :2] - points[start, :2]
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 0.75, rtol=1e-6)
    placed = ss.make_grid(scene, config=GRID)
    walks = ss.make_graph(scene, placed)
    inside = {tuple(p) for p in points.tolist()}
    ends = [[tuple(placed.points[k].tolist()) in inside for k in edge] for edge in walks.edges]
    assert all(a == b for a, b in ends) and sum(a for a, _ in ends) >= len(points) - 1
    assert "soundspaces-agents homes home-1" in ds.manifest.command
