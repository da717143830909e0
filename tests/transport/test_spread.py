"""Error bars of the middle: what their tables say of windows, against sums over all pairs of events."""

import numpy as np
import pytest

from soundspaces_sim.transport.convolve import BLOCK
from soundspaces_sim.transport.spread import Groups, add_products, late_steps, make_groups, put
from soundspaces_sim.transport.tables import BATCHES, WINDOWS

BEGINS, LONGEST, LATEST = 17.15, 270.0, 55.0  # m
DECAY = 0.08  # 1/m: 60 dB in .5 s
EVENTS = 4000


def _groups() -> Groups:
    return make_groups(
        np.zeros(1, int), np.ones((1, 1)), BEGINS, LONGEST, LATEST, np.array([DECAY]),
        lambda lengths: np.ones((len(lengths), 1)),
    )  # fmt: skip


def _table(groups: Groups, length: np.ndarray, batch: np.ndarray) -> np.ndarray:
    """(BLOCK, BATCHES, kept + 1, 1): events of one point, each flattened to one, and of no others."""
    sums = np.zeros((BATCHES, groups.kept + 1, 1, 1), np.float32)
    for l, k in zip(length, batch, strict=True):
        put.py_func(sums, groups, k, 0, l, np.ones(1, np.float32))
    table = np.zeros((BLOCK, *sums.shape[:3]), np.float32)
    table[0] = sums[..., 0]
    return table


@pytest.mark.parametrize("early", [27.0, 31.3, 37.7, 44.4, 50.0])
def test_windows_of_batches(early: float) -> None:
    groups = _groups()
    rng = np.random.default_rng(0)
    one, other = rng.uniform(0.0, 150.0, (2, EVENTS))
    batch = rng.integers(BATCHES, size=EVENTS)
    out = np.zeros((1, 1, WINDOWS, BATCHES), np.float32)
    brought = _table(groups, other, np.zeros(EVENTS, int)).sum(axis=1)
    add_products(
        groups, _table(groups, one, batch), brought, late_steps(groups, np.array([[early]])), out
    )

    meets = one[:, None] + other
    energy = np.exp(-DECAY * meets)
    of_batch = np.stack([np.bincount(batch, (energy * inside).sum(axis=1), BATCHES) for inside in (
        (meets > BEGINS) & (meets < early), meets > early
    )])  # fmt: skip
    # Two times within steps and a window's share of one blur its start by a standard deviation of half a step
    # (1/12 + 1/12 + 1/12), which makes late sound that decays more by half the square of that; steps weigh as
    # their middles do, which is less than their mean.
    half = 0.5 * groups.step * DECAY
    expected = np.exp(0.5 * half**2) / (np.sinh(half) / half) ** 2
    late = out[0, 0, 1].sum() / of_batch[1].sum()
    assert late == pytest.approx(
        expected, abs=0.02
    )  # half a step more or less would be 1.26 times or .8
    np.testing.assert_allclose(out[0, 0, 1] / late, of_batch[1], rtol=0.12)  # of each: events are few
    whole = np.exp(-DECAY * meets).sum() - (energy * (meets < BEGINS)).sum()
    assert out.sum() == pytest.approx(whole, rel=0.03)
