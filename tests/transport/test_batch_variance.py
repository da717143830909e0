"""Batch variance of radiance transfer, against sums over all pairs of events and against its definition."""

import numpy as np

from soundspaces_sim.transport.radiance_transfer.batch_variance import (
    STEPS,
    BatchProducts,
    BinSteps,
    PairEnergies,
    PatchGroups,
    add_batches,
    add_products,
    add_to_group,
    make_groups,
)
from soundspaces_sim.transport.radiance_transfer.convolution import BLOCK
from soundspaces_sim.transport.tables import BATCHES

LONGEST, EVENTS = 160.0, 4000


def _groups() -> PatchGroups:
    return make_groups(np.zeros(1, int), np.ones((1, 1)), LONGEST)


def _histogram(groups: PatchGroups, length: np.ndarray, batch: np.ndarray) -> np.ndarray:
    """(BLOCK, BATCHES, STEPS, 1): events of one point, each of energy 1, and of no others."""
    sums = np.zeros((BATCHES, STEPS, 1, 1), np.float32)
    for l, k in zip(length, batch, strict=True):
        add_to_group.py_func(sums, groups, k, 0, l, np.ones(1, np.float32))
    histogram = np.zeros((BLOCK, *sums.shape[:3]), np.float32)
    histogram[0] = sums[..., 0]
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


def _products(rng: np.random.Generator, a: int, b: int) -> BatchProducts:
    of_a, of_b = (a, BATCHES, b, STEPS), (b, BATCHES, a, STEPS)
    shapes = of_a, of_a, of_b, of_b, (0, *of_a[::2], STEPS), (0, *of_b[::2], STEPS)
    return BatchProducts(*(rng.gamma(2.0, 1.0, shape).astype(np.float32) for shape in shapes))


def test_energies_of_batches_are_those_of_the_definition() -> None:
    """E_k = E (⟨V_k, F⟩ / E + ⟨V, F_k⟩ / E − 1 / K), bin by bin; in a step without energy all batches have E / K."""
    rng, (a, b, bins, windows) = np.random.default_rng(1), (2, 3, 40, 5)
    products = _products(rng, a, b)
    for array, of_a in zip(products[:4], (True, True, False, False), strict=True):
        array[(0, slice(None), 2, 7) if of_a else (2, slice(None), 0, 7)] = 0.0
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
    add_batches(0, len(pairs), pairs, energies, products, places, batches, np.empty((STEPS, BATCHES)))

    expected = np.zeros_like(batches)
    for i, j in pairs:
        of_a = (products.outgoing_a + products.incident_a)[i, :, j].astype(float)  # (BATCHES, STEPS)
        of_b = (products.outgoing_b + products.incident_b)[j, :, i].astype(float)
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
    products = BatchProducts(a, a, b, b, *np.zeros((2, 0, 1, 1, STEPS), np.float32))
    add_batches(0, runs, pairs, energies, products, places, batches, np.empty((STEPS, BATCHES)))
    variance = BATCHES * batches[:, 0, :, 0].var(axis=1, ddof=1)
    expected = (1.0 + sd_v**2) * (1.0 + sd_f**2) - 1.0
    error = variance.std(ddof=1) / np.sqrt(runs)
    assert error < 0.02 * expected
    assert abs(variance.mean() - expected) < 3.5 * error
    assert abs(energy.var(ddof=1) / expected - 1.0) < 3.5 * np.sqrt(2.0 / runs)


def test_mean_counts_are_those_of_both_directions() -> None:
    """n̄ = Σ_d T_d (⟨V^m, F⟩_d / ⟨V, F⟩_d of every fourth batch + ⟨V, F^m⟩_d / T_d) / Σ_d T_d, d = there, back, T_d the
    products of all batches; on a line between steps, and those of the next step where nothing arrives. What halving
    takes is the same, less the product ⟨Ṽ^m, F̃^m⟩ over that of the batches that are counted."""
    rng, (a, b, groups) = np.random.default_rng(5), (2, 2, 3)
    rows = BATCHES + 2 * groups
    ends = (a, b), (a, b), (b, a), (b, a)
    shapes = [(n, rows, m, STEPS) for n, m in ends] + [(groups, n, m, STEPS) for n, m in ends[1:3]]
    products = BatchProducts(*(rng.gamma(2.0, 1.0, shape).astype(np.float32) for shape in shapes))
    products.outgoing_a[0, :BATCHES, 1, 9] = products.outgoing_b[1, :BATCHES, 0, 9] = 0.0
    position = np.array([0.0, 2.25, 8.5, 14.0, -0.1])
    bins, shift_a, shift_b = len(position), np.full(a, 0.2), np.full(b, 0.1)
    places = BinSteps(
        np.clip(np.rint(position), 0, 15).astype(np.int64),
        np.arange(bins),
        position - 0.15,
        shift_a,
        shift_b,
    )
    energies = PairEnergies(np.ones((a, b, bins)), np.ones((b, a, bins)), np.ones(bins))
    batches = np.zeros((a, b, rows, bins))
    pairs = np.argwhere(np.ones((a, b), bool))
    add_batches(0, len(pairs), pairs, energies, products, places, batches, np.empty((STEPS, rows)))
    for i, j in pairs:
        there = products.outgoing_a[i, :, j].astype(float), products.incident_b[j, :, i].astype(float)
        back = products.outgoing_b[j, :, i].astype(float), products.incident_a[i, :, j].astype(float)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean, weight = np.zeros((2 * groups, STEPS)), np.zeros(STEPS)
            crossed = products.crossed_a[:, i, j], products.crossed_b[:, j, i]
            for (v, f), both in zip((there, back), crossed, strict=True):
                total = v[:BATCHES].sum(axis=0)
                v[BATCHES + groups :] -= both
                n = v[BATCHES:] / v[:BATCHES:4].sum(axis=0) + f[BATCHES:] / total
                n = np.maximum(n, 0.0)
                mean += np.where(total > 0.0, n * total, 0.0)
                weight += total
            mean /= weight
        assert np.isnan(mean[:, 9]).all() == ((i, j) == (0, 1))
        low = np.clip(np.floor(position), 0, STEPS - 2).astype(int)
        line = mean[:, low] + (position - low) * (mean[:, low + 1] - mean[:, low])
        line = np.where(np.isnan(line), mean[:, low], line)
        np.testing.assert_allclose(batches[i, j, BATCHES:], np.maximum(line, 0.0), rtol=1e-6, atol=1e-12)
