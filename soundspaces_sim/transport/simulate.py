"""Scene and points in, echograms out. No files.

`simulate` does it for any sources and listeners. `simulate_pairs` is what dataset jobs repeat for every
tile: with a target error it adds rounds of subpaths to the pairs that need them.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.errors import PointError
from soundspaces_sim.core.interrupts import deferred
from soundspaces_sim.core.memory import check_memory, free_memory
from soundspaces_sim.core.numerics.kernel import thread_count
from soundspaces_sim.core.profile import profiled
from soundspaces_sim.core.simulation_config import of_simulation
from soundspaces_sim.echogram.assembly import Assembly
from soundspaces_sim.echogram.directed import directed_table
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.endpoints import Listener, Points, Source, as_ends
from soundspaces_sim.scene.enclosure import check_ends
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.integrator import Made, Progress, relative_error, run_techniques, traced
from soundspaces_sim.transport.kept_traces import KeptTraces
from soundspaces_sim.transport.low_method import LowRuns, low_method
from soundspaces_sim.transport.memory import tile_memory
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.preparation import make_model, of_round
from soundspaces_sim.transport.radiance_transfer.prepared import late_technique
from soundspaces_sim.transport.rounds import round_sizes, statement, takes_part
from soundspaces_sim.transport.smoothing import smoothed
from soundspaces_sim.transport.tables import CHANNELS
from soundspaces_sim.transport.techniques import TECHNIQUES

_log = logging.getLogger(__name__)
SIDE = 512  # points on one side of a tile at most
_OF_FREE = 0.5  # share of the free memory that a tile may take


def as_points(points: ArrayLike, what: str) -> np.ndarray:
    """(n, 3) float64, finite; one point may be given as (3,). Raises `PointError`."""
    array = np.asarray(points, float)
    if array.ndim == 1 and array.size == 3:
        array = array[None]
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise PointError(f"{what}: expected shape (n, 3) in m, n >= 1, got {array.shape}")
    if not np.isfinite(array).all():
        i = int((~np.isfinite(array)).any(axis=1).argmax())
        raise PointError(f"{what}: point {i} is not finite: {array[i]}")
    return np.ascontiguousarray(array) + 0.0  # -0.0 and 0.0 are the same place and the same key


def simulate(
    scene: Scene | str | Path | Any,
    sources: Points,
    listeners: Points,
    config: SimulationConfig | None = None,
    seed: int = 0,
) -> Echograms:
    """Echograms between all `sources` (S, 3) and `listeners` (L, 3), in m, anywhere in the scene.

    `scene`: a `Scene`, or what `load_scene` takes: a name, a path, a `trimesh.Trimesh`. `sources` and
    `listeners` may be records, `Source` or `Listener`, alone or in a list: their directivities are applied, and
    a place with several records is simulated once. The result grows with S L, some 22 kB a pair; working memory
    beside it is bounded. Raises `SceneError`, and `PointError` for points that are not finite or lie outside an
    enclosed scene, and for more of them than there is memory for: `build_dataset` writes its results as it goes.
    """
    ready = load_scene(scene)
    with deferred(), profiled("simulate"):
        config = of_simulation(config or SimulationConfig())
        (places, heads), (spots, ears) = as_ends(sources, Source), as_ends(listeners, Listener)
        a, b = as_points(places, "sources"), as_points(spots, "listeners")
        model = model_between(ready, a, b, config, seed)
        if heads is not None or ears is not None:
            found = _simulate_ends(model, a, b, heads, ears)
        else:
            found = simulate_between(model, a, b)
        _warn_of_silence(model, found)
        return with_notes(model, found)


def _warn_of_silence(model: Model, echoes: Echograms) -> None:
    """Log that nothing arrives, anywhere or at some points: zeros with an error of zero look like a result."""
    heard = (echoes.energy != 0).any(axis=(2, 3, 4)) | (echoes.direct_energy != 0).any(axis=2)
    heard |= (np.diff(echoes.early_start) > 0).reshape(heard.shape)
    name = model.scene.name
    if not heard.any():
        _log.warning(
            "%s: no sound arrives between any two points within %g s: check the unit of lengths, the "
            "places and the duration",
            name,
            model.duration,
        )
        return
    for what, points, axis in (("source", echoes.sources, 1), ("listener", echoes.listeners, 0)):
        for i in np.flatnonzero(~heard.any(axis=axis)):
            x, y, z = points[i]
            _log.warning(
                "%s: no sound goes between %s %d at (%.3f, %.3f, %.3f) m and any other point: is it walled in?",
                name, what, i, x, y, z,
            )  # fmt: skip


def with_notes(model: Model, echoes: Echograms) -> Echograms:
    """The echograms of a simulation with what was decided for it, and what has become of the error that was asked
    for; the log has it too."""
    met = statement(echoes, model.config)
    if met:
        missed = not (echoes.relative_error <= model.config.target_error).all()
        _log.log(logging.WARNING if missed else logging.INFO, "%s: %s", model.scene.name, met)
    notes = f"late sound that was scattered: {late_technique(model)}", met
    return replace(echoes, notes=tuple(filter(None, notes)))


def model_between(
    scene: Scene, a: np.ndarray, b: np.ndarray, config: SimulationConfig | None, seed: int
) -> Model:
    """The model of a job between (S, 3) sources and (L, 3) listeners. Raises `PointError` for points outside."""
    check_ends(scene, a, b)
    return make_model(scene, np.unique(np.concatenate([a, b]), axis=0), config, seed)


def simulate_between(model: Model, a: np.ndarray, b: np.ndarray) -> Echograms:
    """Echograms from (S, 3) sources to (L, 3) listeners; all pairs at once where they are the same points."""
    if a.shape == b.shape and np.array_equal(a, b):
        return simulate_pairs(model, a, None)[0]
    return simulate_pairs(model, a, b, both_ways=False)[0]


def _simulate_ends(
    model: Model,
    a: np.ndarray,
    b: np.ndarray,
    sources: tuple[Source, ...] | None,
    listeners: tuple[Listener, ...] | None,
) -> Echograms:
    """Echograms between records at `a` and `b`; a directive source needs the way back as well."""
    places, rows = np.unique(a, axis=0, return_inverse=True)
    spots, columns = np.unique(b, axis=0, return_inverse=True)
    back: Echograms | None
    if np.array_equal(places, spots):
        there = back = simulate_pairs(model, places, None)[0]
    else:
        directive = any(s.directivity is not None for s in sources or ())
        there, back = simulate_pairs(model, places, spots, both_ways=directive)
    return directed_table(there, back, rows.ravel(), columns.ravel(), sources, listeners)


@deferred()  # once, not 1,300 times for a small room
def simulate_pairs(
    model: Model,
    a: np.ndarray,
    b: np.ndarray | None,
    both_ways: bool = True,
    progress: Progress | None = None,
    kept: KeptTraces | None = None,
    waves: LowRuns | None = None,
) -> tuple[Echograms, Echograms | None]:
    """Echograms a -> b and, with `both_ways`, b -> a; `b` None: all pairs of a, in one table. `kept`, `waves`: of
    this model, for tiles that come one after the other.

    More than `SIDE` points, or than memory allows, are taken in tiles: no result depends on them. `progress` is
    told how many points have been traced, once per tile that they are in. Raises `PointError` if there is no room
    for the result, `ConfigError` if there is none for a tile of one point.
    """
    others = a if b is None else b
    _check_room(model, len(a), len(others), 2 if b is not None and both_ways else 1)
    there, back = simulate_rays(model, a, b, both_ways, progress, kept)
    method = low_method(model.config)
    if method is None:
        return there, back
    return method.with_waves(waves or method.make_runs(model, None, None), model.config, there, back)


def simulate_rays(
    model: Model,
    a: np.ndarray,
    b: np.ndarray | None,
    both_ways: bool = True,
    progress: Progress | None = None,
    kept: KeptTraces | None = None,
) -> tuple[Echograms, Echograms | None]:
    """`simulate_pairs` without waves."""
    others = a if b is None else b
    side = largest_side(model, len(a) if b is None else 0)
    if max(len(a), len(others)) <= side:
        return _simulate_tile(model, a, b, both_ways, progress, kept)
    forward = Assembly(a, others)
    backward = forward if b is None else Assembly(others, a)
    done = 0

    def told(traced: int) -> None:
        if progress is not None:
            progress(done + traced)

    for rows in _spans(len(a), side):
        for columns in _spans(len(others), side):
            if b is None and columns.start < rows.start:
                continue
            same = b is None and columns == rows
            there, back = _simulate_tile(
                model, a[rows], None if same else others[columns], both_ways or b is None, told
            )
            done += rows.stop - rows.start + (0 if same else columns.stop - columns.start)
            forward.put(rows, columns, there)
            if back is not None:
                backward.put(columns, rows, back)
    return forward.table(), backward.table() if b is not None and both_ways else None


def largest_side(model: Model, points: int) -> int:
    """Points on a side of what is simulated as one, at most: all `points` with themselves if they fit, else those
    of two sides. Raises `ConfigError` if there is no memory for one."""
    memory = tile_memory(model, thread_count())
    check_memory(
        memory.of(1), f"echograms of {model.duration:g} s in {len(model.time_edges) - 1:,} bins"
    )
    room = _OF_FREE * free_memory()
    if 0 < points <= SIDE and tile_memory(model, thread_count(), same=True).of(points) <= room:
        return max(points, min(SIDE, memory.largest_side(room)))
    return min(SIDE, memory.largest_side(room))


def _spans(points: int, side: int) -> list[slice]:
    """About equal parts of at most `side` points."""
    ends = np.linspace(0, points, -(-points // side) + 1).astype(int)
    return [slice(*span) for span in pairwise(ends.tolist())]


def _check_room(model: Model, rows: int, columns: int, ways: int) -> None:
    of_pair = 4 * (len(model.time_edges) - 1) * CHANNELS * model.world.air.shape[1]
    wanted, free = float(ways * rows * columns * of_pair), free_memory()
    if wanted > free:
        raise PointError(
            f"{rows} sources × {columns} listeners: their echograms take {wanted / 1e9:.1f} GB of memory, and "
            f"{free / 1e9:.1f} GB are free; simulate some at a time, or let build_dataset write them to disk"
        )


def _simulate_tile(
    model: Model,
    a: np.ndarray,
    b: np.ndarray | None,
    both_ways: bool,
    progress: Progress | None,
    kept: KeptTraces | None = None,
) -> tuple[Echograms, Echograms | None]:
    """As `simulate_pairs`.

    Without `target_error` one round of subpaths. With it, rounds with subpaths of their own (`rounds`): a pair
    takes part until its own error bars (early and late, every band) are below the target or `max_walks`
    are spent, so its result is the same in any tile. Late bins are smoothed at last. `progress` is told of the
    first round.
    """
    made = run_techniques(model, a, b, both_ways, progress, kept=kept)
    if model.config.target_error is not None:
        _add_rounds(made, both_ways)
    return smoothed(model, traced(made, both_ways))


def _add_rounds(made: Made, both_ways: bool) -> None:
    """Let the sums of a first round be the means over all rounds in which a pair takes part."""
    tile, sums, model = made.tile, made.sums, made.tile.model
    config = model.asked or model.config
    sizes = round_sizes(config)
    done = np.full(tile.shape[:2], sizes[0])
    by_subpaths = [technique for technique in TECHNIQUES if technique.connect is None]
    error = relative_error(made).max(axis=(2, 3))
    for number, size in list(enumerate(sizes))[1:]:
        wanted = takes_part(error, done, number, config)
        if not wanted.any():
            continue
        rows, columns = np.flatnonzero(wanted.any(axis=1)), np.flatnonzero(wanted.any(axis=0))
        a, b = tile.a.given[rows], None if tile.same else tile.b.given[columns]
        of_size = of_round(model, number, size)
        more = run_techniques(of_size, a, b, both_ways, techniques=by_subpaths).sums
        i, j = np.nonzero(wanted[np.ix_(rows, columns)])
        s, l = rows[i], columns[j]
        done[s, l] += size
        share = size / done[s, l]
        _average(sums.to_b, s, l, more.to_b[i, j], share)
        _average(sums.batches, s, l, more.batches[i, j], share)
        _average(sums.difference, s, l, more.difference[i, j], share)
        if not tile.same and sums.to_a.shape[2]:
            _average(sums.to_a, l, s, more.to_a[j, i], share)
        error = relative_error(made).max(axis=(2, 3))


def _average(
    mean: np.ndarray, row: np.ndarray, column: np.ndarray, fresh: np.ndarray, share: np.ndarray
) -> None:
    """Add a round, which has a `share` of all subpaths so far, to the running mean of the pairs (row, column)."""
    weight = share.astype(np.float32).reshape(-1, *(1,) * (mean.ndim - 2))
    mean[row, column] += (fresh - mean[row, column]) * weight
