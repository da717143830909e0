"""Batch variance of radiance transfer, against sums over all pairs of events and against its definition."""

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.transport.radiance_transfer.batch_variance import (
    STEPS,
    BatchProducts,
    BinSteps,
    OneWay,
    PairEnergies,
    PatchGroups,
    add_batches,
    add_products,
    add_to_group,
    make_groups,
)
from soundspaces_sim.transport.radiance_transfer.convolution import BLOCK
from soundspaces_sim.transport.tables import BATCHES, count_rows

LONGEST, EVENTS = 160.0, 4000


def _groups() -> PatchGroups:
    return make_groups(np.zeros(1, int), np.ones((1, 1)), LONGEST)


@kernel
def _fill(
    sums: np.ndarray,
    groups: PatchGroups,
    length: np.ndarray,
    batch: np.ndarray,
    energy: np.ndarray,
    counts: np.ndarray,
) -> None:
    for i in range(len(length)):
        add_to_group(sums, groups, batch[i], 0, length[i], energy, counts)


def _histogram(groups: PatchGroups, length: np.ndarray, batch: np.ndarray) -> np.ndarray:
    """(BLOCK, BATCHES, STEPS, 1): events of one point, each of energy 1, and of no others."""
    sums = np.zeros((STEPS, 1, BATCHES, 1, 1), np.float32)
    _fill(sums, groups, length, batch, np.ones(1, np.float32), np.empty(0, np.uint16))
    histogram = np.zeros((BLOCK, BATCHES, STEPS, 1), np.float32)
    histogram[0] = np.moveaxis(sums[:, :, :, 0, 0], 2, 0)
    return histogram


def test_products_of_batches_are_sums_over_pairs_of_events() -> None:
    """The product of a batch with all batches of the other end, in a step: how many pairs of events fall into it."""
    groups = _groups()
    rng = np.random.default_rng(0)
    outgoing, incident = rng.uniform(0.0, LONGEST, (2, EVENTS))
    batch = rng.integers(BATCHES, size=EVENTS)
    out = np.zeros((1, BATCHES, 1, STEPS), np.float32)
    total = _histogram(groups, incident, np.zeros(EVENTS, int)).sum(axis=1)
    add_products(groups, _histogram(groups, outgoing, batch), total, out)

    steps = (outgoing / groups.step).astype(int)[:, None] + (incident / groups.step).astype(int)
    expected = np.stack(
        [np.bincount(steps[batch == k].ravel(), minlength=2 * STEPS)[:STEPS] for k in range(BATCHES)]
    )
    np.testing.assert_allclose(out[0, :, 0], expected, rtol=1e-4, atol=1e-4 * expected.max())
    # Lengths of the paths of step n: in the mean n + 1 steps, where `step_of` looks for them.
    lengths = outgoing[:, None] + incident
    for n in range(STEPS):
        edges = np.array([-0.5, 0.5]) * 0.1 + lengths[steps == n].mean()
        assert groups.step_of(edges) == [n]


def _one_way(rng: np.random.Generator, p: int, q: int, groups: int) -> OneWay:
    rows = count_rows(groups)
    shapes = (
        (p, BATCHES + rows, q, STEPS), (q, BATCHES, p, STEPS), (q, rows, p, STEPS), (groups, p, q, STEPS),
        (groups, p, groups, q, STEPS),
    )  # fmt: skip
    return OneWay(*(rng.gamma(2.0, 1.0, shape).astype(np.float32) for shape in shapes))


def _products(rng: np.random.Generator, a: int, b: int, groups: int = 0) -> BatchProducts:
    return BatchProducts(_one_way(rng, a, b, groups), _one_way(rng, b, a, groups))


def test_energies_of_batches_are_those_of_the_definition() -> None:
    """E_k = E (⟨V_k, F⟩ / E + ⟨V, F_k⟩ / E − 1 / K), bin by bin; in a step without energy all batches have E / K."""
    rng, (a, b, bins, windows) = np.random.default_rng(1), (2, 3, 40, 5)
    products = _products(rng, a, b)
    for array in (products.there.outgoing, products.back.incident):
        array[0, :, 2, 7] = 0.0
    for array in (products.back.outgoing, products.there.incident):
        array[2, :, 0, 7] = 0.0
    energies = PairEnergies(rng.random((a, b, bins)), rng.random((b, a, bins)), rng.random(bins))
    places = BinSteps(
        rng.integers(STEPS, size=bins),
        rng.integers(windows, size=bins),
        np.zeros(bins),
        np.zeros(a),
        np.zeros(b),
    )
    pairs = np.argwhere(np.ones((a, b), bool))
    batches = np.zeros((a, b, BATCHES, windows))
    add_batches(0, len(pairs), pairs, energies, products, places, batches, _scratch(BATCHES))

    expected = np.zeros_like(batches)
    for i, j in pairs:
        there, back = products.there, products.back
        of_a = (there.outgoing + back.incident)[i, :, j].astype(float)  # (BATCHES, STEPS)
        of_b = (back.outgoing + there.incident)[j, :, i].astype(float)
        for t in range(bins):
            energy = 0.5 * (energies.forward[i, j, t] + energies.backward[j, i, t]) * energies.restore[t]
            n = places.step[t]
            share = np.full(BATCHES, 1.0 / BATCHES)
            if (whole := 0.5 * (of_a + of_b)[:, n].sum()) > 0.0:
                share = of_a[:, n] / whole + of_b[:, n] / whole - 1.0 / BATCHES
            expected[i, j, :, places.window[t]] += energy * share
    np.testing.assert_allclose(batches, expected, rtol=1e-5)
    mean = 0.5 * (energies.forward + energies.backward.swapaxes(0, 1)) * energies.restore
    total = mean @ np.eye(windows)[places.window]
    np.testing.assert_allclose(batches.sum(axis=2), total, rtol=1e-5)


def test_variance_of_a_product_is_that_of_its_batches() -> None:
    """2,000 products E = V F of independent sums of 16 batches, of relative standard errors .04 and .03.

    The variance of E is .04² + .03² (and .04² .03²); batches say so in the mean, within 3.5 standard errors, which are
    below 2 %.
    """
    runs, (sd_v, sd_f) = 2000, (0.04, 0.03)
    rng = np.random.default_rng(2)
    shape = [
        1.0 / (BATCHES * sd**2) for sd in (sd_v, sd_f)
    ]  # of a batch: its relative variance is K sd²
    v, f = (rng.gamma(k, 1.0 / (BATCHES * k), (runs, BATCHES)) for k in shape)
    energy = v.sum(axis=1) * f.sum(axis=1)
    of_v, of_f = v * f.sum(axis=1, keepdims=True), f * v.sum(axis=1, keepdims=True)
    a = np.repeat(of_v[:, :, None, None], STEPS, axis=3).astype(np.float32)
    b = np.repeat(of_f.T[None, :, :, None], STEPS, axis=3).astype(np.float32)
    energies = PairEnergies(energy[:, None, None], energy[None, :, None], np.ones(1))
    places = BinSteps(
        np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1), np.zeros(runs), np.zeros(1)
    )
    pairs = np.column_stack([np.arange(runs), np.zeros(runs, np.int64)])
    batches = np.zeros((runs, 1, BATCHES, 1))
    none = np.zeros((0, 1, 1, STEPS), np.float32), np.zeros((0, 1, 0, 1, STEPS), np.float32)
    products = BatchProducts(OneWay(a, b, a[:, :0], *none), OneWay(b, a, b[:, :0], *none))
    add_batches(0, runs, pairs, energies, products, places, batches, _scratch(BATCHES))
    variance = BATCHES * batches[:, 0, :, 0].var(axis=1, ddof=1)
    expected = (1.0 + sd_v**2) * (1.0 + sd_f**2) - 1.0
    error = variance.std(ddof=1) / np.sqrt(runs)
    assert error < 0.02 * expected
    assert abs(variance.mean() - expected) < 3.5 * error
    assert abs(energy.var(ddof=1) / expected - 1.0) < 3.5 * np.sqrt(2.0 / runs)


def _scratch(rows: int) -> np.ndarray:
    return np.empty((STEPS, rows + 1))


def test_moments_of_counts_are_those_of_both_directions() -> None:
    """Of both directions together: n̄ = (⟨V^m, F⟩ + ⟨V, F^m⟩) / ⟨V, F⟩, what halving takes less the product of both
    ends, products of counts with those across both ends. On a line between steps, covariances for products, less a sixth of the product of both
    means' steps; those of the next step where nothing arrives."""
    rng, (a, b, groups) = np.random.default_rng(5), (2, 2, 3)
    rows = BATCHES + count_rows(groups)
    products = _products(rng, a, b, groups)
    for way in products:
        way.outgoing[:, BATCHES + 2 * groups :] *= 60.0
    products.there.outgoing[0, :BATCHES, 1, 9] = products.back.outgoing[1, :BATCHES, 0, 9] = 0.0
    position = np.array([0.0, 2.25, 8.5, 9.25, 13.5])
    bins, shift_a, shift_b = len(position), np.full(a, 0.2), np.full(b, 0.1)
    steps = np.rint(position).astype(np.int64)
    places = BinSteps(steps, np.arange(bins), position - 0.15, shift_a, shift_b)
    energies = PairEnergies(np.ones((a, b, bins)), np.ones((b, a, bins)), np.ones(bins))
    batches = np.zeros((a, b, rows, bins))
    pairs = np.argwhere(np.ones((a, b), bool))
    add_batches(0, len(pairs), pairs, energies, products, places, batches, _scratch(rows))
    low = np.floor(position).astype(int)
    m, k = np.tril_indices(groups)
    for i, j in pairs:
        total, weight = np.zeros((count_rows(groups), STEPS)), np.zeros(STEPS)
        for way, p, q in ((products.there, i, j), (products.back, j, i)):
            v = way.outgoing[p, :, q].astype(float)
            sums = v[BATCHES:] + way.counts[q, :, p]
            sums[groups : 2 * groups] -= way.halved[:, p, q]
            crossed = way.crossed[:, p, :, q]
            sums[2 * groups :] += crossed[k, m] + crossed[m, k]
            share = v[:BATCHES].sum(axis=0)
            total += np.where(share > 0.0, sums, 0.0)
            weight += share
        known = weight > 0.0
        assert known[9] == ((i, j) != (0, 1)) and known.sum() >= STEPS - 1
        total /= np.where(known, weight, 1.0)
        means = total[:groups]
        total[2 * groups :] -= means[m] * means[k]
        high = np.where(known[low], np.where(known[low + 1], position - low, 0.0), 1.0)
        line = total[:, low] + high * (total[:, low + 1] - total[:, low])
        step = means[:, low + 1] - means[:, low]
        both = known[low] & known[low + 1]
        line[2 * groups :] += line[m] * line[k] - np.where(both, step[m] * step[k] / 6.0, 0.0)
        np.testing.assert_allclose(batches[i, j, BATCHES:], np.maximum(line, 0.0), rtol=1e-5)
