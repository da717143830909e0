"""Error bars of radiance transfer: what batches make, against sums over all pairs of events."""

import numpy as np

from soundspaces_sim.transport.radiance_transfer.batch_variance import (
    STEPS,
    Groups,
    add_products,
    make_groups,
    put,
)
from soundspaces_sim.transport.radiance_transfer.convolution import BLOCK
from soundspaces_sim.transport.tables import BATCHES

LONGEST, EVENTS = 160.0, 4000


def _groups() -> Groups:
    return make_groups(np.zeros(1, int), np.ones((1, 1)), LONGEST)


def _table(groups: Groups, length: np.ndarray, batch: np.ndarray) -> np.ndarray:
    """(BLOCK, BATCHES, STEPS, 1): events of one point, each of energy 1, and of no others."""
    sums = np.zeros((BATCHES, STEPS, 1, 1), np.float32)
    for l, k in zip(length, batch, strict=True):
        put.py_func(sums, groups, k, 0, l, np.ones(1, np.float32))
    table = np.zeros((BLOCK, *sums.shape[:3]), np.float32)
    table[0] = sums[..., 0]
    return table


def test_steps_of_batches() -> None:
    """What batches of one end make with the other in every step is the number of pairs of events that meet there."""
    groups = _groups()
    rng = np.random.default_rng(0)
    one, other = rng.uniform(0.0, LONGEST, (2, EVENTS))
    batch = rng.integers(BATCHES, size=EVENTS)
    out = np.zeros((1, BATCHES, 1, STEPS), np.float32)
    brought = _table(groups, other, np.zeros(EVENTS, int)).sum(axis=1)
    add_products(groups, _table(groups, one, batch), brought, out)

    steps = (one / groups.step).astype(int)[:, None] + (other / groups.step).astype(int)
    expected = np.stack(
        [np.bincount(steps[batch == k].ravel(), minlength=2 * STEPS)[:STEPS] for k in range(BATCHES)]
    )
    np.testing.assert_allclose(out[0, :, 0], expected, rtol=1e-4, atol=1e-4 * expected.max())
    # Where sums of two lengths lie that meet in a step: in the mean n + 1 steps, for which bins look there.
    meets = one[:, None] + other
    for n in range(STEPS):
        edges = np.array([-0.5, 0.5]) * 0.1 + meets[steps == n].mean()
        assert groups.step_of(edges) == [n]
