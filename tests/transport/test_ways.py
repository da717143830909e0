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
from tests.transport.boundary_elements import Body, box, slab
from tests.transport.edge_walks import SPEED, Walk
from tests.transport.far_round import CASES, TABLE, far_round
from tests.transport.test_edge_walks import levels_of
from tests.transport.waves_in_rooms import ABSORPTION, Room, energy_until, share_until, step_of

_SPACING = 0.3  # m, between places of an edge
_UNTIL = (0.010, 0.020, 0.040)  # s, after the first arrival
_HEARD = 0.085  # s


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


def test_level_of_a_way() -> None:
    """Three walls of 4 cm, one behind the other: sound goes over their edges with the energy of (T34e) by the length of
    the string over them."""
    walls = [(-1.0, 1.5), (0.0, 1.8), (1.2, 1.6)]  # m, middle and top
    source, place = np.array([-2.5, 0.3]), np.array([2.9, 0.2])
    at = np.array([source, (-1.02, 1.5), (-0.02, 1.8), (0.02, 1.8), (1.22, 1.6), place])
    length = np.linalg.norm(np.diff(at, axis=0), axis=1).sum()
    bodies = [slab(x - 0.02, x + 0.02, top) for x, top in walls]
    walk = Walk(bodies, tuple(source), tuple(place), tuple(place))
    screen = 3.0 + 20.0 * (length - np.linalg.norm(place - source)) * walk.frequencies() / SPEED
    expected = 10.0 * np.log10((screen**-2.0).mean(axis=1) / length)
    np.testing.assert_allclose(levels_of(walk, place[None])[0], expected, atol=0.1)


def test_levels_far_round() -> None:
    """Six pairs of walls in free air, four listeners each, deep in the shadow, where sound is 17 to 50 dB below a free
    field: right by 2 dB in the mean, and by 3 dB in the lower two bands, 4.5 and 5.5 dB above (root mean square)."""
    off = []
    for seed, exact in enumerate(json.loads(TABLE.read_text())):
        walk, places = far_round(seed)
        off.append(levels_of(walk, places) - np.array(exact))
    assert len(off) == CASES
    assert (np.abs(np.mean(off, axis=(0, 1))) < 2.0).all(), off
    assert (np.sqrt(np.mean(np.square(off), axis=(0, 1))) < [3.0, 3.0, 4.5, 5.5]).all(), off


_BANDS = ((88.0, 176.0), (176.0, 775.0))


def test_a_band_is_told_from_what_is_below() -> None:
    """A pulse in the middle of a tone of 30 Hz that has a tenth of its height: both bands have what they have of the pulse
    alone, to 0.1 dB from 5 ms before it on, and at the pulse half of that."""
    steps = step_of(0.15)
    x = np.arange(steps) / steps
    pulse, tone = np.zeros((1, steps)), 0.1 * np.sin(np.pi * x) ** 2 * np.sin(2.0 * np.pi * 4.5 * x)
    pulse[0, steps // 2] = 1.0
    for band in _BANDS:
        alone, both = energy_until(pulse, band)[0], energy_until(pulse + tone, band)[0]
        after = slice(steps // 2 - step_of(0.005), steps // 2 + step_of(0.03))
        np.testing.assert_allclose(alone[steps // 2], share_until(np.zeros(1), band)[0], atol=1e-6)
        np.testing.assert_allclose(alone[steps // 2], 0.5, atol=0.1)
        np.testing.assert_allclose(10.0 * np.log10(both[after] / alone[after]), 0.0, atol=0.1)


@ci_slow
@pytest.mark.parametrize("name", ["demo", "home-7003"])
def test_first_sound_out_of_sight_against_finite_differences(name: str) -> None:
    """Two furnished homes of one material, 8 sources by 24 listeners, those out of sight: the energy up to 10, 20 and
    40 ms after the first arrival is right by 3.5 dB in the mean over pairs and by 8 dB in single ones (root mean square)."""
    given = ss.load_scene(name)
    scene = ss.Scene.from_arrays(given.vertices, given.faces, ABSORPTION, 0.15)
    room = Room(scene)
    points = room.centres(places_of(scene))
    sources = points[1::3]
    config = ss.SimulationConfig(
        bands=(*(f for f, _ in _BANDS), _BANDS[-1][1], 3409.0), walks=1000, duration=0.1
    )
    echoes, off = ss.simulate(scene, sources, points, config), []
    middle = 0.5 * (echoes.time_edges[1:] + echoes.time_edges[:-1])
    for s, source in enumerate(sources):
        responses = room.responses(source, points, _HEARD)
        exact = np.stack([energy_until(responses, band) for band in _BANDS], axis=1)
        for i, point in enumerate(points):
            arrivals = echoes[s, i].arrivals
            if (point == source).all() or any(not a.planes and not a.edges for a in arrivals):
                continue
            delay = np.concatenate([[a.delay for a in arrivals], middle])
            energy = np.concatenate([[a.energy for a in arrivals], echoes.energy[s, i, :, 0]])
            energy = energy * 4.0 * np.pi * ((point - source) ** 2).sum()
            first = min(a.delay for a in arrivals)
            if first + _UNTIL[-1] > _HEARD - 0.01:
                continue
            for until in first + np.array(_UNTIL):
                for b, band in enumerate(_BANDS):
                    own = energy[:, b] @ share_until(until - delay, band)
                    off.append(10.0 * np.log10(own / exact[i, b, step_of(until)]))
    level = np.reshape(off, (-1, len(_UNTIL), len(_BANDS)))
    assert len(level) > 100
    mean, spread = level.mean(axis=0), np.sqrt(np.square(level).mean(axis=0))
    assert (np.abs(mean) < 3.5).all() and (spread < 8.0).all(), (mean, spread)


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
