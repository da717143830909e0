"""Discs among obstacles: contacts against geometry by hand and a twin of brute force; walking distances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from soundspaces_continuous.obstacles import make_obstacles, move_disc
from soundspaces_continuous.world import Floor

from neighbours.continuous.tests.twin import contact, walk
from soundspaces_sim.core.config import GraphConfig
from soundspaces_sim.core.errors import PointError
from soundspaces_sim.scene.generate.demo import Box, boxes_mesh
from soundspaces_sim.scene.scene import Scene
from tests.marks import CI_SLOW
from tests.nav.conftest import LADDER, lattice_scene
from tests.rooms import table

SKIN = 2e-6


@pytest.fixture(scope="module")
def ladder() -> Floor:
    return Floor(lattice_scene(LADDER, "ladder"), 0.0, GraphConfig())


def test_a_wall_stops_at_one_radius(ladder: Floor) -> None:
    x, y, collided = ladder.move(0.5, 0.5, 0.0, -1.0, True)
    assert collided and x == 0.5 and y == pytest.approx(0.1, abs=SKIN)
    x, y, collided = ladder.move(0.5, 0.5, 0.25, 0.0, True)
    assert not collided and (x, y) == (0.75, 0.5)


@pytest.mark.parametrize("angle", [10.0, 45.0, 80.0])
def test_sliding_keeps_what_is_along_the_wall(ladder: Floor, angle: float) -> None:
    """From .3 m above the wall at y = 0, 1 m downwards at an angle to it: .2 m down, all of cos(angle) along."""
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    x, y, collided = ladder.move(1.5, 0.3, c, -s, True)
    assert collided == (s > 0.2) and x == pytest.approx(1.5 + c, abs=1e-5)
    assert y == pytest.approx(max(0.1, 0.3 - s), abs=SKIN)
    x, y, _ = ladder.move(1.5, 0.3, c, -s, False)
    assert x == pytest.approx(1.5 + min(0.2 / s, 1.0) * c, abs=1e-5)


def test_a_corner_is_a_circle() -> None:
    """Past the lower right corner of a box, .05 m below it, to the left: contact is one radius from that corner."""
    mesh = boxes_mesh([("box", 1.0, 1.0, 0.0, 2.0, 2.0, 1.0)], "box")
    obstacles = make_obstacles(mesh.vertices[mesh.faces], 0.2, 1.5, 0.1)
    pose = np.array([2.5, 0.95])
    assert move_disc(obstacles, pose, np.array([-1.0, 0.0]), False)
    assert pose[0] == pytest.approx(2.0 + math.sqrt(0.1**2 - 0.05**2), abs=2e-5)


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=CI_SLOW) for k in (1, 2))])
def test_twin_among_random_boxes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes: list[Box] = [("floor", -1.0, -1.0, -0.1, 7.0, 7.0, 0.0)]
    for _ in range(30):
        x, y = rng.uniform(0.0, 5.5, 2)
        w, d, low = rng.uniform(0.02, 1.0), rng.uniform(0.02, 1.0), rng.uniform(0.0, 1.0)
        boxes.append(("box", x, y, low, x + w, y + d, low + rng.uniform(0.05, 2.0)))
    mesh = boxes_mesh(boxes, "boxes")
    obstacles = make_obstacles(mesh.vertices[mesh.faces], 0.2, 1.5, 0.1)
    inside = [b for b in boxes[1:] if b[6] > 0.2 and b[3] < 1.5]
    pose, heading, touched = np.array([-0.5, -0.5]), 0.0, 0
    for _ in range(80):
        heading += rng.normal(0.0, 0.7)
        if not -0.5 <= pose.min() <= pose.max() <= 6.0:
            heading = math.atan2(3.0 - pose[1], 3.0 - pose[0])
        way, slide = 0.25 * np.array([math.cos(heading), math.sin(heading)]), bool(rng.integers(2))
        expected, collided = walk(obstacles.segments, pose, way, slide)
        assert move_disc(obstacles, pose, way, slide) == collided
        assert np.allclose(pose, expected, rtol=0.0, atol=1e-9)
        touched += collided
        for _, x0, y0, _, x1, y1, _ in inside:  # the boxes themselves, not their segments
            off = np.maximum(np.maximum([x0, y0] - pose, pose - [x1, y1]), 0.0)
            assert np.hypot(*off) >= 0.1 - 2e-5
    assert touched >= 5


def test_nothing_is_tunnelled_through() -> None:
    """A pole of a millimetre, and a way of 10 m straight at it."""
    mesh = boxes_mesh([("pole", 5.0, 0.0, 0.0, 5.001, 0.001, 3.0)], "pole")
    obstacles = make_obstacles(mesh.vertices[mesh.faces], 0.2, 1.5, 0.1)
    pose = np.array([0.0, 0.0005])
    assert move_disc(obstacles, pose, np.array([10.0, 0.0]), False)
    assert pose[0] == pytest.approx(4.9, abs=2e-5)
    share, normal = contact(obstacles.segments, np.array([0.0, 0.0005]), np.array([10.0, 0.0]))
    assert share == pytest.approx(0.49, abs=1e-5) and normal[0] == pytest.approx(-1.0, abs=1e-3)


def test_what_a_step_or_the_head_clears_is_no_obstacle() -> None:
    boxes: list[Box] = [("sill", 0.0, 0.0, 0.0, 1.0, 1.0, 0.19), ("lamp", 0.0, 0.0, 1.51, 1.0, 1.0, 1.6)]
    mesh = boxes_mesh(boxes, "low")
    assert len(make_obstacles(mesh.vertices[mesh.faces], 0.2, 1.5, 0.1).segments) == 0


def test_floor_must_be_there() -> None:
    mesh = boxes_mesh([("floor", 0.0, 0.0, -0.1, 2.0, 2.0, 0.0)], "slab")
    scene = Scene(
        mesh.vertices, mesh.faces, np.zeros(len(mesh.faces), int), table(0.2, 0.3), name="slab"
    )
    floor = Floor(scene, 0.0, GraphConfig())
    assert floor.move(1.9, 1.0, 0.25, 0.0, True) == (1.9, 1.0, True)
    assert floor.move(1.5, 1.0, 0.25, 0.0, True) == (1.75, 1.0, False)
    with pytest.raises(PointError, match="cannot stand"):
        floor.check(3.0, 1.0, "start")


def test_distances_round_corners() -> None:
    """Around the end of a wall .2 m thick: two tangents, two quarter arcs' parts of one radius, and the end itself."""
    boxes: list[Box] = [
        ("floor", 0.0, 0.0, -0.1, 4.0, 4.0, 0.0),
        ("wall", 1.9, -0.5, 0.0, 2.1, 3.0, 2.5),
    ]
    mesh = boxes_mesh(boxes, "wall")
    scene = Scene(
        mesh.vertices, mesh.faces, np.zeros(len(mesh.faces), int), table(0.2, 0.3), name="wall"
    )
    field, r = Floor(scene, 0.0, GraphConfig()).distances(3.0, 1.0), 0.1
    far = math.hypot(0.9, 2.0)  # from (1, 1) to the corner at (1.9, 3)
    tangent, slope = math.sqrt(far * far - r * r), math.atan2(2.0, 0.9)
    # The tangent leaves the line to the corner by asin(r / far); the arc goes on from there to level.
    expected = 2.0 * tangent + 2.0 * r * (slope + math.asin(r / far)) + 0.2
    found = field.ahead(1.0, 1.0)[0]
    assert expected - 1e-3 <= found <= expected + 0.1
    assert field.ahead(2.5, 1.5)[0] == pytest.approx(math.hypot(0.5, 0.5))  # in sight


def test_distances_are_those_of_the_ways(ladder: Floor) -> None:
    """Following `ahead` from anywhere leads to the goal, over free ways, no longer than the distance said."""
    field, rng = ladder.distances(5.5, 0.5), np.random.default_rng(0)
    for _ in range(60):
        i, j = LADDER[rng.integers(len(LADDER))]
        x, y = (float(v) for v in rng.uniform([i + 0.11, j + 0.11], [i + 0.89, j + 0.89]))
        far, length = field.ahead(x, y)[0], 0.0
        for _ in range(30):
            _, to_x, to_y = field.ahead(x, y)
            assert ladder.free_ways(np.array([[x, y, to_x, to_y]]))[0]
            length, x, y = length + math.hypot(to_x - x, to_y - y), to_x, to_y
            if (x, y) == (5.5, 0.5):
                break
        assert (x, y) == (5.5, 0.5) and far - 0.06 < length <= far + 1e-9
