"""Points above floors that slope and have steps, stages and balconies: floors are known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise, product
from math import radians, tan

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.build.inspect import inspect_scene, report_text
from soundspaces_sim.layout.floor_plan import make_floorplan
from soundspaces_sim.layout.navigation_graph import make_graph
from soundspaces_sim.scene.storeys import find_storeys
from tests.marks import few
from tests.rooms import box, table

_WIDE = 8.0
Profile = list[tuple[float, float]]
Block = tuple[tuple[float, float, float], tuple[float, float, float]]


def _hall(floor: Profile, ceiling: Profile, *blocks: Block, turn: float = 0.0) -> ss.Scene:
    """A room 8 m wide between two profiles of x and z, with solid blocks in it, turned about the vertical."""
    x = sorted({at for at, _ in (*floor, *ceiling)})
    low, high = _line(floor)(np.array(x)), _line(ceiling)(np.array(x))
    rings = [  # around the room at every x
        [(at, 0.0, z0), (at, _WIDE, z0), (at, _WIDE, z1), (at, 0.0, z1)]
        for at, z0, z1 in zip(x, low, high, strict=True)
    ]
    quads = [
        (4 * n + k, 4 * n + (k + 1) % 4, 4 * n + 4 + (k + 1) % 4, 4 * n + 4 + k)
        for n in range(len(x) - 1) for k in range(4)
    ]  # fmt: skip
    end = 4 * len(x) - 4
    quads += [(0, 3, 2, 1), (end, end + 1, end + 2, end + 3)]
    corners = np.array(quads)
    meshes = [(np.array(rings).reshape(-1, 3), np.concatenate([corners[:, :3], corners[:, [0, 2, 3]]]))]
    for bounds in blocks:
        solid = trimesh.creation.box(bounds=bounds)
        meshes.append((np.asarray(solid.vertices), np.asarray(solid.faces)))
    start = np.cumsum([0, *(len(v) for v, _ in meshes)])
    vertices = np.concatenate([v for v, _ in meshes])
    c, s = np.cos(radians(turn)), np.sin(radians(turn))
    vertices = vertices @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    faces = np.concatenate([f + n for (_, f), n in zip(meshes, start, strict=False)])
    return ss.Scene(vertices, faces, np.zeros(len(faces), int), table(0.2, 0.3), name="hall")


def _line(profile: Profile) -> Callable[[np.ndarray], np.ndarray]:
    x, z = np.array(profile).T
    return lambda at: np.interp(at, x, z)


def _rise(degrees: float, length: float) -> float:
    return length * tan(radians(degrees))


_RAKES: dict[str, tuple[Profile, Profile]] = {
    "flat in front": (
        [(0.0, 0.0), (3.0, 0.0), (12.0, _rise(15.0, 9.0))],
        [(0.0, 6.0), (12.0, 6.0)],
    ),
    "to the front wall": ([(0.0, 0.0), (12.0, _rise(15.0, 12.0))], [(0.0, 6.0), (12.0, 6.0)]),
    "under a sloped ceiling": (
        [(0.0, 0.0), (12.0, _rise(15.0, 12.0))],
        [(0.0, 4.0), (12.0, 4.0 + _rise(15.0, 12.0))],
    ),
    "steep": ([(0.0, 0.0), (2.0, 0.0), (12.0, _rise(25.0, 10.0))], [(0.0, 8.0), (12.0, 8.0)]),
    "down to a stage": (
        [(0.0, 0.0), (6.0, 0.0), (12.0, _rise(-10.0, 6.0))],
        [(0.0, 5.0), (12.0, 5.0)],
    ),
}


@pytest.mark.parametrize(
    ("rake", "turn"),
    few(
        product(_RAKES, (0.0, 30.0)),
        ("under a sloped ceiling", 0.0),
        ("steep", 30.0),
        ("down to a stage", 0.0),
    ),
)
def test_points_stand_at_their_height_above_a_rake(rake: str, turn: float) -> None:
    profile, ceiling = _RAKES[rake]
    scene = _hall(profile, ceiling, turn=turn)
    config = ss.GridConfig(spacing=0.5, rays=100)
    grid = ss.make_grid(scene, config=config)
    back = grid.points[:, :2] @ [np.cos(radians(turn)), np.sin(radians(turn))]
    above = grid.points[:, 2] - _line(profile)(back)
    assert (
        np.abs(above - 1.5).max() < 0.021
    )  # beside the level front, whose height points within 2 cm have
    assert len(grid.floors) == 1
    if turn == 0.0:
        assert len(grid) == 24 * 16  # all rows
        graph = make_graph(scene, grid)
        assert (graph.component == 0).sum() == 384 and len(graph.edges) == 2 * 384 - 24 - 16
        ends = grid.points[:, 0].argmin(), grid.points[:, 0].argmax()
        same_row = int(
            np.flatnonzero(
                (grid.points[:, 1] == grid.points[ends[0], 1])
                & (grid.points[:, 0] == grid.points[ends[1], 0])
            )[0]
        )
        x = np.linspace(0.25, 11.75, 2001)
        length = np.hypot(np.diff(x), np.diff(_line(profile)(x))).sum()
        assert graph.geodesic[ends[0], same_row] == pytest.approx(length, rel=0.005)
    flat = ss.make_grid(scene, config=ss.GridConfig(spacing=0.5, rays=100, follow_floor=False))
    assert len(np.unique(flat.points[:, 2])) == 1


@pytest.mark.parametrize("solid", [True, False])
@pytest.mark.parametrize(("rise", "depth"), few([(0.3, 0.9), (0.45, 0.9), (0.4, 1.2)], (0.45, 0.9)))
def test_points_stand_on_tiers_that_nobody_can_step_onto(rise: float, depth: float, solid: bool) -> None:
    """Seven tiers of seats, of solids or of sheets above the hall's floor: one point a tread, none above an edge."""
    start, count = 2.0, 7
    treads = [start + depth * k for k in range(count)]
    hall = _hall([(0.0, 0.0), (12.0, 0.0)], [(0.0, 7.0), (12.0, 7.0)])
    if solid:
        tiers: list[Block] = [
            ((at, 0.0, 0.0), (12.0, _WIDE, rise * (k + 1))) for k, at in enumerate(treads)
        ]
        scene = _hall([(0.0, 0.0), (12.0, 0.0)], [(0.0, 7.0), (12.0, 7.0)], *tiers)
    else:
        line = [(start, 0.0)]
        for k, at in enumerate(treads):
            line += [(at, rise * (k + 1)), (treads[k + 1] if k + 1 < count else 12.0, rise * (k + 1))]
        quads = [
            [(x0, 0.0, z0), (x1, 0.0, z1), (x1, _WIDE, z1), (x0, _WIDE, z0)]
            for (x0, z0), (x1, z1) in pairwise(line)
        ]
        corners = np.concatenate(
            [hall.corners, np.array(quads)[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)]
        )
        scene = ss.Scene(
            corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3),
            np.zeros(len(corners), int), table(0.2, 0.3), name="hall",
        )  # fmt: skip
    grid = ss.make_grid(scene, config=ss.GridConfig(spacing=0.5, rays=100))
    x = grid.points[:, 0]
    tier = np.clip(np.floor((x - start) / depth + 1e-9) + 1.0, 0.0, count)
    above = grid.points[:, 2] - rise * tier
    on_top = (grid.points[:, 2] > 1.51) | (tier == 0.0) | solid  # below sheets there is a room as well
    assert on_top.sum() == 24 * 16
    np.testing.assert_allclose(above[on_top], 1.5, atol=1e-5)
    below = grid.points[~on_top]
    clear = rise * tier[~on_top]
    assert np.all((clear == 0.0) | (clear > 1.5)), below[(clear > 0.0) & (clear <= 1.5)]


def test_rows_of_steps_are_all_reached() -> None:
    """Ten rows, 0.9 m deep and 0.18 m high: no point lies above an edge."""
    steps: list[Block] = [((3.0 + 0.9 * k, 0.0, 0.0), (12.0, _WIDE, 0.18 * (k + 1))) for k in range(10)]
    scene = _hall([(0.0, 0.0), (12.0, 0.0)], [(0.0, 6.0), (12.0, 6.0)], *steps)
    grid = ss.make_grid(scene, config=ss.GridConfig(spacing=0.5, rays=100))
    x = grid.points[:, 0]
    floor = np.where(x > 3.0, 0.18 * (np.floor((x - 3.0) / 0.9 + 1e-9) + 1.0), 0.0)
    np.testing.assert_allclose(grid.points[:, 2] - floor, 1.5, atol=1e-5)
    assert len(grid) == 24 * 16 and len(np.unique(grid.points[:, 2])) == 11
    assert (make_graph(scene, grid).component == 0).all()
    assert len(find_storeys(scene).floors) == 1


@pytest.mark.parametrize("steps", [False, True])
def test_points_on_a_stage_stand_on_it(steps: bool) -> None:
    """A stage 1 m high with and without steps, and a table as large that one cannot walk onto."""
    stage: Block = ((8.0, 0.0, 0.0), (12.0, _WIDE, 1.0))
    flight: list[Block] = [((7.7 - 0.3 * k, 3.0, 0.0), (8.0, 5.0, 0.8 - 0.2 * k)) for k in range(4)]
    top: Block = ((1.0, 1.0, 0.7), (5.0, 7.0, 0.75))
    scene = _hall(
        [(0.0, 0.0), (12.0, 0.0)], [(0.0, 6.0), (12.0, 6.0)], stage, top, *(flight if steps else [])
    )
    grid = ss.make_grid(scene, config=ss.GridConfig(spacing=0.5, rays=100))
    on = grid.points[:, 0] > 8.0
    np.testing.assert_allclose(grid.points[on, 2], 2.5, atol=1e-5)
    beside = grid.points[:, 0] < 6.8
    np.testing.assert_allclose(grid.points[beside, 2], 1.5, atol=1e-5)  # above the table too
    assert len(grid) == 24 * 16
    graph = make_graph(scene, grid)
    assert np.isfinite(graph.geodesic[np.flatnonzero(on)[0], np.flatnonzero(beside)[0]]) == steps


@pytest.mark.parametrize("rake", few([0.0, 10.0], 10.0))
def test_a_balcony_reached_by_stairs_has_its_points_and_no_others(rake: float) -> None:
    """A balcony over the last 4 of 12 m, 3 m up, level or raked, at the end of stairs along a side wall."""
    rise = 3.0 / 17
    flight: list[Block] = [
        ((8.0 - 0.3 * (k + 1), 0.0, 0.0), (8.0 - 0.3 * k, 1.5, 3.0 - rise * (k + 1))) for k in range(16)
    ]
    hall = _hall([(0.0, 0.0), (12.0, 0.0)], [(0.0, 7.0), (12.0, 7.0)], *flight)
    up = _rise(rake, 4.0)
    slab = np.array(
        [[x, y, z] for x, z in ((8, 2.8), (12, 2.8 + up), (12, 3 + up), (8, 3)) for y in (0, _WIDE)]
    )
    solid = trimesh.convex.convex_hull(slab)
    faces = np.concatenate([hall.faces, solid.faces + len(hall.vertices)])
    scene = ss.Scene(
        np.concatenate([hall.vertices, solid.vertices]),
        faces,
        np.zeros(len(faces), int),
        table(0.2, 0.3),
    )
    grid = ss.make_grid(scene, config=ss.GridConfig(spacing=0.5, rays=100))
    x, z = grid.points[:, 0], grid.points[:, 2]
    balcony = z > 4.4
    np.testing.assert_allclose(
        z[balcony], 4.5 + np.maximum(x[balcony] - 8.0, 0.0) * tan(radians(rake)), atol=0.021
    )
    assert balcony.sum() == 8 * 16 and (x[balcony] > 8.0).all()
    level = ~balcony & ((x > 8.0) | (grid.points[:, 1] > 1.5))
    np.testing.assert_allclose(z[level], 1.5, atol=1e-5)
    stairs = ~balcony & ~level & (x > 8.0 - 0.3 * 16)
    tread = np.floor((8.0 - x[stairs]) / 0.3 + 1e-9)
    np.testing.assert_allclose(z[stairs], 4.5 - rise * (tread + 1), atol=1e-5)
    graph = make_graph(scene, grid)
    assert (graph.component == 0).sum() == len(graph.nodes) > 0.9 * len(grid)
    plan = make_floorplan(scene, grid)
    assert len(plan.walls) == len(grid.floors)


@pytest.mark.usefixtures("no_t30")
def test_inspect_says_how_far_heights_spread() -> None:
    profile, ceiling = _RAKES["flat in front"]
    report = inspect_scene(_hall(profile, ceiling), ss.GridConfig(spacing=1.0, rays=100))
    np.testing.assert_allclose(report.floor_low, [0.0], atol=1e-6)
    np.testing.assert_allclose(report.floor_high, [_rise(15.0, 8.5)], atol=1e-3)
    assert "floor at 0.00 to 2.28 m" in report_text(report)


def test_a_flat_room_is_as_the_paper_slices_it() -> None:
    room = box((6.0, 5.0, 2.7), table(0.1, 0.1))
    followed, flat = (
        ss.make_grid(room, config=ss.GridConfig(spacing=0.5, rays=100, follow_floor=follow))
        for follow in (True, False)
    )
    np.testing.assert_array_equal(followed.points, flat.points)
    np.testing.assert_array_equal(followed.candidates, flat.candidates)
