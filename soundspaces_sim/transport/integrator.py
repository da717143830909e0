"""The integrator: two blocks of points in, the echograms between them out. A loop over the techniques.

A tile is the unit of work, of memory and of resumption. A pair's result depends on its two points, the
scene, the config and the seed, never on what else is in the tile.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import at_once, over_rows, rows_of_thread, thread_count
from soundspaces_sim.core.profile import count, stage
from soundspaces_sim.echogram.echogram import Arrivals, Echograms
from soundspaces_sim.echogram.measure_errors import LEAST_EFFECTIVE, UNLIKELY, measure_errors
from soundspaces_sim.transport.bsdf.surface import group_count
from soundspaces_sim.transport.check import Origin, check_paths, check_sums, check_table
from soundspaces_sim.transport.kept_traces import KeptTraces
from soundspaces_sim.transport.model import EARLY_S, Model
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.radiance_transfer.first_reflections import gather_reflections
from soundspaces_sim.transport.radiance_transfer.prepared import late_decay
from soundspaces_sim.transport.reflection_counts.of_tile import moments_of
from soundspaces_sim.transport.smoothing import Traced, smoothed, with_errors_of
from soundspaces_sim.transport.state import VERTEX, Tables, Vertices
from soundspaces_sim.transport.tables import BATCHES, CHANNELS
from soundspaces_sim.transport.technique import Technique, check_requirements
from soundspaces_sim.transport.techniques import TECHNIQUES
from soundspaces_sim.transport.tile import (
    Arrived,
    Side,
    Sums,
    Tile,
    Walks,
    batch_rows,
    empty_table,
    make_side,
    make_sums,
    make_tile,
    nothing_arrived,
)

Progress = Callable[[int], None]  # points traced
#: Standard deviation of a deviation over an error by so many batches (Student's t).
_STUDENT = np.sqrt((BATCHES - 1) / (BATCHES - 3))
_UNKNOWN = 1.0  # relative error of energy that one batch carries
_LARGEST_KNOWN = 0.5
_ROOM = 2**29  # bytes for the tables of points that are traced together, if threads have one each


class Made(NamedTuple):
    """What techniques make of a tile."""

    tile: Tile
    arrived: Arrived  # its paths sorted
    sums: Sums


def simulate_tile(
    model: Model,
    a: np.ndarray,
    b: np.ndarray | None,
    both_ways: bool = True,
    progress: Progress | None = None,
    techniques: Sequence[Technique] = TECHNIQUES,
) -> tuple[Echograms, Echograms | None]:
    """Echograms a -> b and, with `both_ways`, b -> a from the same subpaths. `b` None: all pairs of a."""
    made = run_techniques(model, a, b, both_ways, progress, techniques)
    return smoothed(model, traced(made, both_ways))


@stage("echograms and error bars")
def traced(made: Made, both_ways: bool) -> Traced:
    """What is in a tile's tables as echograms."""
    tile, sums, arrived = made.tile, made.sums, made.arrived
    model, a, b, distance = tile.model, tile.a.given, tile.b.given, tile.distance
    count(pairs=len(tile.pairs))
    early, batches, error = arrived.paths, sums.batches[:, :, :BATCHES], relative_error(made)
    forward = _collect(model, a, b, sums.to_b, arrived.direct, distance, arrived.walls, early, error)
    forward = replace(
        forward,
        measure_error=np.where(
            np.isfinite(error).all(axis=2)[:, :, None],
            measure_errors(forward, batches, sums.difference, model.world.window_of_bin, tile.same),
            np.nan,
        ).astype(np.float32),
    )
    moments, of_windows = moments_of(model, sums), _error_of_windows(batches)
    if tile.same or not both_ways:
        return Traced(forward, None, sums.difference, of_windows, moments, tile.same)
    backward = _collect(
        model,
        b,
        a,
        sums.to_a,
        arrived.direct.transpose(1, 0, 2),
        distance.T,
        arrived.walls.T,
        early.reversed(distance).sorted(),
        error.transpose(1, 0, 2, 3),
    )
    backward = with_errors_of(forward, backward)
    return Traced(forward, backward, sums.difference, of_windows, moments, False)


def run_techniques(
    model: Model,
    a: np.ndarray,
    b: np.ndarray | None,
    both_ways: bool = True,
    progress: Progress | None = None,
    techniques: Sequence[Technique] = TECHNIQUES,
    kept: KeptTraces | None = None,
) -> Made:
    """What techniques make of a tile, in three stages, of which two go on side by side; as for `simulate_tile`.
    `kept`: of this model, what is traced for several tiles."""
    check_requirements(techniques)
    make = partial(make_side, model) if kept is None else kept.side
    with stage("detectors and tables"):
        side_a = make(a)
        tile = make_tile(side_a, side_a if b is None else make(b))
        sums = make_sums(tile, both_ways)
    walks, arrived = at_once(  # where one waits for a single core, the other has the rest
        partial(_trace, tile, sums, techniques, progress, kept), partial(arrived_at, tile, techniques)
    )
    join_walks(tile, walks, sums, techniques)
    if sums.to_a.shape[2] and not tile.same:  # a point to itself: there is no other way back
        i, j = np.nonzero(side_a.ends.keys[:, None] == tile.b.ends.keys)
        sums.to_a[j, i] = sums.to_b[i, j]
    if tile.same:  # each pair was closed once: mirror its batches
        lower = np.tri(len(a), k=-1, dtype=bool)
        sums.batches[lower] = sums.batches.transpose(1, 0, 2, 3, 4)[lower]
    return Made(tile, arrived._replace(paths=arrived.paths.sorted()), sums)


def arrived_at(tile: Tile, techniques: Sequence[Technique]) -> Arrived:
    """What arrives discretely between the points of a tile by all techniques, of which one knows the direct
    sound."""
    found = nothing_arrived(tile)
    for technique in techniques:
        if technique.connect is not None:
            with stage(technique.name):
                more = technique.connect(tile)
                count(deposits=len(more.paths.pair))
                origin = _origin(technique.name, tile.a, tile.b)
                check_sums(more.direct, origin)
                check_paths(more.paths.pair, more.paths.energy, origin)
            paths = PathTable.concatenate([found.paths, more.paths], tile.shape[2])
            found = Arrived(found.direct + more.direct, found.walls + more.walls, paths)
    return found


def join_walks(
    tile: Tile, walks: tuple[Walks, Walks], sums: Sums, techniques: Sequence[Technique]
) -> None:
    """Add what techniques make of pairs of walks."""
    for technique in techniques:
        if technique.join is not None:
            with stage(technique.name):
                technique.join(tile, *walks, sums)
                check_table(sums.to_b, _origin(technique.name, tile.a, tile.b))
                if not tile.same:
                    check_table(sums.to_a, _origin(technique.name, tile.b, tile.a))


def _trace(
    tile: Tile,
    sums: Sums,
    techniques: Sequence[Technique],
    progress: Progress | None,
    kept: KeptTraces | None,
) -> tuple[Walks, Walks]:
    """Subpaths of all points into the tables: what arrives at b is a -> b, what left b for a is it as well. Returns
    the walks of a and of b.

    Some points at a time, into tables of their own. A pair's cell gets one addend from either end, so it does not
    matter which comes first.
    """
    back_wanted, done = not tile.same and sums.to_a.shape[2] > 0, 0
    walks: list[Walks] = []
    for own, other in [(tile.a, tile.b)] if tile.same else [(tile.a, tile.b), (tile.b, tile.a)]:
        of_a, of_b = own is tile.a, own is tile.b

        def add(rows: slice, tables: Tables, of_a: bool = of_a, of_b: bool = of_b) -> None:
            nonlocal done

            def add_rows(first: int, last: int) -> None:
                some, new = slice(rows.start + first, rows.start + last), slice(first, last)
                if of_a:
                    sums.to_b[some] += tables.arrive[new]
                    sums.batches[some] += tables.batches[new]
                    sums.difference[some] += _late_energy(sums, tables.arrive[new])
                if back_wanted and of_b:
                    sums.to_a[some] += tables.arrive[new]

            def add_columns(first: int, last: int) -> None:
                some, new = slice(rows.start + first, rows.start + last), slice(first, last)
                leave = tables.leave[new].swapaxes(0, 1)
                if of_b:
                    sums.to_b[:, some] += leave
                    sums.batches[:, some] += tables.batches[new].swapaxes(0, 1)
                    sums.difference[:, some] -= _late_energy(sums, leave)
                if back_wanted and of_a:
                    sums.to_a[:, some] += leave

            # One after the other: of one side, a row and a column of two points meet in a pair.
            for call in (add_rows, add_columns):
                over_rows(call, rows.stop - rows.start, least=rows_of_thread(tables.batches))
            done += rows.stop - rows.start
            if progress is not None:
                progress(done)

        if kept is None:
            wanted = of_a or back_wanted, of_b or back_wanted
            walks.append(_trace_side(techniques, wanted, own, other, add))
        else:
            trace = partial(_trace_side, techniques, (True, True))
            walks.append(kept.trace(own.given, other.given, trace, add))
    return walks[0], walks[-1]


def _trace_side(
    techniques: Sequence[Technique],
    wanted: tuple[bool, bool],
    own: Side,
    other: Side,
    add: Callable[[slice, Tables], None],
) -> Walks:
    """The walks of `own`. `add` gets rows of it and what their subpaths deposit at the points of `other`, in tables
    that are used again. `wanted`: what arrives, what leaves."""
    shape = len(own.ends.points), len(other.ends.points)
    chunk = len((fresh := _room(own.model, *shape, *wanted)).batches)
    vertices, reflections = _room_for_vertices(own), []
    traces = [(t.name, t.trace(own, other)) for t in techniques if t.trace is not None]
    for start in range(0, shape[0], chunk):
        rows = slice(start, min(start + chunk, shape[0]))
        tables = Tables(*(table[: rows.stop - start] for table in fresh))
        for table in tables:
            over_rows(_clear, len(table), table, least=rows_of_thread(table))
        for name, trace in traces:
            with stage(name):
                left = trace(rows, tables, Vertices(*(column[rows] for column in vertices)))
                if left is not None:
                    reflections.append(left)
                for table in (tables.arrive, tables.leave):
                    check_table(table, _origin(name, own, other, rows))
        add(rows, tables)
    del traces  # and their room
    if not reflections:
        return Walks(own, vertices, None)
    decay = own.model.once(late_decay)
    with stage("first reflections"):  # of consecutive points in one piece, which uses them up
        return Walks(own, vertices, gather_reflections(reflections, decay.rate, decay.reach))


def _room_for_vertices(side: Side) -> Vertices:
    """Of all points of a side; none before they are traced."""
    settings, bands = side.model.world.settings, side.model.world.air.shape[1]
    depth = settings.connection_depth if settings.connection_length > 0.0 else 1
    shape, surfaces = (len(side.ends.points), settings.connected), side.model.world.surfaces
    return Vertices(
        np.empty((*shape, depth), VERTEX),
        np.empty((*shape, depth, bands)),
        np.zeros(shape, np.int64),
        np.empty((*shape, CHANNELS)),
        np.empty((*shape, depth, group_count(surfaces)), np.uint16),
    )


def _origin(technique: str, a: Side, b: Side, rows: slice = slice(None)) -> Origin:
    return Origin(technique, a.given[rows], b.given, a.model.config.bands)


def _room(model: Model, rows: int, columns: int, arrive: bool, leave: bool) -> Tables:
    """Tables for the subpaths of some points, of those directions that are wanted."""
    bands = model.world.air.shape[1]
    of_row = 2 * 4 * columns * len(model.time_edges) * CHANNELS * bands
    threads = thread_count()
    chunk = min(max(_ROOM // of_row, threads), 4 * threads, rows)  # progress and Ctrl-C between them
    return Tables(
        empty_table(model, chunk, columns, arrive),
        empty_table(model, chunk, columns, leave),
        np.empty((chunk, columns, batch_rows(model), model.windows, bands), np.float32),
    )


def _clear(first: int, last: int, table: np.ndarray) -> None:
    table[first:last] = 0.0


def _late_energy(sums: Sums, table: np.ndarray) -> np.ndarray:
    """(rows, columns, bins, b): of the bins that `difference` has."""
    bins = sums.difference.shape[2]
    return table[:, :, table.shape[2] - bins :, 0]


def _error_of_windows(batches: np.ndarray) -> np.ndarray:
    """(A, B, windows, b) standard errors of energies in windows of time, by batches (A, B, K, windows, b)."""
    out = np.empty((*batches.shape[:2], *batches.shape[3:]), np.float32)

    def call(first: int, last: int) -> None:
        for i in range(first, last):
            squares = np.einsum("lkwb,lkwb->lwb", batches[i], batches[i], dtype=float)
            squares -= batches[i].sum(axis=1, dtype=float) ** 2 / BATCHES
            out[i] = np.sqrt(np.maximum(squares, 0.0) * BATCHES / (BATCHES - 1))

    over_rows(call, len(out), chunk=1)
    return out


def relative_error(made: Made) -> np.ndarray:
    """(S, L, 2, b) relative standard errors of the energy up to `EARLY_S` after the direct sound's time, and
    later; infinite where they rest on too few subpaths to be known.

    A window or a bin in which the split lies is shared by duration. Batch sums are each 1/BATCHES of the
    estimate: its variance is that of their sum. Where estimates by subpaths of either end differ by what this
    cannot explain, half of that is the error: rare subpaths that carry much may be in no batch of one end.
    """
    (rows, columns, bands), tile = made.tile.shape, made.tile
    early, batches = made.arrived.paths, made.sums.batches[:, :, :BATCHES]
    out = np.empty((rows, columns, 2, bands))
    start = np.searchsorted(early.pair, np.arange(rows + 1) * columns)

    def call(first: int, last: int) -> None:
        for i in range(first, last):  # one by one: they stay in a cache
            paths = slice(start[i], start[i + 1])
            own = early.pair[paths] - i * columns, early.length[paths], early.energy[paths]
            out[i] = _errors_of_point(made, i, *own, batches[i])

    over_rows(call, len(out), chunk=1)
    check_sums(out, Origin("error bars", tile.a.given, tile.b.given, tile.model.config.bands))
    return stated(out)


def _errors_of_point(
    made: Made,
    i: int,
    listener: np.ndarray,
    path_length: np.ndarray,
    path_energy: np.ndarray,
    batches: np.ndarray,
) -> np.ndarray:
    """(L, 2, b) `relative_error` of source `i`, `_UNKNOWN` where few batches carry the energy; its discrete
    paths are given with the `listener` of each."""
    tile, model = made.tile, made.tile.model
    energy, difference = made.sums.to_b[i, :, :, 0], made.sums.difference[i]
    edges, window = model.time_edges, model.world.window_of_bin
    starts = np.append(edges[np.unique(window, return_index=True)[1]], edges[-1])
    split = (tile.distance[i] / model.config.c + EARLY_S)[:, None]

    def late_share(edges: np.ndarray) -> np.ndarray:
        return np.clip((edges[1:] - split) / np.diff(edges), 0.0, 1.0)

    share = late_share(starts)
    share_of_window = np.stack([1.0 - share, share], axis=1)  # (L, 2, windows)
    of_batch = np.matmul(share_of_window[:, None], batches)  # (L, BATCHES, 2, b)
    spread = _STUDENT * of_batch.std(axis=1, ddof=1) * np.sqrt(BATCHES)
    share = late_share(edges)
    by_both = share[:, share.shape[1] - difference.shape[1] :]
    by_both = np.stack([1.0 - by_both, by_both], axis=1)
    apart = np.abs(np.matmul(by_both, difference))  # (L, 2, b)
    spread = np.where(apart > UNLIKELY * spread, apart, spread)
    late_energy = np.einsum("lt,ltb->lb", share, energy)
    reference = np.stack([energy.sum(axis=1) - late_energy, late_energy], axis=1).astype(float)
    reference[:, 0] += made.arrived.direct[i]
    late = path_length / model.config.c > split[listener, 0]
    np.add.at(reference, (listener, late.astype(int)), path_energy)
    error = np.divide(spread, reference, out=np.zeros_like(spread), where=reference > 0.0)
    inverse = 1.0 / effective_batches(share_of_window, batches, reference)
    of_bands = np.median(inverse, axis=-1, keepdims=True)  # they share the subpaths
    return np.where(0.5 * (inverse + of_bands) > 1.0 / LEAST_EFFECTIVE, _UNKNOWN, error)


def effective_batches(share: np.ndarray, batches: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(…, 2, b) how many of the batches carry an estimate, in the harmonic mean over energy.

    In a window of time they are as many as (sum of E_k)² / sum of E_k² alike ones; all carry what is exact. Of few
    lucky subpaths each is in a window of its own, and their sum over windows looks even. `share` (…, 2, windows)
    of each window's `batches` (…, BATCHES, windows, b) in the `reference` (…, 2, b).
    """
    whole = batches.sum(axis=-3, dtype=float)
    squares = np.square(batches, dtype=float).sum(axis=-3)
    over = np.divide(squares, whole, out=np.zeros_like(whole), where=whole > 0.0)
    exact = np.maximum(reference - np.matmul(share, whole), 0.0)
    by_number = exact / BATCHES + np.matmul(share, over)
    known = (reference > 0.0) & (by_number > 0.0)
    return np.divide(reference, by_number, out=np.full_like(reference, BATCHES), where=known)


def stated(error: np.ndarray) -> np.ndarray:
    """Relative errors, infinite where they rest on too few subpaths to be known."""
    return np.where(error >= _LARGEST_KNOWN, np.inf, error)


def _collect(
    model: Model,
    sources: np.ndarray,
    listeners: np.ndarray,
    energy: np.ndarray,
    direct: np.ndarray,
    length: np.ndarray,
    walls: np.ndarray,
    early: PathTable,
    error: np.ndarray,
) -> Echograms:
    """Tables and sorted paths as echograms with the errors of their energies."""
    c = model.config.c
    arrivals = Arrivals(
        early.length / c, early.energy, early.at_b, early.planes, early.kind, early.wedges, early.groups
    )
    start = np.searchsorted(early.pair, np.arange(len(sources) * len(listeners) + 1))
    return Echograms(
        model.config.bands,
        c,
        sources,
        listeners,
        model.time_edges,
        energy,
        np.ascontiguousarray(direct),
        length,
        walls,
        start,
        arrivals,
        error.astype(np.float32),
        air=model.config.air,
    )
