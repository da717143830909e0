"""Counts of reflections of smoothed energies, where the answer is known."""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.echogram.denoise import Noise, smooth_late
from soundspaces_sim.echogram.denoise_plan import make_denoise_plan
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.reflection_counts.of_tile import CountMoments, mean_times
from soundspaces_sim.transport.reflection_counts.smoothed import smoothed_moments
from soundspaces_sim.transport.tables import count_rows
from tests.marks import ci_slow
from tests.rooms import box, plain, table

PAIRS, BANDS, GROUPS = 2, 4, 2
RATES = np.array([80.0, 40.0])  # 1/s


class _Case(NamedTuple):
    """Energies of windows (PAIRS, 1, W, BANDS) and moments before and after smoothing, and what has been moved."""

    raw: np.ndarray
    smooth: np.ndarray
    before: CountMoments
    after: CountMoments
    moved: np.ndarray


def _smoothed(seed: int) -> _Case:
    """Exponential decays, with a noise of one half in late bins, of sound that two groups of materials reflect `RATES`
    times a second, as Poisson distributions have it."""
    walls = table([0.1, 0.2] * 3, [1.0] * 6)
    config = plain(
        walks=16, duration=0.8, radiance_transfer=False, materials={"enabled": True, "groups": GROUPS}
    )
    model = make_model(box((4.0, 3.0, 2.5), walls, range(6)), np.array([[1.0, 1.2, 1.1]]), config)
    edges, rng, noise = model.time_edges, np.random.default_rng(seed), 0.5
    middle, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    shape = PAIRS, 1, len(width), BANDS
    loud = np.where(edges[:-1, None] > 0.05, rng.gamma(1.0 / noise**2, noise**2, shape), 1.0)
    energy = np.zeros((*shape[:3], 9, BANDS), np.float32)
    energy[:, :, :, 0] = loud * (width * np.exp(-middle / 0.05))[:, None]
    time = mean_times(model, energy[:, :, :, 0])[0]
    mean = RATES[:, None] * time[:, :, :, None]
    m, k = np.tril_indices(GROUPS)
    both = mean[:, :, :, m] * mean[:, :, :, k] + np.where((m == k)[:, None], mean[:, :, :, m], 0.0)
    taken = -np.expm1(model.prepared.groups.anchor * mean)
    before = CountMoments(time, np.concatenate([mean, taken, both], axis=3).astype(np.float32))
    assert before.rows.shape[3] == count_rows(GROUPS)
    plan, starts = make_denoise_plan(edges, 0.05, 0.0), _starts(model.world.window_of_bin)
    late = noise * rng.normal(size=(*shape[:2], len(width) - plan.first, BANDS))
    late = (late * energy[:, :, plan.first :, 0]).astype(np.float32)
    raw = np.add.reduceat(energy[:, :, :, 0], starts, axis=2, dtype=float)
    splits = np.zeros(shape[:2], np.int64)
    window = model.world.window_of_bin
    unknown = np.zeros((*shape[:2], window.max() + 1, BANDS), np.float32)
    moved = smooth_late(energy, Noise(late, unknown, window), splits, plan, count_moved=True)
    assert moved is not None
    same = before._replace(rows=before.rows.copy())
    after = smoothed_moments(model, same, energy[:, :, :, 0], moved, plan)
    smooth = np.add.reduceat(energy[:, :, :, 0], starts, axis=2, dtype=float)
    return _Case(raw, smooth, before, after, moved)


def _starts(window: np.ndarray) -> np.ndarray:
    return np.unique(window, return_index=True)[1]


@ci_slow
def test_energy_that_is_moved_was_there_before_and_is_there_afterwards() -> None:
    case = _smoothed(0)
    np.testing.assert_allclose(case.moved.sum(axis=3), case.smooth, rtol=1e-4)
    whole = case.raw.sum(axis=2)
    np.testing.assert_allclose(case.moved.sum(axis=(2, 3)), whole, rtol=1e-4)
    assert (case.moved >= 0.0).all()
    assert np.abs(case.smooth / case.raw - 1.0).max() > 0.1


def test_counts_that_grow_with_time_still_do() -> None:
    """Reflections at a constant rate are as many as the rate has them at a window's mean time afterwards, whichever
    energies have come there; a path's distribution is still Poisson's. What has not been moved stays."""
    case = _smoothed(1)
    own = np.einsum("ijwwb->ijwb", case.moved) / case.moved.sum(axis=3)
    assert own[:, :, 6:].min() < 0.5 and own[:, :, :4].min() > 1.0 - 1e-5
    mean = case.after.rows[:, :, :, :GROUPS].astype(float)
    rates = np.broadcast_to(RATES[:, None], mean.shape)
    np.testing.assert_allclose(mean / case.after.time[:, :, :, None], rates, rtol=1e-3)
    variance = case.after.rows[:, :, :, [2 * GROUPS, 2 * GROUPS + 2]] - mean**2
    np.testing.assert_allclose(variance / mean, 1.0, atol=5e-3)
    covariance = case.after.rows[:, :, :, 2 * GROUPS + 1] - mean.prod(axis=3)
    assert np.abs(covariance).max() < 5e-3 * mean.max()
    np.testing.assert_array_equal(case.after.rows[:, :, :4], case.before.rows[:, :, :4])
    assert np.abs(case.after.time - case.before.time).max() > 1e-4
