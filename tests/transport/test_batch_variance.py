"""Batch variance of radiance transfer, against sums over all pairs of events and against its definition."""

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.transport.radiance_transfer.batch_moments import (
    BatchProducts,
    BinSteps,
    Crossed,
    PairEnergies,
    add_batches,
)
from soundspaces_sim.transport.radiance_transfer.batch_products import add_products
from soundspaces_sim.transport.radiance_transfer.batch_variance import (
    RAISED,
    PatchGroups,
    WindowSteps,
    add_to_group,
    make_groups,
    make_window_steps,
    moment_rows,
)
from soundspaces_sim.transport.radiance_transfer.time_steps import TimeSteps
from soundspaces_sim.transport.tables import BATCHES, count_rows
from tests.marks import ci_slow

WINDOWS = np.concatenate([np.arange(20.0, 49.0, 5.0), np.linspace(50.0, 160.0, 6)])  # m, of two widths
STEPS, EVENTS = len(WINDOWS) - 1, 4000


def _windows() -> WindowSteps:
    return make_window_steps(WINDOWS)


@kernel
def _fill(
    sums: np.ndarray,
    groups: PatchGroups,
    length: np.ndarray,
    batch: np.ndarray,
    energy: np.ndarray,
    counts: np.ndarray,
    incident: bool,
) -> None:
    for i in range(len(length)):
        add_to_group(sums, groups, batch[i], 0, length[i], energy, counts, incident)


def _histogram(steps: TimeSteps, length: np.ndarray, batch: np.ndarray, incident: bool) -> np.ndarray:
    """(BATCHES, steps, 1): events of one point, each of energy 1."""
    sums = np.zeros((steps.rows, 1, BATCHES, 1, 1), np.float32)
    groups = make_groups(np.zeros(1, int), np.ones((1, 1)), steps, np.empty((0, 1)))
    _fill(sums, groups, length, batch, np.ones(1, np.float32), np.empty(0, np.uint16), incident)
    return np.moveaxis(sums[:, :, :, 0, 0], 2, 0)


@ci_slow
def test_products_of_batches_are_sums_over_pairs_of_events() -> None:
    """The product of a batch with all batches of the other end, in a step: how many pairs of events fall into it."""
    windows = _windows()
    rng = np.random.default_rng(0)
    outgoing, incident = rng.uniform(0.0, WINDOWS[-1], (2, EVENTS))
    batch = rng.integers(BATCHES, size=EVENTS)
    out = np.zeros((BATCHES, 1, 1, STEPS), np.float32)
    total = _histogram(windows.steps, incident, np.zeros(EVENTS, int), True).sum(axis=0)
    own = _histogram(windows.steps, outgoing, batch, False)
    add_products(windows, own[None], total[None], out)

    lengths, middle = outgoing[:, None] + incident, 0.5 * (WINDOWS[1:] + WINDOWS[:-1])
    assert len(windows.stretches) == 2
    for s, stretch in enumerate(windows.stretches):
        h, offset = windows.steps.step[s], windows.steps.offset[s]
        steps = np.floor(outgoing / h + 0.25).astype(int)[:, None]
        steps = steps + np.floor(np.maximum(incident - offset, 0.0) / h + 0.25).astype(int)
        steps -= round((WINDOWS[stretch.bins.start] - offset) / h)  # of those before the stretch
        kept = stretch.bins.stop - stretch.bins.start
        for k in range(BATCHES):
            of_k = steps[batch == k].ravel()
            expected = np.bincount(of_k[(of_k >= 0) & (of_k < kept)], minlength=kept)
            found = out[k, 0, 0, stretch.bins]
            np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4 * expected.max())
        # Lengths of the paths of a step: in the mean its middle, to a tenth of the step.
        for n in range(kept):
            assert abs(lengths[steps == n].mean() - middle[stretch.bins.start + n]) < 0.1 * h


def _random(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.gamma(2.0, 1.0, shape).astype(np.float32)


def _crossed(rng: np.random.Generator, p: int, q: int, groups: int) -> Crossed:
    return Crossed(_random(rng, groups, p, q, STEPS), _random(rng, groups, groups, p, q, STEPS))


def _raised(of_batches: np.ndarray) -> np.ndarray:
    """E(k) of what batches of both ends contribute to the sum of both directions (BATCHES, A, B, T)."""
    whole = 0.5 * of_batches.sum(axis=0)
    return np.asarray(whole + RAISED * (BATCHES * of_batches - 2.0 * whole), np.float32)


def _products(rng: np.random.Generator, a: int, b: int, groups: int = 0) -> BatchProducts:
    """Of both directions, and of what is below the batches of either end."""
    below = moment_rows(groups) - BATCHES
    of_ends = _random(rng, below, a, b, STEPS), _random(rng, below, b, a, STEPS)
    crossed = _crossed(rng, a, b, groups), _crossed(rng, b, a, groups)
    within = np.zeros((2, a, b, STEPS), np.float32)
    return BatchProducts(_raised(_random(rng, BATCHES, a, b, STEPS)), within, *of_ends, *crossed)


@ci_slow
def test_energies_of_batches_are_those_of_the_definition() -> None:
    """E_k = E (⟨V_k, F⟩ / E + ⟨V, F_k⟩ / E − 1 / K), bin by bin; in a step without energy all batches have E / K."""
    rng, (a, b, bins, windows) = np.random.default_rng(1), (2, 3, 40, 5)
    of_batches = rng.gamma(2.0, 1.0, (BATCHES, a, b, STEPS))
    of_batches[:, 0, 2, 7] = 0.0
    products = _products(rng, a, b)._replace(raised=_raised(of_batches))
    energies = PairEnergies(rng.random((a, b, bins)), rng.random((b, a, bins)), rng.random(bins))
    window = rng.integers(windows, size=bins)
    places = BinSteps(rng.integers(STEPS, size=bins), window, np.zeros(bins), np.zeros(STEPS))
    pairs = np.argwhere(np.ones((a, b), bool))
    batches = np.zeros((a, b, BATCHES, windows))
    add_batches(0, len(pairs), pairs, energies, products, places, batches, _scratch(BATCHES))

    expected = np.zeros_like(batches)
    for i, j in pairs:
        for t in range(bins):
            energy = 0.5 * (energies.forward[i, j, t] + energies.backward[j, i, t]) * energies.restore[t]
            of_k = of_batches[:, i, j, places.step[t]]
            share = np.full(BATCHES, 1.0 / BATCHES)
            if (whole := 0.5 * of_k.sum()) > 0.0:
                share = of_k / whole - 1.0 / BATCHES
            expected[i, j, :, places.window[t]] += energy * share
    np.testing.assert_allclose(batches, expected, rtol=1e-4, atol=1e-5 * expected.max())
    mean = 0.5 * (energies.forward + energies.backward.swapaxes(0, 1)) * energies.restore
    total = mean @ np.eye(windows)[places.window]
    np.testing.assert_allclose(batches.sum(axis=2), total, rtol=1e-5)


@ci_slow
def test_batches_differ_by_as_much_more_as_groups_hide() -> None:
    """The variance of a pair's energy by batches is larger by what both ends have within groups, of both directions;
    energies, and steps in which nothing is hidden, stay."""
    rng, bins = np.random.default_rng(4), STEPS
    plain = _products(rng, 1, 1)
    within = _random(rng, 2, 1, 1, STEPS)
    within[..., 3] = 0.0
    energies = PairEnergies(rng.random((1, 1, bins)), rng.random((1, 1, bins)), np.ones(bins))
    places = BinSteps(np.arange(bins), np.arange(bins), np.zeros(bins), np.zeros(STEPS))
    found = []
    for products in (plain, plain._replace(within=within)):
        batches = np.zeros((1, 1, BATCHES, bins))
        add_batches(
            0, 1, np.zeros((1, 2), np.int64), energies, products, places, batches, _scratch(BATCHES)
        )
        found.append(batches[0, 0])
    before, after = found
    np.testing.assert_allclose(after.sum(axis=0), before.sum(axis=0), rtol=1e-5)
    np.testing.assert_allclose(after[:, 3], before[:, 3])
    mean = 0.5 * (energies.forward + energies.backward)[0, 0]
    both = plain.raised[:, 0, 0].mean(axis=0).astype(float)  # of both directions
    hidden = (mean / both) ** 2 * within[:, 0, 0].sum(axis=0)
    more = BATCHES * (after.var(axis=0, ddof=1) - before.var(axis=0, ddof=1))
    np.testing.assert_allclose(more, hidden, rtol=1e-3, atol=1e-6 * hidden.max())


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
    # Both directions are alike: what a batch contributes is twice what it does to one.
    of_batches = 2.0 * (v * f.sum(axis=1, keepdims=True) + f * v.sum(axis=1, keepdims=True))
    raised = _raised(np.repeat(of_batches.T[:, :, None, None], STEPS, axis=3))
    energies = PairEnergies(energy[:, None, None], energy[None, :, None], np.ones(1))
    places = BinSteps(np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1), np.zeros(STEPS))
    pairs = np.column_stack([np.arange(runs), np.zeros(runs, np.int64)])
    batches = np.zeros((runs, 1, BATCHES, 1))
    products = _products(np.random.default_rng(3), runs, 1)._replace(raised=raised)
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
    """Of both directions together: n̄ = (⟨V^m, F⟩ + ⟨V, F^m⟩) / ⟨V, F⟩, what is taken less the product of both
    ends, products of counts with those across both ends. On a line between the mean lengths of steps in which anything
    arrives, and on beyond the first and the last; ln of what is left; covariances for products, less those of lengths that rounding
    puts into one step."""
    rng, (a, b, groups) = np.random.default_rng(5), (2, 2, 3)
    rows = BATCHES + count_rows(groups)
    products = _products(rng, a, b, groups)
    lengths = 20.0 + np.cumsum(rng.uniform(3.0, 9.0, STEPS))  # m, of the mean path
    products.raised[:, 0, 1, 7] = 0.0
    whole = products.raised.mean(axis=0)
    for of_end, part, of_both in (
        (products.of_a, 0.3, whole),
        (products.of_b, 0.7, whole.swapaxes(0, 1)),
    ):
        of_end[2 * groups : rows - BATCHES] *= 60.0
        of_end[-1] = part * of_both * lengths
    position = np.array([-0.4, 0.0, 2.25, 6.5, 7.25, 8.5, STEPS - 0.5])
    at = np.interp(position, np.arange(STEPS), lengths) + 4.0 * (
        np.minimum(position, 0.0) + np.maximum(position - STEPS + 1, 0.0)
    )
    variance, bins = rng.uniform(0.5, 2.0, STEPS), len(position)
    steps = np.clip(np.rint(position), 0, STEPS - 1).astype(np.int64)
    places = BinSteps(steps, np.arange(bins), at, variance)
    energies = PairEnergies(np.ones((a, b, bins)), np.ones((b, a, bins)), np.ones(bins))
    batches = np.zeros((a, b, rows, bins))
    pairs = np.argwhere(np.ones((a, b), bool))
    add_batches(0, len(pairs), pairs, energies, products, places, batches, _scratch(rows + 1))
    m, k = np.tril_indices(groups)
    for i, j in pairs:
        total = products.of_a[:, i, j].astype(float) + products.of_b[:, j, i].astype(float)
        weight = products.raised[:, i, j].astype(float).mean(axis=0)
        for way, p, q in ((products.there, i, j), (products.back, j, i)):
            total[groups : 2 * groups] -= way.taken[:, p, q]
            crossed = way.counts[:, :, p, q]
            total[2 * groups : -1] += crossed[k, m] + crossed[m, k]
        known = np.flatnonzero(weight > 0.0)
        assert (7 in known) == ((i, j) != (0, 1)) and len(known) >= STEPS - 1
        total = total[:, known] / weight[known]
        np.testing.assert_allclose(total[-1], lengths[known], rtol=1e-4)
        low = np.clip(np.searchsorted(total[-1], at, "right") - 1, 0, len(known) - 2)
        gap = total[-1, low + 1] - total[-1, low]
        place = (at - total[-1, low]) / gap
        means, total = total[:groups], total[:-1]
        total[2 * groups :] -= means[m] * means[k]
        line = total[:, low] + place * (total[:, low + 1] - total[:, low])
        course = (1.0 - place) * variance[known[low]] + place * variance[known[low + 1]]
        course = np.maximum(course, 0.0) / gap**2
        left = np.maximum(1.0 - total[groups : 2 * groups], 1e-6)
        slope = np.log(left[:, low + 1] / left[:, low])
        line[groups : 2 * groups] = 1.0 - left[:, low] * np.exp(place * slope) / (
            1.0 + 0.5 * course * slope**2
        )
        step = means[:, low + 1] - means[:, low]
        line[:groups] = np.maximum(line[:groups], 0.0)
        line[2 * groups :] += line[m] * line[k] - course * step[m] * step[k]
        keeps_more = (np.arange(len(line)) // groups == 1)[
            :, None
        ]  # what anchors take may be less than nothing
        line = np.where(keeps_more, line, np.maximum(line, 0.0))
        np.testing.assert_allclose(batches[i, j, BATCHES:], line, rtol=1e-4, atol=1e-4)
