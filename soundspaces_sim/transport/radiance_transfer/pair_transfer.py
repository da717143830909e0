"""Energies between all pairs of points of two sides, both ways: E = sum over c of (4 / R_c) V_p(c) ∗ F_q(c).

Patches are taken a chunk at a time (`patch_histograms`). A pair's bits depend on no other pair (`convolution`).

Where p and q are the same point, V and F have common subpaths. The products of a subpath with itself are left
out, so that the remaining pairs are of independent subpaths, as between two points.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import at_once, over_rows, rows_of_thread, thread_count
from soundspaces_sim.core.profile import count, stage
from soundspaces_sim.transport.radiance_transfer.batch_moments import BatchProducts
from soundspaces_sim.transport.radiance_transfer.batch_products import (
    ByBatch,
    add_all_products,
    no_products,
)
from soundspaces_sim.transport.radiance_transfer.convolution import accumulate, transform
from soundspaces_sim.transport.radiance_transfer.first_reflections import (
    Continuations,
    Reflections,
    draw_continuations,
    patches_drawn,
    with_own_populations,
)
from soundspaces_sim.transport.radiance_transfer.patch_histograms import (
    ChunkAxes,
    Histograms,
    OwnPairScratch,
    PointHistograms,
    fill_incident,
    fill_outgoing,
    fill_own,
)
from soundspaces_sim.transport.radiance_transfer.plan import TransferPlan
from soundspaces_sim.transport.radiance_transfer.prepared import (
    late_decay,
    pilot_events,
    transfer_subpaths,
)
from soundspaces_sim.transport.radiance_transfer.shared_and_own import (
    own_continuations,
    trace_own_subpaths,
)
from soundspaces_sim.transport.radiance_transfer.time_steps import coarse_rows
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import CHUNK, TransferSubpaths
from soundspaces_sim.transport.tables import BATCHES
from soundspaces_sim.transport.tile import Walks

ROUNDING = 1e-5  # of the greatest value: what rounding leaves where nothing arrives
COLUMNS = 160  # points on one side whose products with all of the other are held at once
# Points whose histograms are filled in one call, if each of several threads has so many calls.
_POINTS, _CALLS = 4, 4
_THREADS = 4  # that transforms and products of one band keep busy


class Endpoints(NamedTuple):
    """The N points of one side: their first diffuse reflections, and which transfer subpaths carry on."""

    reflections: Reflections
    drawn: Continuations
    subpaths: TransferSubpaths
    keys: np.ndarray  # (N,) uint64 of the points' random streams

    @property
    def points(self) -> int:
        """N."""
        return len(self.keys)


class Transfer(NamedTuple):
    """From P points (outgoing) to Q points (incident). b bands; energies are decay-compensated."""

    energy: np.ndarray  # (b, P, Q, late bins)
    directed: np.ndarray  # (b, P, coarse rows, D) outgoing histograms on directed patches


class Both(NamedTuple):
    """Between A and B points, both ways; of points with themselves both are the same."""

    there: Transfer  # a -> b
    back: Transfer
    products: BatchProducts


class _Workspace(NamedTuple):
    """Arrays that are filled anew for every chunk of patches and either direction."""

    outgoing: np.ndarray  # (b, P, rows, columns)
    incident: np.ndarray  # (b, Q, rows, columns)
    # of as many bands as are done side by side: `bands_at_once`
    outgoing_spectra: np.ndarray  # (bands, R P columns) of the stretch with the largest R
    incident_spectra: np.ndarray  # (bands, R Q columns)
    products: np.ndarray  # (bands, R P Q) of as many of the Q as are held at once

    def turned(self) -> _Workspace:
        """The same memory, for Q outgoing and P incident points."""
        outgoing, incident, of_outgoing, of_incident, products = self
        return _Workspace(incident, outgoing, of_incident, of_outgoing, products)


def make_endpoints(walks: Walks) -> Endpoints:
    """Of what the subpaths of a side have left: `walks.once(make_endpoints)`."""
    model, reflections = walks.side.model, walks.reflections
    assert reflections is not None  # `requires`: specular subpaths run before
    world, keys, decay = model.world, walks.side.ends.keys, model.once(late_decay)
    count = world.settings.specular // BATCHES  # as many are carried on as there are subpaths
    if model.config.radiance_transfer.subpaths != "own":
        subpaths = model.once(transfer_subpaths)
        drawn = draw_continuations(reflections, keys, count, len(subpaths.start))
        return Endpoints(reflections, drawn, subpaths, keys)
    count = own_continuations(world)
    drawn = with_own_populations(draw_continuations(reflections, keys, count, BATCHES))
    with stage("own transfer subpaths"):
        patch = patches_drawn(reflections, drawn)
        subpaths = trace_own_subpaths(world, patch, keys, decay, model.first.once(pilot_events))
    return Endpoints(reflections, drawn, subpaths, keys)


def transfer(plan: TransferPlan, a: Endpoints, b: Endpoints) -> Both:
    """Energies and products by batch between points a and points b; `a is b` for all pairs of one side."""
    there = _nothing(plan, a, b)
    back = there if a is b else _nothing(plan, b, a)
    products = no_products(plan.windows, plan.material_groups, (plan.bands, a.points, b.points), a is b)
    workspace = _make_workspace(plan, a.points, b.points)
    for chunk in range(len(plan.groups.count)):
        of_a = _by_batch(plan, a, chunk)
        of_b = of_a if a is b else _by_batch(plan, b, chunk)
        _add_chunk(plan, a, b, chunk, workspace, there, (of_a, of_b))
        if a is not b:
            _add_chunk(plan, b, a, chunk, workspace.turned(), back, (of_b, of_a))
        with stage("products by batch"):
            add_all_products(plan.windows, of_a, of_b, products)
    for of, to, found in [(a, b, there)] if a is b else [(a, b, there), (b, a, back)]:
        _subtract_own(plan, of, to, found.energy)
        _drop_rounding(plan, found.energy)
    return Both(there, back, products)


def _nothing(plan: TransferPlan, of: Endpoints, to: Endpoints) -> Transfer:
    directed = plan.bands, of.points, plan.coarse.steps.rows, len(plan.directed.patch)
    shape = plan.bands, of.points, to.points, len(plan.edges) - 1
    return Transfer(np.zeros(shape, np.float32), np.zeros(directed, np.float32))


def _by_batch(plan: TransferPlan, of: Endpoints, chunk: int) -> ByBatch:
    """Room for histograms by batch of both ends of some points."""
    steps, columns = plan.groups.steps.rows, 2 * int(plan.groups.count[chunk])
    return ByBatch(
        np.empty((plan.bands, of.points, plan.moment_rows, steps, columns), np.float32),
        np.empty((plan.bands, of.points, 2, steps, columns), np.float32),
    )


def _make_workspace(plan: TransferPlan, outgoing: int, incident: int) -> _Workspace:
    """For so many points of either end."""
    rows = plan.steps.rows
    products = max(len(stretch.convolution.forward) for stretch in plan.stretches)
    pairs = max(outgoing * min(incident, COLUMNS), incident * min(outgoing, COLUMNS))
    lanes = bands_at_once(plan.bands, thread_count())
    return _Workspace(
        np.empty((plan.bands, outgoing, rows, plan.chunk), np.float32),
        np.empty((plan.bands, incident, rows, plan.chunk), np.float32),
        np.empty((lanes, products * outgoing * plan.chunk), np.float32),
        np.empty((lanes, products * incident * plan.chunk), np.float32),
        np.empty((lanes, products * pairs), np.float32),
    )


def bands_at_once(bands: int, threads: int) -> int:
    """Of how many bands transforms and products are made side by side: those of one are too short for many threads,
    which would wait for each other after each."""
    return max(min(bands, threads // _THREADS), 1)


def _add_chunk(
    plan: TransferPlan,
    of: Endpoints,
    to: Endpoints,
    chunk: int,
    workspace: _Workspace,
    result: Transfer,
    batches: tuple[ByBatch, ByBatch],
) -> None:
    """Add the transfer by way of the patches of a chunk; outgoing histograms by batch to the first of `batches`,
    incident ones to the second."""
    shape = plan.groups.steps.rows, int(plan.groups.count[chunk]), plan.moment_rows, 1, plan.bands
    outgoing = Histograms(workspace.outgoing, *(half[0] for half in batches[0].halves))
    incident = Histograms(workspace.incident, *(half[1] for half in batches[1].halves))
    axes = ChunkAxes(plan.steps, plan.groups, plan.within, chunk)

    def make_scratch() -> PointHistograms:
        energy = np.empty((plan.steps.rows, plan.chunk, plan.bands), np.float32)
        return PointHistograms(
            energy,
            np.empty(shape, np.float32),
            np.empty(plan.bands, np.float32),
            np.empty(plan.material_groups, np.uint16),
            np.empty(energy.shape[1:], np.float32),
            np.empty((2, shape[1], plan.bands)),
        )

    with stage("outgoing histograms"):
        arguments = of.reflections, of.drawn, of.subpaths, axes, outgoing
        over_rows(fill_outgoing, of.points, *arguments, chunk=_together(of.points), scratch=make_scratch)
    with stage("incident histograms"):
        arguments = to.reflections, plan.factor, axes, incident
        over_rows(fill_incident, to.points, *arguments, chunk=_together(to.points), scratch=make_scratch)
    _add_directed(plan, chunk, workspace.outgoing, result.directed)
    lanes = len(workspace.products)

    def bands(lane: int) -> None:
        for band in range(lane, plan.bands, lanes):
            _add_energy(plan, band, lane, workspace, result.energy[band])

    at_once(*(partial(bands, lane) for lane in range(lanes)))


def _together(points: int) -> int:
    """How many of so many points one call does."""
    threads = thread_count()
    few = threads == 1 or points <= _POINTS
    return _POINTS if few else min(max(points // (_CALLS * threads), 1), _POINTS)


def _add_directed(plan: TransferPlan, chunk: int, outgoing: np.ndarray, directed: np.ndarray) -> None:
    """Put outgoing histograms (b, P, rows, columns) of a chunk into those on `directed` patches."""
    chosen = plan.directed.patch // CHUNK == chunk
    columns = plan.directed.patch[chosen] - chunk * CHUNK
    late = plan.stretches[-1].rows

    def call(first: int, last: int) -> None:
        for band in range(plan.bands):
            of_points = outgoing[band, first:last, late][:, :, columns]
            directed[band, first:last][:, :, chosen] = coarse_rows(plan.coarse, of_points)

    over_rows(call, directed.shape[1], chunk=_POINTS)


def _add_energy(
    plan: TransferPlan, band: int, lane: int, workspace: _Workspace, energy: np.ndarray
) -> None:
    """Add V ∗ F, summed over the patches of a chunk, to `energy` (P, Q, late bins)."""
    of_outgoing, of_incident, of_pairs = (table[lane] for table in workspace[2:])
    (p, q), chunk = energy.shape[:2], plan.chunk
    for stretch in plan.stretches:
        convolution, products = stretch.convolution, len(stretch.convolution.forward)
        outgoing = of_outgoing[: products * p * chunk].reshape(products, 1, p, chunk)
        incident = of_incident[: products * q * chunk].reshape(products, 1, q, chunk)
        with stage("transforms"):
            transform(convolution, workspace.outgoing[band][:, None, stretch.rows], outgoing)
            transform(convolution, workspace.incident[band][:, None, stretch.rows], incident)
        with stage("products"):
            count(products=products * p * q * chunk)
            for start in range(0, q, COLUMNS):
                columns = slice(start, start + COLUMNS)
                places = columns, stretch.bins
                accumulate(convolution, outgoing, incident, of_pairs, energy[None], places)


def _subtract_own(plan: TransferPlan, of: Endpoints, to: Endpoints, energy: np.ndarray) -> None:
    """Subtract from `energy` (b, P, Q, late bins) the products of a subpath with itself, of the pairs of a
    point with itself."""
    i, j = np.nonzero(of.keys[:, None] == to.keys[None, :])
    if len(i) == 0:
        return
    reflections = to.reflections
    own = np.zeros((len(energy), plan.steps.rows, to.points), np.float32)
    most = int(np.diff(reflections.start, axis=1).max())
    subpaths = int(reflections.subpath.max(initial=0)) + 1

    def make_scratch() -> OwnPairScratch:
        return OwnPairScratch(np.empty(subpaths, np.int64), np.empty(most, np.int64))

    outgoing = _outgoing_energy(of.reflections, reflections, i, j)
    arguments = reflections, outgoing, plan.steps, plan.factor, own
    over_rows(fill_own, to.points, *arguments, chunk=1, scratch=make_scratch)
    for stretch in plan.stretches:
        late = slice(stretch.rows.stop - (stretch.bins.stop - stretch.bins.start), stretch.rows.stop)
        energy[:, i, j, stretch.bins] -= own[:, late][:, :, j].transpose(0, 2, 1)


def _outgoing_energy(of: Reflections, to: Reflections, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(E, b) energies of V, none on no patch, in the rows of `to`; of points i of `of` that are the points j."""
    if of is to:
        return to.energy
    out = np.zeros_like(to.energy)
    for p, q in zip(i, j, strict=True):
        rows = slice(of.start[p, 0], of.start[p, -1])
        known = of.patch[rows, None] >= 0
        out[to.start[q, 0] : to.start[q, -1]] = np.where(known, of.energy[rows], np.float32(0.0))
    return out


def _drop_rounding(plan: TransferPlan, energy: np.ndarray) -> None:
    """Set to zero what rounding has left in (b, P, Q, late bins)."""

    def call(first: int, last: int) -> None:
        for stretch in plan.stretches:
            late = energy[:, first:last, :, stretch.bins]
            late[late < ROUNDING * late.max(axis=3, keepdims=True)] = 0.0

    over_rows(call, energy.shape[1], least=rows_of_thread(energy.swapaxes(0, 1)))
