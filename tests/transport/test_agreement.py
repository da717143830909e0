"""The estimator against an independent forward tracer, and its techniques against each other."""

from itertools import pairwise

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.transport.paths import detector
from tests.marks import CI_SLOW, ci_slow
from tests.rooms import box, plain, table, two_rooms
from tests.stats import limit, repeat
from tests.transport.forward_tracer import forward_echogram
from tests.transport.raised_wall_tracer import trace

MIXED = table(
    [[0.1, 0.2, 0.3, 0.2], [0.05, 0.1, 0.2, 0.1]],
    [[0.1, 0.2, 0.5, 0.3], [0.2, 0.1, 0.3, 0.6]],
    [[0.0, 0.0, 0.0, 0.0], [0.3, 0.1, 0.02, 0.0]],
)
EDGES_S = np.array([0.02, 0.04, 0.08, 0.16])


def _scene(name: str) -> tuple[ss.Scene, list[float], list[float]]:
    if name == "diffuse box":
        return box((6.0, 5.0, 2.7), table(0.2, 1.0)), [1.5, 2.0, 1.2], [4.3, 3.1, 1.6]
    if name == "near a wall":
        return box((6.0, 5.0, 2.7), table(0.2, 0.4)), [1.5, 2.0, 1.2], [5.95, 3.1, 1.6]
    if name == "unequal walls":
        materials = table([0.05, 0.6, 0.3], [0.1, 0.8, 0.5])
        return box((6.0, 3.0, 2.4), materials, [0, 0, 1, 0, 2, 1]), [1.0, 1.0, 1.0], [4.9, 2.2, 1.5]
    door = name != "closed wall"
    row = 0 if name == "door" else 1
    return two_rooms(MIXED, row, door), [1.2, 1.0, 1.2], [6.5, 2.8, 1.4]


def _engine(
    scene: ss.Scene, p: list[float], q: list[float], seeds: int, **settings: object
) -> np.ndarray:
    config = plain(**{"walks": 1000, "duration": 0.17, **settings})

    def run(seed: int) -> np.ndarray:
        e = ss.simulate(scene, [p], [q], config, seed)[0, 0]
        h = e.histogram(0.005)
        if e.direct is not None:
            h[:, int(e.direct.delay / 0.005)] -= e.direct.energy
        return np.stack([h[:, round(a / 0.005) : round(b / 0.005)].sum(axis=1)
                         for a, b in pairwise(EDGES_S)], axis=1)  # fmt: skip

    return repeat(run, seeds)


def _twin(scene: ss.Scene, p: list[float], q: list[float], band: int, batches: int) -> np.ndarray:
    a, s, t = scene.materials.in_bands(ss.SimulationConfig().bands)
    rows = scene.face_material
    return np.stack([
        forward_echogram(
            scene.corners, a[rows, band], s[rows, band], t[rows, band], np.array(p), np.array(q),
            EDGES_S * 343.0, 20000, np.random.default_rng(seed), radius=0.2 if q[0] < 5.9 else 0.05,
        )
        for seed in range(batches)
    ])  # fmt: skip


def _agree(x: np.ndarray, y: np.ndarray, what: str, relative: float) -> None:
    """Two independent sets of repetitions have the same mean."""
    use = y.mean(axis=0) > 0.02 * y.mean(axis=0).max()
    x, y = x[:, use], y[:, use]
    error = np.sqrt(x.var(axis=0, ddof=1) / len(x) + y.var(axis=0, ddof=1) / len(y))
    z = (x.mean(axis=0) - y.mean(axis=0)) / error
    assert np.all(error < relative * y.mean(axis=0)), f"{what}: too noisy: {error / y.mean(axis=0)}"
    assert np.all(np.abs(z) < limit(z.size)), f"{what}: z {z}, ratio {x.mean(axis=0) / y.mean(axis=0)}"


_SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("name", "band"),
    [
        pytest.param("unequal walls", 1, marks=CI_SLOW),
        pytest.param("door", 0, marks=CI_SLOW),
        *(pytest.param(name, band, marks=_SLOW) for name, band in (
            ("unequal walls", 0), ("open wall", 0), ("open wall", 1), ("diffuse box", 0), ("door", 1),
            ("closed wall", 0), ("closed wall", 1),
        )),
    ],
)  # fmt: skip
def test_against_forward_tracer(name: str, band: int) -> None:
    """Energy per window equals an independent tracer's."""
    scene, p, q = _scene(name)
    ours = _engine(scene, p, q, 16)[:, band]
    _agree(ours, _twin(scene, p, q, band, 24), f"{name}, band {band}", relative=0.2)


@pytest.mark.slow
def test_against_forward_tracer_near_a_wall() -> None:
    """A listener 5 cm from a wall: the detector is cut by it."""
    scene, p, q = _scene("near a wall")
    _agree(_engine(scene, p, q, 24)[:, 0], _twin(scene, p, q, 0, 60), "near a wall", relative=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("gap", [0.055, 0.1, 0.2])
def test_no_more_passes_below_a_wall_than_can(gap: float) -> None:
    """Floor on both sides of a wall that ends above it is not one patch: within .3 dB in every late window.

    The other side has no patches; the forward tracer, which holds it elsewhere, would need days for such a gap.
    """
    scene = two_rooms(table(0.2, 0.3), 0, door=False, gap=gap)
    p, q = [1.2, 1.0, 1.2], [6.5, 2.8, 1.4]

    def late(seed: int, **settings: object) -> np.ndarray:
        e = ss.simulate(scene, [p], [q], plain(duration=0.31, **settings), seed)[0, 0].histogram(0.01)[0]
        return np.array([e[a:b].sum() for a, b in ((5, 8), (8, 15), (15, 30))])

    ours = repeat(lambda seed: late(seed, walks=4000), 16)
    hits = repeat(lambda seed: late(seed, walks=24000, radiance_transfer=False), 24)
    _agree(ours, hits, f"gap of {gap} m", relative=0.03)
    ratio = 10.0 * np.log10(ours.mean(axis=0) / hits.mean(axis=0))
    assert np.all(np.abs(ratio) < 0.3), ratio


@pytest.mark.slow
def test_late_energy_beside_and_beyond_a_thick_raised_wall() -> None:
    """A wall .3 m thick that ends 6 cm above the floor: energy from 50 to 300 ms within .3 dB of a forward tracer's,
    pooled over seeds to a standard error of .1 dB, .15 m beside it and in the far room."""
    thick, gap, size = 0.3, 0.06, np.array([8.0, 4.0, 2.5])
    wall = np.array([4.0 - 0.5 * thick, 4.0 + 0.5 * thick, gap])
    outer, block = box(tuple(size), table(0.2, 0.3)), box((thick, 4.0, 2.5 - gap), table(0.2, 0.3))
    scene = ss.Scene(
        np.concatenate([outer.vertices, block.vertices + [wall[0], 0.0, gap]]),
        np.concatenate([outer.faces, block.faces[:, ::-1] + len(outer.vertices)]),
        np.zeros(len(outer.faces) + len(block.faces), int), table(0.2, 0.3),
    )  # fmt: skip
    source = np.array([1.2, 1.0, 1.2])
    spheres = np.array([[3.7, 2.8, 1.3, 0.12], [6.5, 2.8, 1.4, 0.4]])
    edges = np.array([0.05, 0.08, 0.15, 0.3])
    twin = np.stack([
        trace(np.random.default_rng(seed), 2_000_000, source, spheres, size, wall, 0.2, 0.3, 343.0 * edges) for seed in range(12)
    ])  # fmt: skip
    config = plain(duration=0.31, walks=4000)

    def late(seed: int) -> np.ndarray:
        pairs = ss.simulate(scene, [source], spheres[:, :3], config, seed)
        bins = [pairs[0, i].histogram(0.01)[1] for i in range(2)]
        return np.array(
            [[h[round(100 * a) : round(100 * b)].sum() for a, b in pairwise(edges)] for h in bins]
        )

    ours = repeat(late, 12)
    one, two = (x.sum(axis=2) for x in (ours, twin))
    off = 10.0 * np.log10(one.mean(axis=0) / two.mean(axis=0))
    relative = [x.std(axis=0, ddof=1) / np.sqrt(len(x)) / x.mean(axis=0) for x in (one, two)]
    assert np.all(10.0 / np.log(10.0) * np.hypot(*relative) < 0.1), relative
    assert np.all(np.abs(off) < 0.3), off


@pytest.mark.parametrize(
    ("name", "reflection"),
    [
        pytest.param("unequal walls", "random", marks=CI_SLOW),
        pytest.param("unequal walls", "angle", marks=CI_SLOW),
        pytest.param("closed wall", "random", marks=CI_SLOW),
        pytest.param("near a wall", "random", marks=CI_SLOW),
        pytest.param("closed wall", "angle", marks=CI_SLOW),
        *(pytest.param(name, "random", marks=_SLOW) for name in ("open wall", "door")),
        pytest.param("open wall", "angle", marks=_SLOW),
    ],
)  # fmt: skip
def test_techniques_agree(name: str, reflection: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Receiver volumes alone, the default mix, and connections almost alone have the same expectation."""
    scene, p, q = _scene(name)
    hits = _engine(
        scene, p, q, 16, connections={"subpaths": 0}, radiance_transfer=False, reflection=reflection
    )
    both = _engine(scene, p, q, 16, reflection=reflection)
    monkeypatch.setattr(detector, "GROWTH", detector.Growth(0.05, 0.01, 0.2))
    connections = _engine(
        scene,
        p,
        q,
        24,
        walks=4000,
        specular={"ratio": 4},
        connections={"subpaths": 4000, "window": 0.2},
        reflection=reflection,
    )
    flat = [x.reshape(len(x), -1) for x in (hits, both, connections)]
    _agree(flat[0], flat[1], f"{name}: hits against both", relative=0.15)
    _agree(flat[2], flat[1], f"{name}: connections against both", relative=0.2)


@ci_slow
def test_early_mirrors_replace_exactly_what_walks_leave_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Total energy is the same when mirror paths of order <= 2 are left to the subpaths instead."""
    from soundspaces_sim.transport.arrivals import prepared
    from soundspaces_sim.transport.arrivals.specular_planes import SpecularPlanes

    scene, p, q = _scene("door")
    with_planes = _engine(scene, p, q, 16, radiance_transfer=False)

    def none(_: np.ndarray, faces: np.ndarray) -> SpecularPlanes:
        return SpecularPlanes(np.empty((0, 3)), np.empty(0), np.empty(0), np.full(len(faces), -1))

    monkeypatch.setattr(prepared, "group_planes", none)
    without = _engine(scene, p, q, 16, radiance_transfer=False)
    flat = [x.reshape(len(x), -1) for x in (with_planes, without)]
    _agree(flat[1], flat[0], "mirrors", relative=0.1)


@ci_slow
def test_level_behind_a_wall_follows_the_way_through_the_door() -> None:
    """Two listeners 2 m from the source, one in its room, one behind the wall and far from the door."""
    scene = two_rooms(table(0.3, 0.3), 0)
    source = [3.0, 3.5, 1.3]
    listeners = [[3.0, 1.5, 1.3], [5.0, 3.5, 1.3], [5.0, 1.95, 1.3]]
    e = ss.simulate(scene, [source], listeners, plain(walks=4000))
    level = [10.0 * np.log10(e[0, i].histogram()[1].sum()) for i in range(3)]
    assert e[0, 0].visible and not e[0, 1].visible
    assert level[0] > level[2] + 1.0  # through the door: weaker than in the room
    assert level[2] > level[1] + 1.0  # beside the door: stronger than behind the wall, though further
