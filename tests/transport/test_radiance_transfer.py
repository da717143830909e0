"""Radiance transfer against sums over all pairs of events, in plain Python: equation (2) of the package, term by term.

Reflections, transfer subpaths and patches are drawn at random: no scene is traced.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest

from soundspaces_sim.core.numerics.axes import spherical_harmonics
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.transport.radiance_transfer.arrival_directions import deposit_transfer
from soundspaces_sim.transport.radiance_transfer.batch_variance import (
    RAISED,
    make_groups,
    make_window_steps,
    make_within,
    moment_rows,
)
from soundspaces_sim.transport.radiance_transfer.decay_compensation import compensate_decay, fit_decay
from soundspaces_sim.transport.radiance_transfer.first_reflections import (
    Reflections,
    draw_continuations,
)
from soundspaces_sim.transport.radiance_transfer.pair_transfer import Both, Endpoints, transfer
from soundspaces_sim.transport.radiance_transfer.patch_histograms import DirectedPatches
from soundspaces_sim.transport.radiance_transfer.plan import TransferPlan
from soundspaces_sim.transport.radiance_transfer.time_steps import make_coarse, make_stretches
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import (
    CHUNK,
    TransferSubpaths,
)
from soundspaces_sim.transport.tables import BATCHES

GROUPS = 3  # of materials
PATCHES, BANDS, SUBPATHS, C = CHUNK + 44, 2, 3, 343.0  # patches of two chunks
KEPT = np.array([[0.9, 0.5], [0.25, 1.0], [0.7, 0.6]])  # (GROUPS, BANDS) of a reflection, at an anchor
WINDOWS = C * np.concatenate([np.arange(0.05, 0.0999, 0.01), np.arange(0.1, 0.2001, 0.025)])  # m
EDGES = C * np.concatenate([np.arange(0.05, 0.0999, 0.0025), np.arange(0.1, 0.2001, 0.005)])  # m


class Event(NamedTuple):
    """What a subpath of a point leaves on a patch."""

    batch: int
    patch: int
    length: float
    energy: np.ndarray  # (b,)
    subpath: int  # -1 beyond the first reflection
    direction: np.ndarray  # (3,)
    counts: np.ndarray  # (groups,) reflections before it in F, itself included in V


def _transfer_subpaths(rng: np.random.Generator) -> TransferSubpaths:
    """Each leaves up to two events, most on a few patches, so that pairs of events meet."""
    chunks = -(-PATCHES // CHUNK)
    rows: list[tuple[float, ...]] = []
    starts = np.empty((BATCHES, PATCHES * chunks + 1), np.int64)
    for m in range(BATCHES):
        for c, chunk in itertools.product(range(PATCHES), range(chunks)):
            starts[m, c * chunks + chunk] = len(rows)
            size = min(PATCHES - chunk * CHUNK, 6)
            patches = rng.integers(size, size=rng.integers(0, 2)) + chunk * CHUNK
            rows += [(p, rng.uniform(1.0, 50.0), *rng.random(BANDS)) for p in patches]
        starts[m, -1] = len(rows)
    table = np.array(rows)
    length, energy = table[:, 1].astype(np.float32), table[:, 2:].astype(np.float32)
    counts = np.random.default_rng(7).integers(0, 9, (len(table), GROUPS)).astype(np.uint16)
    patch = table[:, 0].astype(np.int32)
    return TransferSubpaths(starts, patch, length, energy, counts, np.zeros(BANDS), np.ones(BANDS))


def _endpoints(rng: np.random.Generator, places: np.ndarray, subpaths: TransferSubpaths) -> Endpoints:
    """Three to six first reflections in every batch of a point's subpaths."""
    points, places = len(places), np.asarray(places, float)
    counts = rng.integers(3, 7, (points, BATCHES))
    total = int(counts.sum())
    ends = np.concatenate([[0], np.cumsum(counts)])
    first = ends[np.arange(points)[:, None] * BATCHES + np.arange(BATCHES + 1)]
    patch = (rng.integers(6, size=total) + rng.integers(2, size=total) * CHUNK).astype(np.int32)
    direction = rng.normal(size=(points, BATCHES, SUBPATHS, 3)).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=3, keepdims=True)
    others = np.random.default_rng(8)
    reflections = Reflections(
        first,
        patch,
        rng.uniform(1.0, 40.0, total).astype(np.float32),
        rng.integers(SUBPATHS, size=total).astype(np.int32),
        rng.random((total, BANDS)).astype(np.float32),
        others.integers(0, 4, (total, GROUPS)).astype(np.uint16),
        others.integers(-1, GROUPS, total).astype(np.int8),
        direction,
    )
    keys = point_keys(places, 0)
    drawn = draw_continuations(reflections, keys, SUBPATHS, BATCHES)
    return Endpoints(reflections, drawn, subpaths, keys)


def _plan(rng: np.random.Generator) -> tuple[TransferPlan, TransferSubpaths]:
    weight = rng.uniform(0.5, 2.0, (PATCHES, BANDS))
    factor = (4.0 * weight).astype(np.float32)
    steps, stretches = make_stretches(EDGES)
    windows = make_window_steps(WINDOWS)
    groups = make_groups(rng.integers(4, size=PATCHES), weight, windows.steps, KEPT)
    subpaths = _transfer_subpaths(rng)
    plan = TransferPlan(
        steps=steps,
        stretches=stretches,
        coarse=make_coarse(steps, EDGES, C),
        groups=groups,
        windows=windows,
        within=make_within(groups, weight, steps),
        factor=factor,
        directed=DirectedPatches(np.arange(PATCHES), np.arange(PATCHES), factor),
        first_bin=2,
        edges=EDGES,
        restore=rng.uniform(0.5, 1.0, (len(EDGES) - 1, BANDS)),
    )
    return plan, subpaths


def _incident(end: Endpoints, i: int) -> Iterator[Event]:
    """F of point i: its first reflections."""
    reflections = end.reflections
    for k in range(BATCHES):
        for r in range(reflections.start[i, k], reflections.start[i, k + 1]):
            subpath = int(reflections.subpath[r])
            yield Event(
                k, int(reflections.patch[r]), float(reflections.length[r]),
                reflections.energy[r].astype(float), subpath, reflections.direction[i, k, subpath],
                reflections.counts[r].astype(int),
            )  # fmt: skip


def _own(reflections: Reflections, r: int) -> np.ndarray:
    """(groups,) the reflection `r` itself."""
    own: np.ndarray = (np.arange(GROUPS) == reflections.group[r]).astype(int)
    return own


def _outgoing(end: Endpoints, i: int) -> Iterator[Event]:
    """V of point i: F, and what transfer subpaths make of the reflections that are carried on."""
    reflections, drawn, subpaths = end.reflections, end.drawn, end.subpaths
    first = range(reflections.start[i, 0], reflections.start[i, -1])
    for r, event in zip(first, _incident(end, i), strict=True):
        yield event._replace(counts=event.counts + _own(reflections, r))
    chunks = (subpaths.start.shape[1] - 1) // PATCHES
    for k, d in itertools.product(range(BATCHES), range(drawn.reflection.shape[2])):
        r, m = drawn.reflection[i, k, d], drawn.population[i, k, d]
        assert drawn.subpath[i, k, d] == reflections.patch[r]  # of shared ones
        first, last = subpaths.start[m, reflections.patch[r] * chunks + np.array([0, chunks])]
        for e in range(first, last):
            yield Event(
                k, int(subpaths.patch[e]), float(reflections.length[r]) + float(subpaths.length[e]),
                drawn.scale[i, k, d] * reflections.energy[r].astype(float) * subpaths.energy[e],
                -1, np.zeros(3), reflections.counts[r] + _own(reflections, r) + subpaths.counts[e],
            )  # fmt: skip


def _pairs(of: Endpoints, i: int, to: Endpoints, j: int) -> Iterator[tuple[Event, Event]]:
    """Events of two points on one patch."""
    on_patch: dict[int, list[Event]] = {}
    for event in _outgoing(of, i):
        on_patch.setdefault(event.patch, []).append(event)
    for f in _incident(to, j):
        yield from ((v, f) for v in on_patch.get(f.patch, []))


def _is_own(v: Event, f: Event) -> bool:
    """Whether two events are of one subpath, if their points are the same."""
    return v.subpath >= 0 and (v.batch, v.subpath) == (f.batch, f.subpath)


def _energy(plan: TransferPlan, of: Endpoints, i: int, to: Endpoints, j: int) -> np.ndarray:
    """(b, late bins): sum over c of (4 / R_c) V(c) ∗ F(c), a pair of events at a time."""
    out, steps = np.zeros((BANDS, len(EDGES) - 1)), plan.steps
    for v, f in _pairs(of, i, to, j):
        if of.keys[i] == to.keys[j] and _is_own(v, f):
            continue
        energy = v.energy * f.energy * plan.factor[f.patch]
        for s, stretch in enumerate(plan.stretches):
            h, offset = steps.step[s], steps.offset[s]
            step = int(v.length / h + 0.25) + int(max(f.length - offset, 0.0) / h + 0.25)
            first = int(steps.steps[s]) - (stretch.bins.stop - stretch.bins.start)
            if first <= step < steps.steps[s]:
                out[:, stretch.bins.start + step - first] += energy
    return out


PLACES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def case() -> tuple[TransferPlan, Endpoints, Endpoints, Both]:
    """From two points to three; the second of them is the last of these, with the same subpaths."""
    rng = np.random.default_rng(0)
    plan, subpaths = _plan(rng)
    to = _endpoints(rng, PLACES, subpaths)
    of = _some(to, slice(1, 3))
    return plan, of, to, transfer(plan, of, to)


def _some(end: Endpoints, rows: slice) -> Endpoints:
    """Some of the points, with the columns of all."""
    reflections = end.reflections._replace(
        start=end.reflections.start[rows], direction=end.reflections.direction[rows]
    )
    drawn = type(end.drawn)(*(x[rows] for x in end.drawn))
    return Endpoints(reflections, drawn, end.subpaths, end.keys[rows])


Case = tuple[TransferPlan, Endpoints, Endpoints, Both]


def test_energies_are_sums_over_pairs_of_events(case: Case) -> None:
    """In two stretches of bins and two chunks of patches; of a point to itself without products of a subpath with
    itself."""
    plan, of, to, found = case
    for i, j in itertools.product(range(of.points), range(to.points)):
        expected = _energy(plan, of, i, to, j)
        assert (expected > 0.0).mean() > 0.9
        atol = 1e-4 * expected.max()
        np.testing.assert_allclose(found.there.energy[:, i, j], expected, rtol=1e-4, atol=atol)
    own = sum(_is_own(v, f) for v, f in _pairs(of, 0, to, 1))
    assert own > 0 and of.keys[0] == to.keys[1]


def _taken(counts: np.ndarray) -> np.ndarray:
    return np.asarray(1.0 - KEPT ** counts[:, None])


def _of_groups(counts: np.ndarray) -> np.ndarray:
    """(count rows, b)."""
    m, k = np.tril_indices(len(counts))
    of_all = np.concatenate([counts, counts[m] * counts[k]]).astype(float)[:, None].repeat(BANDS, axis=1)
    return np.insert(of_all, [len(counts)] * len(counts), _taken(counts), axis=0)


def _below_batches(event: Event) -> np.ndarray:
    """(rows below the batches, b) of counts, and the length."""
    return np.vstack([_of_groups(event.counts), np.full((1, BANDS), event.length)])


def _steps(plan: TransferPlan, outgoing: float, incident: float) -> Iterator[int]:
    """Steps of both widths in which a path of these lengths, m, is counted: one, or none in a stretch that it is too
    short or too long for, and none or two next to where the width changes."""
    windows = plan.windows
    for s, stretch in enumerate(windows.stretches):
        h, offset = windows.steps.step[s], windows.steps.offset[s]
        kept = stretch.bins.stop - stretch.bins.start
        row = int(outgoing / h + 0.25) + int(max(incident - offset, 0.0) / h + 0.25)
        row -= stretch.rows.stop - stretch.rows.start - kept
        if 0 <= row < kept:
            yield stretch.bins.start + row


def test_products_of_batches_are_sums_over_pairs_of_events(case: Case) -> None:
    """Both directions, between groups of patches, in steps of two widths: with the weight of a batch raised at both ends;
    and times counts n of reflections, 1 - kept^n and products of two, of V, of F and across both; and times
    lengths."""
    plan, of, to, found = case
    i, j = 1, 0
    products, (rows, steps) = found.products, (moment_rows(GROUPS), len(WINDOWS) - 1)
    raised = np.zeros((BANDS, BATCHES, steps))
    of_a, of_b = np.zeros((2, BANDS, rows - BATCHES, steps))
    directions = (of, i, to, j, of_a, of_b, products.there), (to, j, of, i, of_b, of_a, products.back)
    chunk = np.arange(PATCHES) // CHUNK
    place = list(zip(chunk, plan.groups.group, strict=True))
    weight = (1.0 - RAISED) + RAISED * BATCHES * np.eye(BATCHES)
    for start, p, end, q, by_outgoing, by_incident, ways in directions:
        taken, crossed = np.zeros((GROUPS, BANDS, steps)), np.zeros((GROUPS, GROUPS, BANDS, steps))
        incident = list(_incident(end, q))
        for v in _outgoing(start, p):
            for f in incident:
                if place[v.patch] != place[f.patch]:
                    continue
                for step in _steps(plan, v.length, f.length):
                    energy = v.energy * f.energy * plan.groups.factor[f.patch]
                    raised[:, :, step] += np.outer(energy, weight[v.batch] * weight[f.batch])
                    by_incident[:, :, step] += energy[:, None] * _below_batches(f).T
                    by_outgoing[:, :, step] += energy[:, None] * _below_batches(v).T
                    both = _taken(v.counts) * _taken(f.counts)
                    taken[:, :, step] += both * energy
                    crossed[:, :, :, step] += np.multiply.outer(np.outer(f.counts, v.counts), energy)
        for expected, across in (
            (taken.swapaxes(0, 1), ways.taken[:, :, p, q]),
            (np.moveaxis(crossed, 2, 0), ways.counts[:, :, :, p, q]),
        ):
            np.testing.assert_allclose(across, expected, rtol=1e-3, atol=1e-4 * expected.max())
    for expected, by_batch in (
        (raised, products.raised[:, :, i, j]),
        (of_a, products.of_a[:, :, i, j]),
        (of_b, products.of_b[:, :, j, i]),
    ):
        np.testing.assert_allclose(by_batch, expected, rtol=1e-3, atol=1e-4 * expected.max())


def _spread_in_groups(
    plan: TransferPlan, events: list[Event], incident: bool, s: int
) -> tuple[np.ndarray, np.ndarray]:
    """(groups, steps of stretch s, b), both: variances of sums over batches, and the mean square by which the patches of
    a group differ. Events are in steps of batches, of patches by way of bins."""
    wide, fine = plan.windows.steps, plan.steps
    f = int((fine.step * fine.steps > (wide.steps[s] - 0.5) * wide.step[s]).argmax())
    chunk = np.arange(PATCHES) // CHUNK
    place = np.unique(np.stack([chunk, plan.groups.group], axis=1), axis=0, return_inverse=True)[
        1
    ].ravel()
    steps, strength = int(wide.steps[s]), 4.0 / plan.factor.astype(float)
    of_batch = np.zeros((BATCHES, place.max() + 1, steps, BANDS))
    of_patch = np.zeros((PATCHES, steps, BANDS))
    for e in events:
        offset = wide.offset[s] if incident else 0.0
        row = int(max(e.length - offset, 0.0) / wide.step[s] + 0.25)
        if row < steps:
            of_batch[e.batch, place[e.patch], row] += e.energy
        offset = fine.offset[f] if incident else 0.0
        bin_row = int(max(e.length - offset, 0.0) / fine.step[f] + 0.25)
        middle = (bin_row + 0.25) * fine.step[f] + (fine.offset[f] - wide.offset[s] if incident else 0.0)
        row = int(max(middle, 0.0) / wide.step[s] + 0.25)
        if bin_row < fine.steps[f] and row < steps:
            of_patch[e.patch, row] += e.energy
    of_group, squares = np.zeros((2, *of_batch.shape[1:]))
    whole = np.zeros((len(of_group), BANDS))
    np.add.at(whole, place, strength)
    np.add.at(of_group, place, of_patch)
    np.add.at(squares, place, of_patch**2 / strength[:, None])
    apart = squares / whole[:, None] - (of_group / whole[:, None]) ** 2  # of X_c / R_c, by R
    variance = BATCHES * of_batch.var(axis=0, ddof=1)
    return variance, apart


def test_what_groups_hide_is_variances_times_how_patches_differ(case: Case) -> None:
    """Step by step, of events of either end, as V and as F."""
    plan, of, to, found = case
    i, j = 1, 0
    ends = [
        (list(_outgoing(of, i)), list(_incident(of, i))),
        (list(_outgoing(to, j)), list(_incident(to, j))),
    ]
    hidden = found.products.within[:, :, i, j].sum(axis=1)
    for s, stretch in enumerate(plan.windows.stretches):
        steps = int(plan.windows.steps.steps[s])
        expected = np.zeros((BANDS, steps))
        for of_own, of_other in (ends, ends[::-1]):
            for incident in (False, True):
                variance, _ = _spread_in_groups(plan, of_own[int(incident)], incident, s)
                _, apart = _spread_in_groups(plan, of_other[int(not incident)], not incident, s)
                for b in range(BANDS):
                    for v, d in zip(variance[:, :, b], apart[:, :, b], strict=True):
                        expected[b] += np.convolve(v, d)[:steps]
        kept = stretch.bins.stop - stretch.bins.start
        expected = expected[:, steps - kept :]
        assert (expected > 0.0).all()
        atol = 1e-4 * expected.max()
        np.testing.assert_allclose(hidden[:, stretch.bins], expected, rtol=1e-3, atol=atol)


def test_points_with_themselves_have_what_they_have_with_others(case: Case) -> None:
    """To the bit: of all pairs of one side, and of the same points on two sides."""
    plan, _, to, _ = case
    same, two = transfer(plan, to, to), transfer(plan, to, _some(to, slice(None)))
    for one, other in ((two.there, two.back), (same.there, two.there)):
        for x, y in zip(one, other, strict=True):
            np.testing.assert_array_equal(x, y)
    np.testing.assert_array_equal(same.products.of_a, two.products.of_a)
    np.testing.assert_array_equal(same.products.of_a, two.products.of_b)
    i, j = np.triu_indices(to.points)
    for name in ("raised", "within"):
        one, other = getattr(same.products, name), getattr(two.products, name)
        np.testing.assert_array_equal(one[..., i, j, :], other[..., i, j, :])
        np.testing.assert_array_equal(other[..., i, j, :], other[..., j, i, :])
    assert same.there is same.back and same.products.of_a.any()


def test_directions_are_means_over_pairs_of_events(case: Case) -> None:
    """Each bin has the moments of its coarse step, relative to the step's energy: means of Y_n over pairs of events."""
    plan, of, to, (forward, backward, _) = case
    table = np.zeros((of.points, to.points, plan.first_bin + len(EDGES) - 1, 9, BANDS), np.float32)
    deposit_transfer(plan, forward, backward, to.reflections, table)
    coarse, fine = plan.coarse, plan.steps
    i, j, shape = 1, 0, (int(coarse.of_bin.max()) + 1, 9, BANDS)
    moments, first = np.zeros(shape), coarse.steps.rows - shape[0]
    h, wide, shift = fine.step[-1], coarse.steps.step[0], coarse.steps.incident_shift
    for v, f in _pairs(of, i, to, j):
        step = int(v.length / h + 0.25) // coarse.ratio
        step += int(max(f.length - coarse.steps.offset[0], 0.0) / wide + shift) - first
        if 0 <= step < len(moments):
            energy = v.energy * f.energy * plan.factor[f.patch]
            moments[step] += spherical_harmonics(f.direction)[:, None] * energy
    mean = 0.5 * (forward.energy[:, i, j] + backward.energy[:, j, i])
    expected = (mean.T * plan.restore)[:, None] * (moments / moments[:, :1])[coarse.of_bin]
    np.testing.assert_allclose(table[i, j, plan.first_bin :], expected, atol=1e-4 * expected.max())
    assert not table[:, :, : plan.first_bin].any()


def test_drawn_reflections_stand_for_all_of_their_batch() -> None:
    """Systematic sampling: each is drawn n p times, rounded up or down, and the sum of scale times energy is that of
    the batch in the mean over 2,000 points (4 standard errors of at most 1 %); batch k follows subpaths k mod K."""
    rng, points, count, subpaths = np.random.default_rng(1), 2000, 5, 4 * BATCHES
    some = _transfer_subpaths(np.random.default_rng(0))
    one = _endpoints(rng, PLACES[:1], some).reflections
    reflections = one._replace(start=np.repeat(one.start, points, axis=0))
    keys = point_keys(rng.random((points, 3)), 0)
    drawn = draw_continuations(reflections, keys, count, subpaths)
    for k in range(BATCHES):
        rows = np.arange(one.start[0, k], one.start[0, k + 1])
        energy = one.energy[rows].astype(float)
        probability = (energy / energy.sum(axis=0)).mean(axis=1)
        times = (drawn.reflection[:, k, :, None] == rows).sum(axis=1)
        assert np.all((times >= np.floor(count * probability)) & (times <= np.ceil(count * probability)))
        np.testing.assert_allclose(
            times @ (1.0 / (count * probability)), (drawn.scale[:, k]).sum(axis=1), rtol=1e-5
        )
        sums = (times / (count * probability)) @ energy
        error = sums.std(axis=0, ddof=1) / np.sqrt(points)
        assert np.all(error < 0.01 * energy.sum(axis=0))
        assert np.all(np.abs(sums.mean(axis=0) - energy.sum(axis=0)) < 4.0 * error)
        assert (
            np.all(drawn.population[:, k] % BATCHES == k)
            and drawn.population[:, k].max() == subpaths - BATCHES + k
        )


def test_decay_compensation_makes_energies_even() -> None:
    """Energies exp(-d l) of two bands: the decay is found, up to where they are e^60 below the greatest."""
    length = np.arange(0.05, 500.0, 0.1).astype(np.float32)
    rates = np.array([0.05, 0.4])
    energy = np.exp(-rates * length[:, None].astype(float)).astype(np.float32)
    decay, reach = fit_decay(length, energy)
    np.testing.assert_allclose(decay, rates, rtol=0.01)
    assert reach[0] == pytest.approx(500.0, abs=3.0) and reach[1] == pytest.approx(60.0 / 0.4, abs=5.0)
    compensated = energy.copy()
    compensate_decay(length, decay, reach, compensated)
    expected = energy * np.exp(decay * length[:, None]) * (length[:, None] <= reach)
    np.testing.assert_allclose(compensated, expected, rtol=1e-5)
    inside = length[:, None] <= reach
    assert (
        compensated[inside].min() > 0.2
        and compensated[inside].max() < 5.0
        and not compensated[~inside].any()
    )
