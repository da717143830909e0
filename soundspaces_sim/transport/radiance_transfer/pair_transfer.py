"""Energies between all pairs of points of two sides, E = sum over c of (4 / R_c) V_p(c) ∗ F_q(c), in one direction.

Patches are taken a chunk at a time (`patch_histograms`). All matrix products have one shape (`convolution`), so
that a pair's bits depend on no other pair.

Where p and q are the same point, V and F have common subpaths. The products of a subpath with itself are left
out, so that the remaining pairs are of independent subpaths, as between two points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import over_rows
from soundspaces_sim.core.profile import count, stage
from soundspaces_sim.transport.radiance_transfer.batch_variance import (
    COLUMNS,
    add_products,
)
from soundspaces_sim.transport.radiance_transfer.convolution import accumulate, padded, transform
from soundspaces_sim.transport.radiance_transfer.first_reflections import (
    Continuations,
    FirstReflections,
    Reflections,
    draw_continuations,
    gather_reflections,
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
from soundspaces_sim.transport.radiance_transfer.prepared import late_decay, transfer_subpaths
from soundspaces_sim.transport.radiance_transfer.shared_and_own import (
    own_continuations,
    trace_own_subpaths,
)
from soundspaces_sim.transport.radiance_transfer.time_steps import coarse_rows
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import (
    CHUNK,
    TransferSubpaths,
)
from soundspaces_sim.transport.tables import BATCHES
from soundspaces_sim.transport.tile import Side

ROUNDING = 1e-5  # of the greatest value: what rounding leaves where nothing arrives


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
    by_outgoing: np.ndarray  # (b, P, moment rows, Q, T) `add_products` by batch of V
    by_incident: np.ndarray  # (b, Q, BATCHES, P, T) `add_products` by batch of F
    by_counts: np.ndarray  # (b, Q, rows below the batches, P, T) of counted F with V
    taken: np.ndarray  # (b, M, P, 1, Q, T) of what anchors take of V and of F
    crossed: np.ndarray  # (b, M, P, M, Q, T) of counts k of F, on the first of these axes, and m of V
    directed: np.ndarray  # (b, P, coarse rows, D) outgoing histograms on directed patches


class _Workspace(NamedTuple):
    """Arrays that are filled anew for every chunk of patches."""

    outgoing: np.ndarray  # (b, P, rows, columns)
    incident: np.ndarray  # (b, Q, rows, columns)
    outgoing_spectra: np.ndarray  # (R, P', columns), P padded to whole blocks
    incident_spectra: np.ndarray  # (R, Q', columns)
    products: np.ndarray  # (R, P' Q') of as many of the Q as are held at once


def make_endpoints(side: Side) -> Endpoints:
    """Uses up what the side holds of first reflections: `side.once(make_endpoints)`."""
    model, first = side.model, side.once(FirstReflections.of)
    first.room = None
    world, keys, decay = model.world, side.ends.keys, model.once(late_decay)
    reflections = gather_reflections(first.blocks, decay.rate, decay.reach)
    count = world.settings.specular // BATCHES  # as many are carried on as there are subpaths
    if model.config.radiance_transfer.subpaths != "own":
        subpaths = model.once(transfer_subpaths)
        drawn = draw_continuations(reflections, keys, count, len(subpaths.start))
        return Endpoints(reflections, drawn, subpaths, keys)
    count = own_continuations(world)
    drawn = with_own_populations(draw_continuations(reflections, keys, count, BATCHES))
    with stage("own transfer subpaths"):
        patch = patches_drawn(reflections, drawn)
        subpaths = trace_own_subpaths(world, model.seed, patch, keys, decay)
    return Endpoints(reflections, drawn, subpaths, keys)


def transfer(plan: TransferPlan, of: Endpoints, to: Endpoints, drop_rounding: bool = True) -> Transfer:
    """The outgoing histograms of the points `of` with the incident histograms of the points `to`."""
    shape, rows = (plan.bands, of.points, to.points), plan.moment_rows
    groups, steps = plan.material_groups, plan.windows.total
    result = Transfer(
        np.zeros((*shape, len(plan.edges) - 1), np.float32),
        np.zeros((plan.bands, of.points, rows, to.points, steps), np.float32),
        np.zeros((plan.bands, to.points, BATCHES, of.points, steps), np.float32),
        np.zeros((plan.bands, to.points, rows - BATCHES, of.points, steps), np.float32),
        np.zeros((plan.bands, groups, of.points, 1, to.points, steps), np.float32),
        np.zeros((plan.bands, groups, of.points, groups, to.points, steps), np.float32),
        np.zeros((plan.bands, of.points, plan.coarse.steps.rows, len(plan.directed.patch)), np.float32),
    )
    workspace = _make_workspace(plan, of.points, to.points)
    for chunk in range(len(plan.groups.count)):
        _add_chunk(plan, of, to, chunk, workspace, result)
    _subtract_own(plan, of, to, result.energy)
    if drop_rounding:
        for of_band in result.energy:
            for rows in of_band:
                _drop_rounding(plan, rows)
    return result


def _make_workspace(plan: TransferPlan, outgoing: int, incident: int) -> _Workspace:
    rows, p, q = plan.steps.rows, padded(outgoing), padded(incident)
    products = max(len(stretch.convolution.forward) for stretch in plan.stretches)
    return _Workspace(
        np.empty((plan.bands, outgoing, rows, plan.chunk), np.float32),
        np.empty((plan.bands, incident, rows, plan.chunk), np.float32),
        np.zeros((products, p, plan.chunk), np.float32),
        np.zeros((products, q, plan.chunk), np.float32),
        np.empty((products, p * min(q, COLUMNS)), np.float32),
    )


def _add_chunk(
    plan: TransferPlan, of: Endpoints, to: Endpoints, chunk: int, workspace: _Workspace, result: Transfer
) -> None:
    """Add the transfer by way of the patches of a chunk."""
    shape = plan.moment_rows, plan.groups.steps.rows, int(plan.groups.count[chunk])
    outgoing, incident = (
        Histograms(energy, np.zeros((plan.bands, end.points, *shape), np.float32))
        for end, energy in ((of, workspace.outgoing), (to, workspace.incident))
    )
    axes = ChunkAxes(plan.steps, plan.groups, chunk)

    def make_scratch() -> PointHistograms:
        energy = np.empty((plan.steps.rows, plan.chunk, plan.bands), np.float32)
        batches = np.empty((*shape[1:], shape[0], 1, plan.bands), np.float32)
        counts = np.empty(plan.material_groups, np.uint16)
        return PointHistograms(energy, batches, np.empty(plan.bands, np.float32), counts)

    with stage("outgoing histograms"):
        arguments = of.reflections, of.drawn, of.subpaths, axes, outgoing
        over_rows(fill_outgoing, of.points, *arguments, chunk=4, scratch=make_scratch)
    with stage("incident histograms"):
        arguments = to.reflections, plan.factor, axes, incident
        over_rows(fill_incident, to.points, *arguments, chunk=4, scratch=make_scratch)
    directed = plan.directed.patch // CHUNK == chunk
    columns = plan.directed.patch[directed] - chunk * CHUNK
    for band in range(plan.bands):
        late = workspace.outgoing[band][:, plan.stretches[-1].rows]
        result.directed[band][:, :, directed] = coarse_rows(plan.coarse, late[:, :, columns])
        _add_energy(plan, band, workspace, result.energy[band])
        with stage("products by batch"):
            _add_batches(plan, band, outgoing.batches[band], incident.batches[band], result)


def _add_batches(
    plan: TransferPlan, band: int, outgoing: np.ndarray, incident: np.ndarray, result: Transfer
) -> None:
    """Add the products by batch of one band, of (points, moment rows, steps, groups) of a chunk."""
    of_all, to_all = (_in_blocks(each[:, :BATCHES].sum(axis=1)) for each in (outgoing, incident))
    add_products(plan.windows, outgoing, to_all, result.by_outgoing[band])
    add_products(plan.windows, incident[:, :BATCHES], of_all, result.by_incident[band])
    if plan.material_groups:
        _add_counts(plan, band, outgoing, incident, of_all, result)


def _add_counts(
    plan: TransferPlan,
    band: int,
    outgoing: np.ndarray,
    incident: np.ndarray,
    of_all: np.ndarray,
    result: Transfer,
) -> None:
    """Add products of counts of reflections, of V (P, moment rows, steps, groups), of F (Q, …) and both; `of_all`
    (P', steps, groups) of V."""
    number, middle = plan.material_groups, BATCHES + plan.material_groups
    add_products(plan.windows, incident[:, BATCHES:], of_all, result.by_counts[band])
    for m in range(number):
        of_m, taken = outgoing[:, middle + m, None], _in_blocks(incident[:, middle + m])
        add_products(plan.windows, of_m, taken, result.taken[band, m])
        to_m = _in_blocks(incident[:, BATCHES + m])
        add_products(plan.windows, outgoing[:, BATCHES:middle], to_m, result.crossed[band, m])


def _in_blocks(histograms: np.ndarray) -> np.ndarray:
    """Histograms of some points, and empty ones up to whole blocks."""
    whole = np.zeros((padded(len(histograms)), *histograms.shape[1:]), np.float32)
    whole[: len(histograms)] = histograms
    return whole


def _add_energy(plan: TransferPlan, band: int, workspace: _Workspace, energy: np.ndarray) -> None:
    """Add V ∗ F, summed over the patches of a chunk, to `energy` (P, Q, late bins)."""
    for stretch in plan.stretches:
        convolution, products = stretch.convolution, len(stretch.convolution.forward)
        outgoing, incident = workspace.outgoing_spectra[:products], workspace.incident_spectra[:products]
        with stage("transforms"):
            transform(convolution, workspace.outgoing[band][:, stretch.rows], outgoing)
            transform(convolution, workspace.incident[band][:, stretch.rows], incident)
        with stage("products"):
            count(products=products * energy.shape[0] * energy.shape[1] * plan.chunk)
            for start in range(0, energy.shape[1], COLUMNS):
                columns = slice(start, start + COLUMNS)
                out = energy[:, columns, stretch.bins]
                accumulate(
                    convolution, outgoing, incident[:, columns], workspace.products[:products], out
                )


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
    """Set to zero what rounding has left in (n, late bins)."""
    for stretch in plan.stretches:
        late = energy[:, stretch.bins]
        late[late < ROUNDING * late.max(axis=1, keepdims=True)] = 0.0
