"""What must hold to the last bit: reciprocity, and independence of threads, tiles and order."""

import numpy as np
import pytest

import soundspaces_sim as ss
import soundspaces_sim.transport.simulate as simulate
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count
from soundspaces_sim.echogram.reflection_counts import OF_PAIRS
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.preparation import make_model
from tests.rooms import plain, two_rooms
from tests.transport.test_agreement import MIXED
from tests.transport.test_diffraction import met

POINTS = np.array(
    [
        [1.0, 1.0, 1.2],
        [1.2, 3.0, 1.2],
        [3.0, 2.0, 1.3],
        [5.0, 2.0, 1.2],
        [6.5, 1.0, 1.4],
        [7.9, 3.9, 0.1],
    ]
)
CONFIG = plain(walks=64, duration=0.2, diffraction=True, denoise=True, materials=True)


@pytest.fixture(scope="module")
def everything() -> ss.Echograms:
    return ss.simulate(two_rooms(MIXED, 1), POINTS, POINTS, CONFIG)


def _same(a: ss.Echogram, b: ss.Echogram) -> None:
    assert a.counts is not None and b.counts is not None
    for name in OF_PAIRS:
        np.testing.assert_array_equal(getattr(a.counts, name), getattr(b.counts, name))
    np.testing.assert_array_equal(np.sort(a.early.groups), np.sort(b.early.groups))
    np.testing.assert_array_equal(a.energy, b.energy)
    np.testing.assert_array_equal(a.relative_error, b.relative_error)
    for x, y in zip(a.arrivals, b.arrivals, strict=True):
        assert x.delay == y.delay and (x.kind, x.planes, x.edges) == (y.kind, y.planes, y.edges)
        np.testing.assert_array_equal(x.energy, y.energy)
        np.testing.assert_array_equal(x.direction, y.direction)


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_do_not_matter(everything: ss.Echograms, threads: int) -> None:
    """Three do not share batches evenly."""
    before = thread_count()
    set_thread_count(threads)
    try:
        others = ss.simulate(two_rooms(MIXED, 1), POINTS, POINTS, CONFIG)
    finally:
        set_thread_count(before)
    for s in range(len(POINTS)):
        for l in range(len(POINTS)):
            _same(others[s, l], everything[s, l])


def test_tiles_and_order_do_not_matter(everything: ss.Echograms) -> None:
    model = make_model(two_rooms(MIXED, 1), POINTS, CONFIG)
    order = np.array([4, 1, 5])
    others = np.array([3, 0, 2])
    forward, backward = simulate_tile(model, POINTS[order], POINTS[others])
    assert backward is not None
    one_way, none = simulate_tile(model, POINTS[order], POINTS[others], both_ways=False)
    assert none is None
    for i, s in enumerate(order):
        for j, l in enumerate(others):
            _same(forward[i, j], everything[s, l])
            _same(one_way[i, j], everything[s, l])
            _same(backward[j, i], everything[l, s])


def test_more_points_than_a_tile_has_room_for(
    everything: ss.Echograms, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are taken in tiles, all pairs or not, with and without the way back, and directive ones."""
    room = two_rooms(MIXED, 1)
    one_way = ss.simulate(room, POINTS[:1], POINTS, CONFIG)
    model = make_model(room, POINTS, CONFIG)
    monkeypatch.setattr(simulate, "SIDE", 2)
    told: list[int] = []
    forward, backward = simulate.simulate_pairs(model, POINTS[:3], POINTS[2:], progress=told.append)
    assert backward is not None
    assert told == sorted(told)
    assert told[-1] == 3 * len(simulate._spans(len(POINTS) - 2, 2)) + 2 * (len(POINTS) - 2)
    all_pairs, one_by_one = (
        ss.simulate(room, POINTS, POINTS, CONFIG),
        ss.simulate(room, POINTS[0], POINTS, CONFIG),
    )
    assert all_pairs.early_start[-1] == len(all_pairs.early) == len(everything.early)
    for s in range(len(POINTS)):
        _same(one_by_one[0, s], one_way[0, s])
        for l in range(len(POINTS)):
            _same(all_pairs[s, l], everything[s, l])
            if s < 3 and l >= 2:
                _same(forward[s, l - 2], everything[s, l])
                _same(backward[l - 2, s], everything[l, s])


def test_more_than_there_is_memory_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulate, "free_memory", lambda: 1e5)
    with pytest.raises(ss.PointError, match=r"6 sources × 6 listeners.* GB.*build_dataset"):
        ss.simulate(two_rooms(MIXED, 1), POINTS, POINTS, CONFIG)


def test_a_single_pair_is_the_same_as_in_a_grid(everything: ss.Echograms) -> None:
    pair = ss.simulate(two_rooms(MIXED, 1), POINTS[2], POINTS[4], CONFIG)
    _same(pair[0, 0], everything[2, 4])


def test_reciprocity(everything: ss.Echograms) -> None:
    """Energies and delays of every pair are those of the reverse pair."""
    for s in range(len(POINTS)):
        for l in range(s):
            there, back = everything[s, l], everything[l, s]
            np.testing.assert_array_equal(there.energy[:, 0], back.energy[:, 0])
            forth = {met(a): a for a in there.arrivals}
            assert forth.keys() == {met(a, back=True) for a in back.arrivals}
            assert len(forth) == len(there.arrivals)
            for a in back.arrivals:
                twin = forth[met(a, back=True)]
                assert a.delay == twin.delay
                np.testing.assert_array_equal(a.energy, twin.energy)


def test_reciprocity_by_angle() -> None:
    config = plain(walks=200, duration=0.2, reflection="angle", denoise=True)
    echoes = ss.simulate(two_rooms(MIXED, 1), POINTS[[1, 4]], POINTS[[1, 4]], config)
    assert (echoes[0, 1].energy[:, 0] > 0.0).any()
    np.testing.assert_array_equal(echoes[0, 1].energy[:, 0], echoes[1, 0].energy[:, 0])


def test_seed_decides(everything: ss.Echograms) -> None:
    other = ss.simulate(two_rooms(MIXED, 1), POINTS[:2], POINTS[:2], CONFIG, seed=1)
    assert not np.array_equal(other.energy[0, 1], everything.energy[0, 1])


def test_moments_are_bounded(everything: ss.Echograms) -> None:
    """Per order the squared moments of a bin do not exceed its energy squared (addition theorem)."""
    energy = everything.energy.astype(float)
    e = energy[:, :, :, 0]
    for channels in (slice(1, 4), slice(4, 9)):
        power = (energy[:, :, :, channels] ** 2).sum(axis=3)
        assert np.all(power <= e**2 * (1.0 + 1e-4) + 1e-20)
