"""The shortest ways round many edges: their lengths against a graph of places, their levels against boundary elements."""

import json
import math

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.scene.rays.geometry import Geometry, unoccluded
from soundspaces_sim.transport.arrivals.prepared import prepare_wedges
from soundspaces_sim.transport.preparation import make_model
from tests.marks import ci_slow
from tests.rooms import edges_alone
from tests.scans import places_of, unlabelled
from tests.transport.boundary_elements import Body, box
from tests.transport.edge_walks import SPEED, Walk
from tests.transport.far_round import CASES, TABLE, far_round
from tests.transport.test_edge_walks import levels_of

_SPACING = 0.3  # m, between places of an edge


@kernel
def _see(geometry: Geometry, at: np.ndarray, seen: np.ndarray) -> None:
    for i in range(len(at)):
        for j in range(i):
            seen[i, j] = seen[j, i] = unoccluded(geometry, row(at, i), row(at, j))


def _geodesics(scene: ss.Scene, points: np.ndarray) -> np.ndarray:
    """(n, n) m, shortest ways between points by places of the edges that see each other."""
    wedges, at = make_model(scene, points, edges_alone()).prepared.part(prepare_wedges).wedges, []
    for e in range(len(wedges.length)):
        count = max(2, math.ceil(wedges.length[e] / _SPACING))
        z = (np.arange(count) + 0.5) / count * wedges.length[e]
        at.append(wedges.start[e] + wedges.offset[e] + z[:, None] * wedges.along[e])
    places = np.concatenate([*at, points - scene.center])
    seen = np.zeros((len(places), len(places)), bool)
    _see(scene.geometry, places, seen)
    far = np.linalg.norm(places[:, None] - places, axis=2)
    own = np.arange(len(places) - len(points), len(places))
    return np.asarray(
        dijkstra(csr_matrix(np.where(seen, far, 0.0)), directed=False, indices=own)[:, own]
    )


@ci_slow
def test_first_arrivals_go_the_shortest_way() -> None:
    """The demo, 24 points, 193 pairs out of sight, half of which are more than two edges apart: of 95 in 100 sound first
    comes by way of edges, not later than by the shortest way between places of edges and their ends."""
    demo = ss.load_scene("demo")
    scene = ss.Scene.from_arrays(demo.vertices, demo.faces, 0.2, 0.3)  # walls that nothing passes
    grid = ss.make_grid(scene, 1.0).points
    points = grid[np.linspace(0, len(grid) - 1, 24).astype(int)]
    points = points + np.random.default_rng(1).uniform(-0.05, 0.05, points.shape)
    shortest = _geodesics(scene, points)
    echoes = ss.simulate(scene, points, points, edges_alone(duration=0.15))
    late, more = [], 0
    for i, j in np.argwhere(np.tri(24, k=-1)).tolist():
        arrivals = [a for a in echoes[i, j].arrivals if a.energy.max() > 0.0]
        if any(not a.planes and not a.edges for a in arrivals):
            continue
        first = min((a for a in arrivals if not a.planes), key=lambda a: a.delay, default=None)
        late.append(math.inf if first is None else first.delay * SPEED - shortest[i, j])
        more += first is not None and first.kind == "edges"
    assert len(late) == 193 and more > 70
    assert np.mean(np.array(late) < 0.3) >= 0.95, np.sort(late)[-20:]


def test_arrivals_are_the_same_with_every_seed() -> None:
    """A pair is solved from one of its ends, and some ways are found from one of them alone: which one is no matter of
    chance."""
    scene = ss.load_scene("demo")
    points = ss.make_grid(scene, 2.0).points[:12]
    one, other = (ss.simulate(scene, points, points, edges_alone(duration=0.1), seed) for seed in (1, 2))
    for i, j in np.argwhere(np.tri(len(points), k=-1)).tolist():
        first, second = ([(a.delay, *a.energy) for a in e[i, j].arrivals] for e in (one, other))
        assert first == second


def test_levels_far_round() -> None:
    """Six pairs of walls, four listeners each: rms 2, 3, 4, 5 dB in four bands, deep in the shadow, where sound is 17 to
    50 dB below a free field."""
    off = []
    for seed, exact in enumerate(json.loads(TABLE.read_text())):
        walk, places = far_round(seed)
        off.append(levels_of(walk, places) - np.array(exact))
    assert len(off) == CASES
    assert (np.sqrt(np.mean(np.square(off), axis=(0, 1))) < [2.0, 3.0, 4.0, 5.5]).all(), off


@pytest.mark.parametrize("corner", [-0.01, 0.0, 0.006, 0.02])
def test_a_way_has_one_level_from_either_end(corner: float) -> None:
    """Eight places 1 cm apart, whose ways are solved now from one end, now from the other: round a low body's corner, up
    past the edge of a cap, almost straight along its side, and over its top."""
    cap = [(-0.1, -1.0), (-0.1, -0.5), (0.0, -0.5), (0.0, 0.0), (-0.4, 0.0), (-0.4, -0.5), (-0.3, -0.5)]
    bodies = [Body(np.array([*cap, (-0.3, -1.0)]), endless=True), box(corner, 6.0, -1.4, -1.0)]
    level = levels_of(
        Walk(bodies, (-1.0, -0.8), (0.0, 0.0), (1.0, 1.0)),
        np.column_stack([np.full(8, 0.8), np.arange(-2.2, -2.125, 0.01)]),
    )
    assert (np.abs(np.diff(level[:, :3], axis=0)) < 0.2).all(), level


def test_no_way_turns_away_from_an_edge() -> None:
    """Two points of home-7002 with a door leaf between them, over which sound goes after it has turned by 0.28 rad at the
    jamb: at 1.6 kHz a half-plane alone takes 13 dB from a wave that turns so much."""
    scene = unlabelled(ss.load_scene("home-7002"))
    a, b = places_of(scene)[[22, 6]]
    arrivals = ss.simulate(scene, a[None], b[None], edges_alone(duration=0.05))[0, 0].arrivals
    energy = sum((x.energy for x in arrivals if not x.planes), np.zeros(4))
    level = 10.0 * np.log10(energy * 4.0 * np.pi * ((a - b) ** 2).sum())
    assert level.max() > -100.0
    assert (level[2:] < -13.0).all(), level
