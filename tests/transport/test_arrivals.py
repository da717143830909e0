"""What arrives discretely: how diffracted waves join others, which paths there are, and that they are the same in
any tile."""

import numpy as np
import pytest
from scipy.special import fresnel

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.core.numerics.kernel import kernel, set_thread_count
from soundspaces_sim.transport.arrivals.field import Spectrum, make_spectrum
from soundspaces_sim.transport.arrivals.waves import Waves, join, make_waves
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.preparation import make_model
from tests.marks import few
from tests.rooms import edges_alone, table, two_rooms
from tests.transport.edge_walks import WALKS
from tests.transport.exact_wedge import SPEED
from tests.transport.test_edge_walks import scene_of
from tests.transport.test_utd import end_parts

SPECTRUM = make_spectrum(DEFAULT_BANDS, SPEED)
_APART = 2.0 * np.pi / SPECTRUM.centre  # m, lengths from which on waves are two


@kernel
def _join(waves: Waves, spectrum: Spectrum) -> None:
    join(waves, spectrum)


def _random_waves(rng: np.random.Generator, count: int, apart: float) -> Waves:
    """The direct sound, reflections and diffracted waves, their lengths within so many m."""
    waves, shape = make_waves(count, SPECTRUM), (count, *SPECTRUM.k.shape)
    waves.number[0] = count
    waves.length[:] = 3.0 + np.append(0.0, rng.uniform(0.0, apart, count - 1))
    waves.moves[:] = rng.uniform(size=count) < 0.7
    waves.moves[0] = False
    size = 10.0 ** rng.uniform(-2.0, 0.3, (count, shape[1], 1))
    waves.field[:] = size * np.exp(1j * rng.uniform(-np.pi, np.pi, shape))
    still = ~waves.moves
    waves.field[still] = np.abs(waves.field[still])
    return waves


def _sum(waves: Waves, field: np.ndarray) -> np.ndarray:
    """(b, g) pressure of all, but for the phase of the direct sound."""
    phase = np.exp(-1j * SPECTRUM.k * (waves.length - waves.length[0])[:, None, None])
    return np.asarray((field * phase).sum(axis=0))


@pytest.mark.parametrize("apart", [0.01, 0.3, 3.0, 20.0])
def test_what_joins_keeps_the_sum_of_pressures(apart: float) -> None:
    """At every wave number; and energies are the mean squares of what waves then have."""
    rng, moved = np.random.default_rng(1), 0
    for _ in range(60):
        waves = _random_waves(rng, int(rng.integers(2, 12)), apart)
        before = _sum(waves, waves.field)
        _join(waves, SPECTRUM)
        size = np.abs(waves.field).sum(axis=0)
        off = np.abs(waves.joined.sum(axis=0) - before)
        assert (off < 1e-12 * size).all(), off.max()
        squares = np.abs(waves.joined) ** 2 @ SPECTRUM.weight
        np.testing.assert_allclose(waves.energy, squares, rtol=1e-12, atol=1e-30)
        moved += (waves.joined != waves.field).any()
    assert moved > 10


def test_no_wave_goes_farther_than_it_is_coherent() -> None:
    """Waves that are a phase of 2 pi from each other at a band's centre stay as they are in that band, and nobody's
    pressure is more than the sum of those that are connected with it by less."""
    rng, still = np.random.default_rng(2), 0
    for _ in range(80):
        waves = _random_waves(rng, int(rng.integers(2, 12)), 10.0 ** rng.uniform(-2.0, 1.5))
        _join(waves, SPECTRUM)
        order = np.argsort(waves.length)
        for b, apart in enumerate(_APART):
            # waves in a row, each nearer than that to the next, may hand on what has joined them
            parts = np.split(order, np.flatnonzero(np.diff(waves.length[order]) >= apart) + 1)
            for part in parts:
                most = np.abs(waves.field[part, b]).sum(axis=0)
                assert (np.abs(waves.joined[part, b]) <= most * (1.0 + 1e-12)).all()
                if len(part) == 1:
                    np.testing.assert_array_equal(waves.joined[part[0], b], waves.field[part[0], b])
                    still += 1
    assert still > 100


def test_the_direct_sound_never_goes() -> None:
    """Nor does a geometrical wave that nothing has joined."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        waves = _random_waves(rng, 8, 0.3)
        waves.moves[:] = False
        _join(waves, SPECTRUM)
        np.testing.assert_array_equal(waves.joined, waves.field)


def _beyond(phase: np.ndarray) -> np.ndarray:
    """B of (T33): what half a plane beyond a line takes of sound that passes it with this phase of a detour."""
    s, c = fresnel(np.sqrt(2.0 * phase / np.pi))
    return np.asarray(0.5 - 0.5 * (1.0 + 1.0j) * (c - 1.0j * s))


def test_two_edges_that_meet_at_a_corner_of_an_opening() -> None:
    """What passes a quarter of a plane is the product of what passes both half-planes (Kirchhoff, and detours of
    their sum by the corner): in the light of both edges their waves and the direct sound are (1 - B_e)(1 - B_f), in
    the shadow of the first the waves are B_e (1 - B_f). Edge e has -B_e, or B_e, of the direct sound, and of it what
    its end at the corner leaves (T33a)."""
    rng = np.random.default_rng(6)
    phase, k = rng.uniform(0.01, 2.0 * np.pi, (200, 2)), rng.uniform(1.0, 50.0, 200)
    of_e, of_f = _beyond(phase).T
    left = np.empty((2, 200, 2), complex)  # by edge, of (B, what the end leaves)
    for own, other in ((0, 1), (1, 0)):
        end_parts(np.column_stack([k, phase[:, other] / k, phase[:, own] / k]), left[own])
    in_light = -of_e * 0.5 * (1.0 + left[0, :, 1]) - of_f * 0.5 * (1.0 + left[1, :, 1])
    np.testing.assert_allclose(in_light, (1.0 - of_e) * (1.0 - of_f) - 1.0, atol=1e-5)
    # of edge f the apex is beyond its end now: that end's half is less
    in_shadow = of_e * 0.5 * (1.0 + left[0, :, 1]) - of_f * 0.5 * (1.0 - left[1, :, 1])
    np.testing.assert_allclose(in_shadow, of_e * (1.0 - of_f), atol=1e-5)


def _bits(e: ss.Echogram) -> list[tuple[object, ...]]:
    return [
        (a.kind, a.planes, a.edges, a.delay, a.energy.tobytes(), a.direction.tobytes())
        for a in e.arrivals
    ]


@pytest.mark.parametrize("name", few(["rooms", "cupboard"], "cupboard"))
def test_any_tile_and_any_threads_have_the_same_bits(name: str) -> None:
    """Six points: all pairs at once, every pair alone, and on one thread and two."""
    if name == "rooms":
        scene, low, high = two_rooms(table(0.3, 0.4)), [0.3, 0.3, 0.3], [7.7, 3.7, 2.2]
    else:
        scene, low, high = scene_of(WALKS["cupboard on a floor"]), [-2.0, -1.0, 0.1], [2.0, 1.0, 1.6]
    points = np.random.default_rng(5).uniform(low, high, (6, 3))
    if name == "cupboard":
        points[:, 0] += np.sign(points[:, 0]) * 0.4  # off the cupboard
    config = edges_alone()
    try:
        set_thread_count(1)
        whole = ss.simulate(scene, points, points, config)
        set_thread_count(2)
        two = ss.simulate(scene, points, points, config)
    finally:
        set_thread_count(None)
    bent = 0
    for s in range(6):
        for l in range(6):
            assert _bits(whole[s, l]) == _bits(two[s, l])
            if s != l:
                alone = ss.simulate(scene, points[[s]], points[[l]], config)[0, 0]
                assert _bits(alone) == _bits(whole[s, l]), (s, l)
            bent += sum(bool(a.edges) for a in whole[s, l].early)
    assert bent > 30


def _sides(walls: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(4,) whether a place (x, z) is before each side of a box x0, x1, z0, z1."""
    return np.array([x[0] < walls[0], x[0] > walls[1], x[1] < walls[2], x[1] > walls[3]])


def _kinds(scene: ss.Scene, p: np.ndarray, q: np.ndarray) -> list[set[str]]:
    echoes = simulate_tile(make_model(scene, np.concatenate([p, q]), edges_alone()), p, q)[0]
    return [
        {a.kind for a in echoes[i, j].early} if echoes[i, j].direct is None else {"direct"}
        for i in range(len(p))
        for j in range(len(q))
    ]


def _straight_is_clear(walls: np.ndarray, p: np.ndarray, q: np.ndarray) -> bool:
    """Whether the line between two places (x, z) misses a box, by 2001 places on it."""
    at = p + np.linspace(0.0, 1.0, 2001)[:, None] * (q - p)
    inside = (
        (at[:, 0] > walls[0]) & (at[:, 0] < walls[1]) & (at[:, 1] > walls[2]) & (at[:, 1] < walls[3])
    )
    return not inside.any()


def test_every_pair_about_a_pillar_has_its_paths() -> None:
    """Who are out of sight of each other and both before one of two sides that meet have a path by the edge between
    them, others by two edges."""
    rng, walls = np.random.default_rng(8), np.array([-0.2, 0.2, -0.2, 0.2])
    scene, counts = scene_of(WALKS["pillar of 40 cm"]), {"edge": 0, "two edges": 0}
    places = rng.uniform(-2.0, 2.0, (30, 2))
    places = places[np.abs(places).max(axis=1) > 0.35][:16]
    left = np.column_stack([rng.uniform(-2.0, -0.4, 4), rng.uniform(-0.18, 0.18, 4)])
    p, q = np.concatenate([places[:8], left]), np.concatenate([places[8:], -left])
    full = [np.column_stack([x[:, 0], rng.uniform(-0.3, 0.3, len(x)), x[:, 1]]) for x in (p, q)]
    found = iter(_kinds(scene, *full))
    corners = [((x, z), (0 if x == 0 else 1, 2 if z == 0 else 3)) for x in range(2) for z in range(2)]
    for a in p:
        for b in q:
            kinds = next(found)
            if _straight_is_clear(walls, a, b):
                assert "direct" in kinds
                continue
            assert "direct" not in kinds
            # an edge is seen from before either of its sides
            seen = [all(_sides(walls, x)[list(sides)].any() for x in (a, b)) for _, sides in corners]
            kind = "edge" if any(seen) else "two edges"
            assert kind in kinds, (a, b, kinds)
            counts[kind] += 1
    assert min(counts.values()) > 5, counts


def test_every_pair_past_a_cupboard_has_its_paths() -> None:
    """On a floor, both ends below its top: by both upper edges, and by way of the floor before them, after them, and
    both. With one end above the top, out of sight of the other: by the far edge, and then the floor."""
    rng = np.random.default_rng(9)
    scene = scene_of(WALKS["cupboard on a floor"])
    y, z = rng.uniform(-0.3, 0.3, (6, 2)), rng.uniform(0.3, 0.9, (6, 2))
    before = np.column_stack([rng.uniform(-2.0, -0.8, 6), y[:, 0], z[:, 0]])
    behind = np.column_stack([rng.uniform(0.8, 2.0, 6), y[:, 1], z[:, 1]])
    for kinds in _kinds(scene, before, behind):
        wanted = {"two edges", "mirror, two edges", "two edges, mirror", "mirror, two edges, mirror"}
        assert wanted <= kinds, kinds
    above = before + [0.0, 0.0, 0.8]
    walls, kinds_of, hidden = np.array([-0.3, 0.3, 0.0, 1.0]), iter(_kinds(scene, above, behind)), 0
    for p in above:
        for q in behind:
            kinds = next(kinds_of)
            if _straight_is_clear(walls, p[[0, 2]], q[[0, 2]]):
                assert "direct" in kinds
            else:
                assert {"edge", "edge, mirror"} <= kinds, (p, q, kinds)
                hidden += 1
    assert hidden > 10
