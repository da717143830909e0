"""Points inside solids: scenes where it is known which points those are; and grids that have bounds."""

from __future__ import annotations

import logging
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.layout.reachability import reachable, winding_numbers
from soundspaces_sim.layout.records import KEPT, UNREACHABLE
from soundspaces_sim.scene.walkable import find_floors
from tests.marks import ci_slow, few
from tests.rooms import box, plane, table, two_rooms

_TABLE = table(0.2, 0.5)
Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def _furnish(room: ss.Scene, *boxes: Box, open_below: bool = False) -> ss.Scene:
    meshes = [trimesh.creation.box(bounds=b) for b in boxes]
    if open_below:
        for mesh in meshes:
            mesh.update_faces(mesh.face_normals[:, 2] > -0.5)
    whole: Any = trimesh.util.concatenate(
        [trimesh.Trimesh(room.vertices, room.faces, process=False), *meshes]
    )
    return ss.Scene(whole.vertices, whole.faces, np.zeros(len(whole.faces), int), _TABLE, name="room")


def _inside(grid: ss.Grid, low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
    return np.asarray(((grid.candidates > low) & (grid.candidates < high)).all(axis=1))


ROOM = box((6.0, 4.0, 2.6), _TABLE)
_SOLIDS: dict[str, Box] = {
    "partition": ((2.69, 0.0, 0.0), (2.81, 4.0, 2.6)),
    "wardrobe": ((2.5, 0.0, 0.0), (3.1, 2.0, 2.1)),
    "pillar": ((2.4, 1.4, 0.0), (3.6, 2.6, 2.6)),
    "lift shaft": ((1.6, 0.9, 0.0), (4.4, 3.1, 2.6)),
}


@pytest.mark.parametrize(
    ("solid", "inward"),
    few(product(_SOLIDS, (False, True)), ("wardrobe", False), ("pillar", True), ("lift shaft", False)),
)
def test_points_in_a_solid_are_pruned_and_no_others(solid: str, inward: bool) -> None:
    low, high = _SOLIDS[solid]
    room = ss.Scene(ROOM.vertices, ROOM.faces[:, ::-1], np.zeros(12, int), _TABLE) if inward else ROOM
    scene = _furnish(room, (low, high))
    grid = ss.make_grid(scene, 0.5)
    inside = _inside(grid, low, high)
    assert inside.sum() >= 4
    np.testing.assert_array_equal(grid.status == UNREACHABLE, inside)
    assert (grid.status == KEPT).sum() == len(grid) == 96 - inside.sum()
    papers = ss.make_grid(scene, 0.5, ss.GridConfig(reachable=False))
    assert len(papers) == 96


def test_what_is_no_solid_keeps_its_points() -> None:
    """Two rooms without a door, one of them empty; a wardrobe with an open front; shells side by side; a
    table."""
    assert len(ss.make_grid(two_rooms(_TABLE, door=False), 0.5)) == 16 * 8
    boards: list[Box] = [
        ((2.4, 1.0, 0.0), (2.42, 2.6, 2.1)), ((3.58, 1.0, 0.0), (3.6, 2.6, 2.1)), ((2.42, 1.0, 2.08), (3.58, 2.6, 2.1)),
        ((2.42, 1.0, 0.0), (3.58, 1.02, 2.08)),
    ]  # fmt: skip
    assert not (ss.make_grid(_furnish(ROOM, *boards), 0.5).status == UNREACHABLE).any()
    beside = trimesh.creation.box(bounds=[[6.5, 0.0, 0.0], [10.5, 4.0, 2.6]])
    chair: Box = ((1.0, 1.0, 0.0), (1.4, 1.4, 0.5))
    scene = _furnish(ROOM, chair, ((6.5, 0.0, 0.0), (10.5, 4.0, 2.6)))
    assert beside.is_volume
    grid = ss.make_grid(scene, 0.5)
    assert not (grid.status == UNREACHABLE).any() and (grid.points[:, 0] > 6.5).sum() == 64


def test_leaky_furniture_is_kept_and_small_closed_space_is_not() -> None:
    """A bin of sheets without a bottom that stands 10 cm above the floor lets sound through; on the floor, with
    no room to stand in it, it does not."""
    for lift, pruned in ((0.1, False), (0.0, True)):
        low, high = (2.5, 1.0, lift), (3.0, 2.6, 2.1)
        grid = ss.make_grid(_furnish(ROOM, (low, high), open_below=True), 0.5)
        inside = _inside(grid, low, high)
        assert inside.sum() == 3
        np.testing.assert_array_equal(grid.status[inside] == UNREACHABLE, pruned)


def test_open_scenes_and_scenes_without_a_floor_keep_their_points() -> None:
    yard = _furnish(plane(6.0, _TABLE), ((-1.0, -1.0, 0.0), (-0.9, 4.0, 2.5)))
    config = ss.GridConfig(spacing=1.0, min_closedness=0.04)
    grid = ss.make_grid(yard, config=config)
    assert not (grid.status == UNREACHABLE).any() and len(grid) > 50
    wall = ss.Scene(
        np.array([[0, 0, 0], [5, 0, 0], [5, 0, 2.5]], float),
        np.array([[0, 1, 2]]),
        np.zeros(1, int),
        _TABLE,
    )
    assert reachable(wall, np.array([[2.0, 1.0, 1.0]]), 1.5).all()


def test_winding_numbers() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    points = np.array([[0.0, 0.0, 0.0], [0.5, 0.2, -0.3], [3.0, 0.0, 0.0], [0.0, 0.0, 1.5]])
    np.testing.assert_allclose(
        winding_numbers(points, np.asarray(ball.triangles)), [1, 1, 0, 0], atol=1e-12
    )
    cube = trimesh.creation.box(extents=[1.0, 1.0, 1.0])
    top = np.asarray(cube.triangles)[cube.face_normals[:, 2] > 0.5]
    np.testing.assert_allclose(winding_numbers(points[:1], top), [1.0 / 6.0], atol=1e-12)


def test_the_papers_preset_keeps_the_papers_rule() -> None:
    assert ss.load_config(resource("pipelines", "paper.toml")).grid.reachable is False
    assert ss.load_config(resource("pipelines", "default.toml")).grid.reachable is True


@ci_slow
def test_no_point_of_the_demo_stands_in_a_solid() -> None:
    """Every box of the demo is one; at half a metre the paper's rule keeps points in partitions and furniture."""
    from soundspaces_sim.scene.generate.demo import demo_mesh

    mesh = demo_mesh()
    corners = mesh.vertices.reshape(-1, 8, 3)
    low, high = corners[:, 0], corners[:, -1]
    scene = ss.load_scene("demo")

    def in_boxes(points: np.ndarray) -> np.ndarray:
        inside = np.all((points[:, None] > low) & (points[:, None] < high), axis=2)
        return np.asarray(np.any(inside, axis=1))

    grid = ss.make_grid(scene, 0.5)
    papers = ss.make_grid(scene, 0.5, ss.GridConfig(reachable=False))
    assert in_boxes(papers.points).sum() >= 10 and not in_boxes(grid.points).any()
    assert in_boxes(grid.candidates[grid.status == UNREACHABLE]).all()


@pytest.mark.parametrize("spacing", [0.001, 0.005])
def test_too_fine_a_grid_is_refused_before_it_is_made(spacing: float) -> None:
    with pytest.raises(
        ss.ConfigError, match=r"grid\.spacing: .*grid points, where 250,000 are the most"
    ):
        ss.make_grid(ROOM, spacing)


def test_grids_of_cells_are_bounded() -> None:
    """A floor of 20 x 20 km, and ten thousand faces that each cover a hall."""
    wide = plane(10_000.0, _TABLE)
    with pytest.raises(ss.SceneError, match=r"20000 x 20000 m.*4e\+07"):
        find_floors(wide.corners, 0.1, 1.5, 0.1, 0.2)
    many = np.tile(plane(50.0, _TABLE).corners, (5000, 1, 1))
    with pytest.raises(ss.SceneError, match=r"5e\+08 are the most"):
        find_floors(many, 0.03, 1.5, 0.1, 0.2)


def test_a_huge_mesh_is_loaded_without_a_lid(tmp_path: Path) -> None:
    ground = trimesh.creation.box(bounds=[[0, 0, -1], [20_000, 20_000, 0]]).subdivide().subdivide()
    ground.export(tmp_path / "land.ply")
    scene = ss.load_scene(tmp_path / "land.ply", up="z", unit="m")
    assert any("missing ceilings were not looked for" in note for note in scene.notes)
    with pytest.raises(ss.SceneError, match="no ceiling can be added"):
        ss.load_scene(tmp_path / "land.ply", up="z", unit="m", ceiling=True)


@pytest.mark.usefixtures("no_t30")
@ci_slow
def test_few_points_are_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    """A small room in one corner of a large ground: most points lie outside."""
    v, f = ROOM.vertices, ROOM.faces
    far = np.array([[0, 0, 0], [30.0, 0, 0], [30.0, 30.0, 0]])
    scene = ss.Scene(
        np.concatenate([v, far]),
        np.concatenate([f, [[8, 9, 10]]]),
        np.zeros(13, int),
        _TABLE,
        name="scan",
    )
    with caplog.at_level(logging.WARNING):
        grid = ss.make_grid(scene, 1.0)
    assert (
        len(grid) == 24
        and "scan: only 24 of 900 grid points" in caplog.text
        and "lie outside" in caplog.text
    )
    report = ss.inspect_scene(scene, ss.GridConfig(spacing=1.0))
    assert any("only 24 of 900" in w for w in report.warnings)
    caplog.clear()
    ss.make_grid(ROOM, 1.0)
    assert not caplog.text
