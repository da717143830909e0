"""Standard errors of room measures: against the spread of measures over many independent estimates."""

from dataclasses import replace

import numpy as np
from scipy.stats import norm, t

import soundspaces_sim as ss
from soundspaces_sim.echogram import measure_errors as module
from soundspaces_sim.echogram.echogram import Arrivals, Echograms
from soundspaces_sim.echogram.measure_errors import measure_errors
from soundspaces_sim.echogram.measure_names import MEASURES
from soundspaces_sim.echogram.measures import echograms_measures
from tests.rooms import box, table

RUNS, BATCHES, BANDS = 1500, 16, 4
EDGES = np.concatenate([np.arange(50) * 0.001, 0.05 + np.arange(126) * 0.005])
WINDOW = np.minimum((EDGES[:-1] / 0.04).astype(int), 16)
NONE = Arrivals(np.empty(0), np.empty((0, BANDS)), np.empty((0, 3)), np.empty((0, 2), np.int64))
APART = np.zeros((RUNS, 1, 0, BANDS))  # nothing is known of either end alone
RATES = 13.8 / np.array([0.3, 0.4, 0.5, 0.6])  # of energy, 1/s


def _estimates(noise: float) -> tuple[Echograms, np.ndarray]:
    """Echograms (RUNS, 1) of an exponential decay, whose batches have independent noise in every window and band that
    grows with time; and the batches."""
    rng = np.random.default_rng(0)
    falling = np.exp(-RATES * EDGES[:, None])
    mean = 1e-3 * (falling[:-1] - falling[1:])
    of_window = np.stack([mean[w == WINDOW].sum(axis=0) for w in range(WINDOW[-1] + 1)])
    growing = noise * (1.0 + np.arange(len(of_window)) / 4.0)[:, None]
    factor = rng.gamma(1.0 / growing**2, growing**2, (RUNS, BATCHES, *of_window.shape))
    batches = factor * of_window / BATCHES
    energy = np.zeros((RUNS, 1, len(mean), 9, BANDS), np.float32)
    energy[:, 0, :, 0] = mean * factor.mean(axis=1)[:, WINDOW]
    shape = RUNS, 1
    echoes = Echograms(
        (0.0, 176.0, 775.0, 3409.0, 20000.0), 343.0, np.zeros((RUNS, 3)), np.ones((1, 3)), EDGES, energy,
        np.full((*shape, BANDS), 2e-4), np.full(shape, 1.0), np.zeros(shape, np.int64),
        np.zeros(RUNS + 1, np.int64), NONE, np.zeros((*shape, 2, BANDS)),
    )  # fmt: skip
    return echoes, batches[:, None].astype(np.float32)


def test_errors_are_the_spread_of_estimates() -> None:
    """Within 8 %: 4 standard errors of a standard deviation from 1,500 runs, and 1 % for other bins."""
    echoes, batches = _estimates(0.4)
    found = measure_errors(
        EDGES, echoes.energy, echoes.direct_energy, echoes.direct_length / 343.0, echoes.early_start, NONE,
        batches, APART, WINDOW,
    ) / module._STUDENT  # fmt: skip
    assert np.all(found > 0.0)
    values = echograms_measures(echoes)
    for m, name in enumerate(MEASURES):
        told = np.sqrt((found[:, 0, m] ** 2).mean(axis=0))
        np.testing.assert_allclose(told / values[name][:, 0].std(axis=0), 1.0, atol=0.08, err_msg=name)


def test_what_both_ends_differ_by_is_told_if_it_is_more() -> None:
    """Tails of 1.5 and .5 times the energy from 100 ms on: half of what T30 of both differs by."""
    echoes, batches = _estimates(1e-4)
    late = slice(60, None)
    difference = 0.5 * echoes.energy[:1, :, late, 0]

    def run(energy: np.ndarray, apart: np.ndarray) -> np.ndarray:
        delay = echoes.direct_length[:1] / 343.0
        found = measure_errors(
            EDGES, energy, echoes.direct_energy[:1], delay, np.zeros(2, np.int64), NONE, batches[:1], apart, WINDOW,
        )  # fmt: skip
        return np.asarray(found[0, 0])

    found = run(echoes.energy[:1], difference)
    times = []
    for sign in (1.0, -1.0):
        energy = echoes.energy[:1].copy()
        energy[:, :, late, 0] += sign * difference
        times.append(
            echograms_measures(replace(echoes, energy=np.repeat(energy, RUNS, axis=0)))["t30"][0, 0]
        )
    expected = 0.5 * np.abs(times[0] - times[1])
    np.testing.assert_allclose(found[MEASURES.index("t30")], expected, rtol=0.05)


def test_the_factor_is_that_of_student() -> None:
    assert abs(module._STUDENT - t.isf(norm.sf(4.0), BATCHES - 1 + module._PRIOR) / 4.0) < 1e-3


def test_without_noise_there_is_no_error_and_what_is_not_known_is_nan() -> None:
    echoes, batches = _estimates(1e-4)
    steady = np.broadcast_to(batches.mean(axis=2, keepdims=True), batches.shape)
    found = measure_errors(
        EDGES, echoes.energy, echoes.direct_energy, echoes.direct_length / 343.0, echoes.early_start, NONE,
        np.ascontiguousarray(steady), APART, WINDOW,
    )  # fmt: skip
    assert found.max() < 1e-3
    silent = measure_errors(
        EDGES, 0.0 * echoes.energy, 0.0 * echoes.direct_energy, echoes.direct_length / 343.0,
        echoes.early_start, NONE, 0.0 * batches, APART, WINDOW,
    )  # fmt: skip
    assert np.isnan(silent).all()


def test_times_with_large_errors_are_not_told() -> None:
    echoes, _ = _estimates(0.1)
    error = np.zeros((RUNS, 1, len(MEASURES), BANDS))
    error[: RUNS // 2, :, MEASURES.index("t30")] = 0.3  # s, of .3 to .6 s
    error[RUNS // 2, :, MEASURES.index("edt")] = np.nan
    values = echograms_measures(replace(echoes, measure_error=error))
    assert np.isnan(values["t30"][: RUNS // 2]).all()
    assert np.isfinite(values["t30"][RUNS // 2 :]).all() and np.isfinite(values["t20"]).all()
    assert np.isnan(values["edt"][RUNS // 2]).all() and np.isfinite(values["edt"][: RUNS // 2]).all()


def test_measures_of_a_room_lie_about_their_mean_as_their_errors_say() -> None:
    """z-scores of T30, EDT, C50 and D50 over 12 seeds and four pairs have a standard deviation of .7 to 1.15."""
    scene = box((7.0, 5.0, 3.0), table([0.1, 0.4, 0.2], [0.2, 0.6, 0.4]), [0, 0, 0, 2, 2, 1])
    config = ss.SimulationConfig(
        walks=200, duration=0.5, diffraction=ss.DiffractionConfig(enabled=False)
    )
    places = [[1.5, 1.0, 1.6], [4.0, 3.5, 1.2]], [[5.5, 4.0, 1.2], [2.0, 3.0, 1.2]]
    runs = [ss.simulate(scene, *places, config, seed) for seed in range(12)]
    for name in ("t30", "edt", "c50", "d50"):
        values = np.stack([echograms_measures(e)[name] for e in runs])
        errors = np.stack([e.measure_error[:, :, MEASURES.index(name)] for e in runs])  # type: ignore[index]
        z = (values - values.mean(axis=0)) / errors / np.sqrt(1.0 - 1.0 / len(runs))
        assert 0.7 < z.std() < 1.15, (name, z.std())
