"""An error that is asked for: which rounds pairs take part in, and what becomes of their energies."""

import logging
from itertools import pairwise

import numpy as np
import pytest
from soundspaces_rooms.many_rooms import ROOM_CONFIG

import soundspaces_sim as ss
from soundspaces_sim.core.simulation_config import DEFAULT_WALKS
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.rounds import round_sizes, takes_part
from soundspaces_sim.transport.simulate import simulate_pairs
from tests.marks import ci_slow
from tests.rooms import box, table, two_rooms
from tests.stats import repeat
from tests.transport.test_agreement import MIXED
from tests.transport.test_error_bars import ALL, LISTENERS, SOURCES, _of_pairs


def _asked(target: float, **settings: object) -> ss.SimulationConfig:
    return ss.SimulationConfig(target_error=target, **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("most", [16, 100, 128, 140, 144, 500, 4096, 32000, 100_000])
def test_rounds_grow_up_to_the_most(most: int) -> None:
    first, *later = round_sizes(_asked(0.05, max_walks=most))
    assert first <= -(-most // 16) * 16 and first + max(later, default=0) <= max(most, first)
    assert all(size % 16 == 0 and size > 0 for size in (first, *later))
    # up to what there may be and down again, and no round is more than twice its neighbour
    assert later == later[::-1]
    half = later[: -(-len(later) // 2)]
    assert half == sorted(half) and (not half or most - first - half[-1] < 16)
    assert all(b <= 2 * a for a, b in pairwise(half))


def test_a_number_has_rounds_of_its_own_and_datasets_have_one() -> None:
    assert round_sizes(ss.SimulationConfig(walks=100)) == [112]
    assert round_sizes(_asked(0.05, walks=100, max_walks=400)) == [112] * 3
    assert round_sizes(ss.JobConfig().simulation) == [-(-DEFAULT_WALKS // 16) * 16]
    assert ss.JobConfig().simulation.target_error is None
    assert (ROOM_CONFIG.target_error, ROOM_CONFIG.walks) == (0.05, None)


def _total(error: float, target: float, most: int) -> tuple[int, int, float]:
    """Subpaths and later rounds of a pair with this error after the first round, and its error at last, if the error
    falls as one over the root of the number of subpaths."""
    config = _asked(target, max_walks=most)
    sizes = round_sizes(config)
    done, rounds = sizes[0], 0
    for number, size in list(enumerate(sizes))[1:]:
        found = error * np.sqrt(sizes[0] / done)
        part = takes_part(
            np.array([[found if found < 0.5 else np.inf]]), np.array([[done]]), number, config
        )
        done, rounds = done + size * int(part[0, 0]), rounds + int(part[0, 0])
    return done, rounds, error * float(np.sqrt(sizes[0] / done))


@pytest.mark.parametrize("error", [0.01, 0.0501, 0.06, 0.1, 0.2, 0.3, 0.45])
def test_a_pair_gets_what_it_needs_in_one_round(error: float) -> None:
    """Not more than twice as many as it needs, beside the first round and the least one."""
    done, rounds, left = _total(error, 0.05, 32000)
    first = round_sizes(_asked(0.05, max_walks=32000))[0]
    needed = first * (error / 0.05) ** 2
    assert left <= 0.05 and rounds == int(error > 0.05)
    assert needed <= done <= 2.0 * needed + 0.5 * first or error <= 0.05


def test_a_pair_that_cannot_get_there_has_the_most_and_not_more() -> None:
    done, _, left = _total(0.45, 0.001, 4096)
    assert 4096 - 16 < done <= 4096 and left > 0.001
    # one that is not known at first takes a middling round, and then what it then seems to need, a little too little
    done, rounds, left = _total(0.6, 0.05, 32000)
    assert left <= 0.05 and rounds == 3 and done <= 32000
    config = _asked(0.05)
    nan = np.full((1, 1), np.nan)  # an error that is no number is none that suffices
    last = len(round_sizes(config)) - 1
    assert takes_part(nan, np.full((1, 1), 128), last, config).all()


def test_default_asks_for_an_error_and_says_what_became_of_it(caplog: pytest.LogCaptureFixture) -> None:
    scene = box((4.0, 5.0, 3.0), table([0.3] * 4, [0.3] * 4), [0] * 6)
    with caplog.at_level(logging.INFO):
        echoes = ss.simulate(scene, [[1.0, 1.0, 1.2]], [[3.0, 3.5, 1.5], [2.0, 4.0, 1.1]])
    assert echoes.relative_error.max() <= 0.05
    assert len(echoes.notes) == 2 and "of each point's own" in echoes.notes[0]
    assert echoes.notes[1].startswith("asked for an error of 5 %: all 2 pairs have it")
    assert any(echoes.notes[1] in record.getMessage() for record in caplog.records)
    caplog.clear()
    less = ss.simulate(scene, [1.0, 1.0, 1.2], [3.0, 3.5, 1.5], _asked(1e-3, max_walks=256))
    assert less.relative_error.max() > 1e-3
    assert "1 of 1 pairs have a larger one" in less.notes[1] and "256 subpaths" in less.notes[1]
    assert [r.levelname for r in caplog.records if less.notes[1] in r.getMessage()] == ["WARNING"]
    fixed = ss.simulate(scene, [1.0, 1.0, 1.2], [3.0, 3.5, 1.5], ss.SimulationConfig(walks=32))
    assert len(fixed.notes) == 1 and "transfer subpaths from each" in fixed.notes[0]


@ci_slow
def test_a_pair_has_the_same_rounds_in_any_company() -> None:
    """With shared transfer subpaths, which are those of any number of points."""
    scene = two_rooms(MIXED, 1)
    config = _asked(0.1, duration=0.3, max_walks=1024, radiance_transfer={"subpaths": "shared"})
    together = ss.simulate(scene, SOURCES, LISTENERS, config)
    for s, l in ALL:
        alone = ss.simulate(scene, SOURCES[s], LISTENERS[l], config)
        np.testing.assert_array_equal(alone.energy[0, 0], together.energy[s, l])
        np.testing.assert_array_equal(alone.relative_error[0, 0], together.relative_error[s, l])
    model = make_model(scene, np.array(SOURCES + LISTENERS), config)
    there, back = simulate_pairs(model, np.array(SOURCES), np.array(LISTENERS))
    assert back is not None
    np.testing.assert_array_equal(there.energy, together.energy)
    omni, reverse = there.energy[:, :, :, 0], back.energy[:, :, :, 0].transpose(1, 0, 2, 3)
    np.testing.assert_allclose(reverse.sum(axis=2), omni.sum(axis=2), rtol=1e-3)


def test_rounds_too_small_to_know_their_errors_are_known_together() -> None:
    """Ten rounds of 16 subpaths have the errors of one of 160, within what 16 batches tell of an error (z of its
    logarithm, 1 / sqrt(2 (16 - 1)) for either), and those of measures are known as well."""
    scene = two_rooms(MIXED, 1)

    def run(**settings: object) -> ss.Echograms:
        config = ss.SimulationConfig(duration=0.3, denoise=False, **settings)  # type: ignore[arg-type]
        return ss.simulate(scene, SOURCES, LISTENERS, config)

    first, one = run(walks=16), run(walks=160)
    rounds = run(walks=16, target_error=1e-6, max_walks=160)
    known = np.isfinite(one.relative_error) & np.isfinite(rounds.relative_error)
    assert np.isinf(first.relative_error).mean() > 0.3 and known.mean() > 0.9
    apart = np.log(rounds.relative_error[known] / one.relative_error[known])
    assert abs(apart.mean()) < 3.0 * np.sqrt(2.0 / 30.0) / np.sqrt(len(SOURCES) * len(LISTENERS))
    of_first, of_rounds = (np.asarray(e.measure_error, float) for e in (first, rounds))
    assert np.isfinite(of_rounds).mean() > 0.5 > np.isfinite(of_first).mean()


@ci_slow
def test_the_error_that_is_asked_for_is_the_spread_over_seeds() -> None:
    """In coupled rooms, whose pairs need several rounds: the spread of energies over seeds is at most the asked one,
    within four of its own standard errors, in the root mean square over pairs, windows and bands. Whoever stops by error
    bars stops a little more often where energies came out low: the mean over seeds is off that of a fixed number by less
    than a tenth of the error."""
    scene, target, seeds = two_rooms(MIXED, 1), 0.1, 64

    def run(seed: int, config: ss.SimulationConfig) -> np.ndarray:
        return _of_pairs(ss.simulate(scene, SOURCES, LISTENERS, config, seed), ALL)

    # By angle twice as many pairs are above the target when all subpaths are spent.
    asked = _asked(target, duration=0.4, max_walks=8192, reflection="random")
    fixed = ss.SimulationConfig(walks=3200, duration=0.4, reflection="random")
    found = repeat(lambda seed: run(seed, asked), seeds)
    known = repeat(lambda seed: run(10**6 + seed, fixed), 8)
    # one rare subpath that carries much leaves one pair in thirty above the target, as its error then says
    missed = ~(found[:, 1] <= target).all(axis=(2, 3))
    assert missed.mean() < 1 / 30 + 2.0 * np.sqrt(1 / 30 / missed.size)
    energy, reference = found[:, 0], known[:, 0]
    spread = np.log(energy).std(axis=0, ddof=1)
    of_seeds = np.sqrt(np.mean(spread**2))
    assert of_seeds <= target * (1.0 + 4.0 / np.sqrt(2 * (seeds - 1)))
    mean = reference.mean(axis=0)
    of_runs = (energy / mean).mean(axis=(1, 2, 3)) - 1.0
    of_fixed = (reference / mean).mean(axis=(1, 2, 3))
    error = np.hypot(of_runs.std(ddof=1) / np.sqrt(seeds), of_fixed.std(ddof=1) / np.sqrt(8))
    assert error < 0.03 * target
    assert abs(of_runs.mean()) < 0.1 * target
