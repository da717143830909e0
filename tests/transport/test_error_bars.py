"""The reported standard errors are right, and fall as one over the root of the number of subpaths."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.transport.model import EARLY_S
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import simulate_pairs
from tests.marks import CI_SLOW, ci_slow
from tests.rooms import box, plain, table, two_rooms
from tests.stats import repeat, z_scores
from tests.transport.test_agreement import MIXED

SOURCES, LISTENERS = [[1.2, 1.0, 1.2], [6.5, 2.8, 1.4]], [[3.0, 3.0, 1.3], [5.0, 1.5, 1.5]]
ROOMS: dict[str, tuple[Callable[[], ss.Scene], list[list[float]], list[list[float]]]] = {
    "two rooms": (lambda: two_rooms(MIXED, 1), SOURCES, LISTENERS),
    "seminar room": (
        lambda: box((9.0, 7.0, 3.0), table([0.1, 0.6, 0.25], [0.1, 0.7, 0.4]), [0, 0, 0, 2, 2, 1]),
        [[1.5, 1.0, 1.6], [4.0, 5.5, 1.2]], [[7.5, 5.0, 1.2], [2.0, 3.0, 1.2]],
    ),
    "corridor": (
        lambda: box((20.0, 2.0, 2.6), table([0.05, 0.4, 0.2], [0.1, 0.3, 0.5]), [2, 2, 0, 0, 0, 1]),
        [[1.0, 0.6, 1.5], [9.0, 1.4, 1.2]], [[18.5, 1.2, 1.5], [5.0, 1.0, 1.7]],
    ),
}  # fmt: skip
ALL = [(0, 0), (0, 1), (1, 0), (1, 1)]


def _of_pairs(echoes: ss.Echograms, pairs: Iterable[tuple[int, int]]) -> np.ndarray:
    """(2, pairs, windows, bands): energies and their reported relative errors.

    Windows meet within a bin, of which each has its share: with whole bins the late one would be 9 % too small
    in the house, and noisier than what the bars are of.
    """
    out = []
    for s, l in pairs:
        e = echoes[s, l]
        split = echoes.direct_length[s, l] / 343.0 + EARLY_S
        late = np.clip((e.time_edges[1:] - split) / np.diff(e.time_edges), 0.0, 1.0)
        energy = np.stack([1.0 - late, late]) @ e.energy[:, 0].astype(float)
        for arrival in e.arrivals:
            energy[int(arrival.delay > split)] += arrival.energy
        out.append([energy, e.relative_error])
    return np.array(out).transpose(1, 0, 2, 3)


def _energies(walks: int, seed: int, transfer: bool = True) -> np.ndarray:
    scene, sources, listeners = ROOMS["two rooms"]
    config = plain(walks=walks, specular={"ratio": 4}, duration=0.4, radiance_transfer=transfer)
    return _of_pairs(ss.simulate(scene(), sources, listeners, config, seed), ALL)


def _spread_of_z(samples: np.ndarray) -> np.ndarray:
    """(windows,) standard deviation of z-scores over seeds, pairs and bands."""
    energy, error = samples[:, 0], samples[:, 1]
    mean = energy.mean(axis=0)
    return np.asarray(((energy - mean) / (error * mean)).std(axis=(0, 1, 3)))


@pytest.mark.slow
@pytest.mark.parametrize("walks", [400, 2000])
def test_error_bars_are_calibrated(walks: int) -> None:
    """Over many seeds the z-scores have standard deviation 1 +- 0.15."""
    spread = _spread_of_z(repeat(lambda seed: _energies(walks, seed), 120))
    assert np.all(np.abs(spread - 1.0) < 0.15), spread


@pytest.mark.slow
@pytest.mark.parametrize("name", ["seminar room", "corridor"])
def test_error_bars_of_rooms(name: str) -> None:
    scene, sources, listeners = ROOMS[name]
    room, config = scene(), plain(walks=800, duration=0.6)

    def run(seed: int) -> np.ndarray:
        echoes = ss.simulate(room, sources, listeners, config, seed)
        return _of_pairs(echoes, ALL)

    spread = _spread_of_z(repeat(run, 200))  # of 80 it has a standard error of .05
    assert np.all(np.abs(spread - 1.0) < 0.15), spread


@pytest.mark.slow
def test_error_bars_of_a_furnished_house(shared: Path) -> None:
    scene = ss.load_scene(shared / "scenes" / "aws_small_house")
    points = ss.make_grid(scene, 1.0).points[[10, 60, 110, 160]]
    config = ss.SimulationConfig(duration=0.5)
    model = make_model(scene, points, config)

    def run(seed: int) -> np.ndarray:
        echoes = simulate_pairs(replace(model, seed=seed), points, None)[0]
        return _of_pairs(echoes, [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])

    spread = _spread_of_z(repeat(run, 80))
    assert np.all(np.abs(spread - 1.0) < 0.15), spread


def _log_variances(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """log of the late energy's variance over seeds and of the mean reported one, and standard errors.

    Means over pairs and bands; (2,) each, the errors by jackknife over seeds. The second of the first
    array is the logarithm of the mean of what single runs report.
    """
    energy = samples[:, 0, :, 1]
    reported = (energy * samples[:, 1, :, 1]) ** 2 * 13.0 / 15.0  # errors are larger, by Student's t

    def logs(keep: np.ndarray) -> np.ndarray:
        both = energy[keep].var(axis=0, ddof=1), reported[keep].mean(axis=0)
        return np.array([np.log(v).mean() for v in both])

    n = len(samples)
    without = np.array([logs(np.arange(n) != k) for k in range(n)])
    return logs(np.arange(n) >= 0), np.sqrt(
        (n - 1) / n * ((without - without.mean(axis=0)) ** 2).sum(axis=0)
    )


@ci_slow
@pytest.mark.parametrize("transfer", [False, True])
def test_error_bars_are_the_spread_over_seeds(transfer: bool) -> None:
    """Of late energy: what is reported is the variance over seeds, that of transfer subpaths included."""
    walks = 160 if transfer else 960  # errors of so many are known
    few, error = _log_variances(repeat(lambda seed: _energies(walks, seed, transfer), 96))
    assert np.hypot(*error) < 0.09
    assert abs(few[0] - few[1]) < 4.0 * np.hypot(*error), np.exp(few[0] - few[1])


@pytest.mark.parametrize(
    "transfer", [pytest.param(False, marks=CI_SLOW), pytest.param(True, marks=pytest.mark.slow)]
)
def test_variance_falls_as_one_over_walks(transfer: bool) -> None:
    """Of late energy: with four times the subpaths a quarter. Below 960 as many transfer subpaths leave these
    rooms' patches as there must be at least, and fewer subpaths do better than in proportion."""
    few, few_error = _log_variances(repeat(lambda seed: _energies(960, seed, transfer), 128))
    many, many_error = _log_variances(repeat(lambda seed: _energies(3840, seed, transfer), 96))
    fall, error = few[0] - many[0], np.hypot(few_error[0], many_error[0])
    assert error < 0.1
    assert abs(fall - np.log(4.0)) < 3.0 * error, np.exp(fall)


@ci_slow
def test_target_error_is_reached_where_it_was_not() -> None:
    """Every pair ends below the target; one alone gets what it gets among others; easy ones keep theirs."""
    scene = two_rooms(MIXED, 1)
    config = plain(walks=160, duration=0.3, target_error=0.08)
    one_round = ss.simulate(scene, SOURCES, LISTENERS, plain(walks=160, duration=0.3))
    echoes = ss.simulate(scene, SOURCES, LISTENERS, config)
    assert one_round.relative_error.max() > 0.08
    assert echoes.relative_error.max() <= 0.08
    alone = ss.simulate(scene, SOURCES[1], LISTENERS[0], config)
    np.testing.assert_array_equal(alone[0, 0].energy, echoes[1, 0].energy)
    np.testing.assert_array_equal(alone[0, 0].relative_error, echoes[1, 0].relative_error)
    loose = ss.simulate(scene, SOURCES, LISTENERS, plain(walks=160, duration=0.3, target_error=10.0))
    np.testing.assert_array_equal(loose.energy, one_round.energy)


@ci_slow
def test_target_error_gives_up_at_max_walks() -> None:
    """Three rounds, no more and no fewer: means of the rounds, error bars smaller by their root."""
    scene = two_rooms(MIXED, 1)

    def run(seed: int, walks: int = 160, **settings: object) -> ss.Echograms:
        config = plain(walks=walks, duration=0.3, **settings)
        return ss.simulate(scene, SOURCES, LISTENERS, config, seed)

    single = run(0)
    rounds = {n: run(0, target_error=1e-6, max_walks=n) for n in (160, 320, 480, 639)}
    np.testing.assert_array_equal(rounds[160].energy, single.energy)
    assert not np.array_equal(rounds[480].energy, rounds[320].energy)
    np.testing.assert_array_equal(rounds[639].energy, rounds[480].energy)
    # Of variances: the mean of a logarithm depends on how many degrees of freedom there are. All are known.
    variances = np.array([
        [(run(seed, 960, **more).relative_error ** 2).mean() for more in ({}, {"target_error": 1e-6, "max_walks": 2880})]
        for seed in range(8)
    ])  # fmt: skip
    one, three = variances.T / variances[:, 0].mean()
    assert abs(z_scores(3.0 * three - one, 0.0)) < 4.0 and np.std(3.0 * three - one) < 0.5, three / one
