"""Patch histograms: the energy of a point's subpaths on every patch, over path length.

The incident histogram F of a point holds the first diffuse reflections of its subpaths. Its outgoing histogram V
holds the same and what transfer subpaths add on further patches. By reciprocity F of a listener tells how much of
what a patch scatters reaches the listener.

Histograms are filled for a chunk of patches at a time, so that those of one point stay in the cache and those of
all points in memory. Energies are decay-compensated and without air. All are also summed with the weight of one
batch of subpaths raised, at a coarser resolution (`batch_variance`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.transport.radiance_transfer.batch_variance import (
    RAISED,
    PatchGroups,
    Within,
    add_to_group,
)
from soundspaces_sim.transport.radiance_transfer.first_reflections import Continuations, Reflections
from soundspaces_sim.transport.radiance_transfer.time_steps import TimeSteps, incident_row, outgoing_row
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import CHUNK, TransferSubpaths
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, harmonics


class ChunkAxes(NamedTuple):
    """What the rows and columns of a chunk's histograms stand for."""

    steps: TimeSteps  # rows
    groups: PatchGroups  # columns of the sums by batch
    within: Within
    chunk: int  # columns: patches `chunk` CHUNK and the next ones


class Histograms(NamedTuple):
    """Of N points, on a chunk of patches."""

    energy: np.ndarray  # (b, N, rows, columns)
    # (b, N, moment rows, steps, groups): all batches with one raised, then rows of counts
    batches: np.ndarray
    # (b, N, 2, steps, groups): variances of sums over batches; of patches, `_store_within`
    within: np.ndarray


class PointHistograms(NamedTuple):
    """The same of one point while they are filled, with bands last."""

    energy: np.ndarray  # (rows, columns, b)
    batches: np.ndarray  # (steps, groups, moment rows, 1, b)
    deposit: np.ndarray  # (b,) energy that is being added
    counts: np.ndarray  # (material groups,) reflections of what is being added
    step: np.ndarray  # (columns, b) energy of the patches in a step of batches
    of_groups: np.ndarray  # (2, groups, b) means over patches, and of squares


class DirectedPatches(NamedTuple):
    """D of the C patches, which tell from where sound arrives."""

    patch: np.ndarray  # (D,) in order
    column: np.ndarray  # (C,) number among these, -1 for none
    factor: np.ndarray  # (C, b) 4 / R over the probability that the patch is one of these


class OwnPairScratch(NamedTuple):
    """Linked lists of the reflections of each subpath of a batch, the newest first."""

    newest: np.ndarray  # (subpaths,) row of `Reflections`, -1 for none
    previous: np.ndarray  # (reflections of a batch,) row of the one before, -1 for none


@part(forceinline=True)
def _add_outgoing(
    point: PointHistograms, axes: ChunkAxes, batch: int, patch: int, length: float
) -> None:
    """Add the energies `point.deposit`, reflected `point.counts` times, on a patch after `length` m."""
    column = patch - axes.chunk * CHUNK
    for s in range(len(axes.steps.step)):
        row = outgoing_row(axes.steps, s, length)
        if row >= 0:
            for b in range(len(point.deposit)):
                point.energy[row, column, b] += point.deposit[b]
    add_to_group(point.batches, axes.groups, batch, patch, length, point.deposit, point.counts, False)


@part(forceinline=True)
def _count_reflection(point: PointHistograms, reflections: Reflections, r: int, own: bool) -> None:
    """Set `point.counts` to those of first reflection `r`; `own`: itself included."""
    for m in range(len(point.counts)):
        point.counts[m] = reflections.counts[r, m]
    group = reflections.group[r]
    if own and group >= 0 and group < len(point.counts):
        point.counts[group] += np.uint16(1)


@part
def _store_point(point: PointHistograms, out: Histograms, i: int) -> None:
    """Copy the histograms of one point to row `i`, bands first, and raise the weight of each batch in its row."""
    energy, batches = point.energy, point.batches
    for b in range(energy.shape[2]):
        for row in range(energy.shape[0]):
            for c in range(energy.shape[1]):
                out.energy[b, i, row, c] = energy[row, c, b]
        for t in range(batches.shape[0]):
            for g in range(batches.shape[1]):
                of_group, whole = batches[t, g], np.float32(0.0)
                for k in range(BATCHES):
                    whole += of_group[k, 0, b]
                for k in range(batches.shape[2]):
                    value = of_group[k, 0, b]
                    if k < BATCHES:
                        value = np.float32(1.0 - RAISED) * whole + np.float32(RAISED * BATCHES) * value
                    out.batches[b, i, k, t, g] = value


@part
def _sum_step(point: PointHistograms, axes: ChunkAxes, t: int, incident: bool) -> None:
    """Fill `point.step` with the energy of the patches in step `t` of batches."""
    low, high = axes.within.rows[int(incident), t]
    step = point.step.reshape(-1)
    step[:] = 0.0
    for r in range(low, high):
        of_row = point.energy[r].reshape(-1)
        for n in range(len(step)):
            step[n] += of_row[n]


@part
def _store_within(
    point: PointHistograms, axes: ChunkAxes, incident: bool, out: np.ndarray, i: int
) -> None:
    """Fill row `i` of `out` (b, N, 2, steps, groups) with variances of the sums over batches, and the mean square
    by which patches of a group differ: of F_c / R_c, or of V_c R_g / R_c, with patches counted by R."""
    batches, of_groups, first = point.batches, point.of_groups, axes.chunk * CHUNK
    columns = min(len(point.step), len(axes.groups.group) - first)
    for t in range(batches.shape[0]):
        _sum_step(point, axes, t, incident)
        of_groups[:] = 0.0
        for c in range(columns):
            g = axes.groups.group[first + c]
            for b in range(of_groups.shape[2]):
                share = axes.within.share[first + c, b]
                if share > 0.0 and point.step[c, b] > 0.0:
                    # incident energies are 4 F / R
                    value = 0.25 * point.step[c, b] if incident else point.step[c, b] / share
                    of_groups[0, g, b] += share * value
                    of_groups[1, g, b] += share * value * value
        for g in range(batches.shape[1]):
            for b in range(of_groups.shape[2]):
                total, squares = 0.0, 0.0
                for k in range(BATCHES):
                    value = batches[t, g, k, 0, b]
                    total += value
                    squares += value * value
                spread = max(squares - total * total / BATCHES, 0.0)
                mean, square = of_groups[0, g, b], of_groups[1, g, b]
                out[b, i, 0, t, g] = spread * (BATCHES / (BATCHES - 1))
                out[b, i, 1, t, g] = max(square - mean * mean, 0.0)


@part(forceinline=True)
def _add_continuation(
    point: PointHistograms,
    axes: ChunkAxes,
    batch: int,
    reflections: Reflections,
    drawn: Continuations,
    place: tuple[int, int],
    subpaths: TransferSubpaths,
) -> None:
    """Add what the transfer subpath that carries on a reflection leaves on the chunk; `place`: point and number
    of the draw."""
    i, d = place
    r, scale = drawn.reflection[i, batch, d], drawn.scale[i, batch, d]
    population = drawn.population[i, batch, d]
    at = drawn.subpath[i, batch, d] * len(axes.groups.count) + axes.chunk
    length = reflections.length[r]
    for e in range(subpaths.start[population, at], subpaths.start[population, at + 1]):
        for b in range(len(point.deposit)):
            point.deposit[b] = scale * reflections.energy[r, b] * subpaths.energy[e, b]
        _count_reflection(point, reflections, r, True)
        for m in range(len(point.counts)):
            point.counts[m] += subpaths.counts[e, m]
        _add_outgoing(point, axes, batch, subpaths.patch[e], length + subpaths.length[e])


@kernel
def fill_outgoing(
    first: int,
    last: int,
    reflections: Reflections,
    drawn: Continuations,
    subpaths: TransferSubpaths,
    axes: ChunkAxes,
    out: Histograms,
    point: PointHistograms,
) -> None:
    """Outgoing histograms V of the points `first` to `last` on a chunk of patches; `point` is scratch."""
    low, columns = axes.chunk * CHUNK, out.energy.shape[3]
    for i in range(first, last):
        point.energy[:] = 0.0
        point.batches[:] = 0.0
        for k in range(BATCHES):
            for r in range(reflections.start[i, k], reflections.start[i, k + 1]):
                patch = reflections.patch[r]
                if patch >= low and patch < low + columns:
                    for b in range(len(point.deposit)):
                        point.deposit[b] = reflections.energy[r, b]
                    _count_reflection(point, reflections, r, True)
                    _add_outgoing(point, axes, k, patch, reflections.length[r])
            for d in range(drawn.reflection.shape[2]):
                if drawn.reflection[i, k, d] >= 0:
                    _add_continuation(point, axes, k, reflections, drawn, (i, d), subpaths)
        _store_point(point, out, i)
        _store_within(point, axes, False, out.within, i)


@kernel
def fill_incident(
    first: int,
    last: int,
    reflections: Reflections,
    factor: np.ndarray,
    axes: ChunkAxes,
    out: Histograms,
    point: PointHistograms,
) -> None:
    """Incident histograms F of the points `first` to `last` on a chunk of patches, times `factor` (C, b), 4 /
    R of the patch; by batch times `axes.groups.factor`. `point` is scratch."""
    low, columns = axes.chunk * CHUNK, out.energy.shape[3]
    for i in range(first, last):
        point.energy[:] = 0.0
        point.batches[:] = 0.0
        for k in range(BATCHES):
            for r in range(reflections.start[i, k], reflections.start[i, k + 1]):
                patch, length = reflections.patch[r], reflections.length[r]
                if patch < low or patch >= low + columns:
                    continue
                for s in range(len(axes.steps.step)):
                    row = incident_row(axes.steps, s, length)
                    if row >= 0:
                        for b in range(len(point.deposit)):
                            point.energy[row, patch - low, b] += (
                                reflections.energy[r, b] * factor[patch, b]
                            )
                for b in range(len(point.deposit)):
                    point.deposit[b] = reflections.energy[r, b] * axes.groups.factor[patch, b]
                _count_reflection(point, reflections, r, False)
                counted = point.deposit, point.counts
                add_to_group(point.batches, axes.groups, k, patch, length, *counted, True)
        _store_point(point, out, i)
        _store_within(point, axes, True, out.within, i)


@kernel
def fill_directed(
    points: np.ndarray,
    reflections: Reflections,
    steps: TimeSteps,
    directed: DirectedPatches,
    out: np.ndarray,
    y: np.ndarray,
) -> None:
    """Add incident histograms of the n `points` on `directed` patches, times nine spherical harmonics of the
    direction in which the point sees the reflection, to `out` (b, n, rows, 9, D). `y` (9,) is scratch."""
    for n in range(len(points)):
        i = points[n]
        for k in range(BATCHES):
            for r in range(reflections.start[i, k], reflections.start[i, k + 1]):
                patch, d = reflections.patch[r], reflections.direction[i, k, reflections.subpath[r]]
                at, row = directed.column[patch], incident_row(steps, 0, reflections.length[r])
                if at < 0 or row < 0:
                    continue
                harmonics(d[0], d[1], d[2], y)
                for b in range(len(out)):
                    value = reflections.energy[r, b] * directed.factor[patch, b]
                    for c in range(CHANNELS):
                        out[b, n, row, c, at] += y[c] * value


@kernel
def fill_own(
    first: int,
    last: int,
    reflections: Reflections,
    energy: np.ndarray,
    steps: TimeSteps,
    factor: np.ndarray,
    out: np.ndarray,
    work: OwnPairScratch,
) -> None:
    """Add to `out` (b, rows, N) what each subpath of a point contributes to the transfer from the point to
    itself by its own reflections, V and F, on one patch. `energy` (E, b) of V; `factor` (C, b): 4 / R."""
    newest, previous = work.newest, work.previous
    for i in range(first, last):
        for k in range(BATCHES):
            start = reflections.start[i, k]
            newest[:] = -1
            for r in range(start, reflections.start[i, k + 1]):
                previous[r - start] = newest[reflections.subpath[r]]
                newest[reflections.subpath[r]] = r
                o = r
                while o >= 0:
                    if reflections.patch[o] == reflections.patch[r]:
                        _add_pair(i, r, o, reflections, energy, steps, factor, out)
                        if o != r:
                            _add_pair(i, o, r, reflections, energy, steps, factor, out)
                    o = previous[o - start]


@part
def _add_pair(
    i: int,
    incident: int,
    outgoing: int,
    reflections: Reflections,
    energy: np.ndarray,
    steps: TimeSteps,
    factor: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add the product of two first reflections on the same patch."""
    for s in range(len(steps.step)):
        of_outgoing = outgoing_row(steps, s, reflections.length[outgoing])
        of_incident = incident_row(steps, s, reflections.length[incident])
        row = of_outgoing + of_incident - steps.base[s]
        if of_outgoing >= 0 and of_incident >= 0 and row < steps.base[s + 1]:
            for b in range(len(out)):
                out[b, row, i] += (
                    reflections.energy[incident, b]
                    * energy[outgoing, b]
                    * factor[reflections.patch[incident], b]
                )
