"""A tile: two blocks of points in, the echograms between them out.

Traces the walks of every point, joins and merges those of every pair, adds the deterministic paths. The
unit of work, of memory and of resumption. A pair's result depends on its two points, the scene, the
config and the seed, never on what else is in the tile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np

from soundspaces_sim.base.rng import point_keys
from soundspaces_sim.echo.echogram import Arrivals, Echograms
from soundspaces_sim.transport.detector import Detectors, make_detectors
from soundspaces_sim.transport.model import EARLY_S, Engine, air_rates
from soundspaces_sim.transport.state import VERTEX_COLUMNS, Halves, SortedHalves, Vertices
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, WINDOWS
from soundspaces_sim.transport.techniques.connect import join_pairs
from soundspaces_sim.transport.techniques.direct import direct_paths
from soundspaces_sim.transport.techniques.images import find_sequences, mirror_paths
from soundspaces_sim.transport.techniques.merge import merge_pairs, sort_halves
from soundspaces_sim.transport.techniques.specular import trace_specular
from soundspaces_sim.transport.walk import first_harmonics, trace_points

Progress = Callable[[int], None]  # points traced


@dataclass(frozen=True)
class _Ends:
    """The points on one side of a tile."""

    points: np.ndarray  # relative to the scene's centre
    keys: np.ndarray
    detectors: Detectors


def _ends(engine: Engine, points: np.ndarray) -> _Ends:
    keys = point_keys(points, engine.seed)
    local = np.ascontiguousarray(points - engine.scene.center)
    config = engine.config
    detectors = make_detectors(
        engine.geometry, local, keys, config.radius_min, config.radius_growth, config.radius_max
    )
    return _Ends(local, keys, detectors)


def simulate_tile(
    engine: Engine,
    a: np.ndarray,
    b: np.ndarray | None,
    both_ways: bool = True,
    progress: Progress | None = None,
) -> tuple[Echograms, Echograms | None]:
    """Echograms a -> b and, with `both_ways`, b -> a from the same walks. `b` None: all pairs of a."""
    side_a = _ends(engine, a)
    side_b = side_a if b is None else _ends(engine, b)
    points_b = a if b is None else b
    direct, length, walls = direct_paths(
        engine.geometry, engine.surfaces, side_a.points, side_b.points, side_a.keys, side_b.keys,
        engine.config.least_distance,
    )  # fmt: skip
    direct = direct * np.exp(-length[..., None] * air_rates(engine.config))
    early_length = length + EARLY_S * engine.config.c
    if b is None:
        walked = _walk_all(engine, side_a, early_length, progress)
    else:
        walked = _walk_both(engine, side_a, side_b, early_length, both_ways, progress)
    _close_pairs(engine, side_a, side_b, early_length, walked)
    early = _early_paths(engine, side_a, side_b, b is None)
    forward = _collect(engine, a, points_b, walked.to_b, direct, length, walls, early, walked.batches)
    if b is None or not both_ways:
        return forward, None
    backward = _collect(
        engine, points_b, a, walked.to_a, direct.transpose(1, 0, 2), length.T, walls.T,
        early.reversed(len(a), len(points_b)), walked.batches.transpose(1, 0, 2, 3, 4),
    )  # fmt: skip
    return forward, backward


@dataclass(frozen=True)
class _Left:
    """What walks leave for joins and merges."""

    vertices: Vertices
    halves: SortedHalves


@dataclass(frozen=True)
class _Walked:
    """Tables and batch sums of a tile, what its walks left, and its pairs (i, j)."""

    to_b: np.ndarray  # (A, B, bins, 9, bands) a -> b
    to_a: np.ndarray  # (B, A, bins or 0, 9, bands) b -> a; `to_b` itself if all pairs of one side
    left_a: _Left
    left_b: _Left
    batches: np.ndarray  # (A, B, BATCHES, WINDOWS, bands)
    pairs: np.ndarray  # (n, 2)


def _walk_all(engine: Engine, side: _Ends, early: np.ndarray, progress: Progress | None) -> _Walked:
    """Walks of all points at all points."""
    n = len(side.points)
    to, leave = _table(engine, n, n), _table(engine, n, n)
    left, batches = _trace(engine, side, side, early, to, leave, progress, 0)
    for i in range(n):  # row by row: no second copy of the table
        to[i] += leave[:, i]
    batches = batches + batches.transpose(1, 0, 2, 3, 4)
    return _Walked(to, to, left, left, batches, np.argwhere(np.tri(n, dtype=bool).T))


def _walk_both(
    engine: Engine,
    side_a: _Ends,
    side_b: _Ends,
    early: np.ndarray,
    both_ways: bool,
    progress: Progress | None,
) -> _Walked:
    """Walks of a at b and of b at a; what is only needed for b -> a has no bins unless `both_ways`."""
    n_a, n_b = len(side_a.points), len(side_b.points)
    to_b, leave_a = _table(engine, n_a, n_b), _table(engine, n_a, n_b, both_ways)
    to_a, leave_b = _table(engine, n_b, n_a, both_ways), _table(engine, n_b, n_a)
    left_a, batches_a = _trace(engine, side_a, side_b, early, to_b, leave_a, progress, 0)
    left_b, batches_b = _trace(
        engine, side_b, side_a, np.ascontiguousarray(early.T), to_a, leave_b, progress, n_a
    )
    for i in range(n_a):
        to_b[i] += leave_b[:, i]
    if both_ways:
        for j in range(n_b):
            to_a[j] += leave_a[:, j]
    batches = batches_a + batches_b.transpose(1, 0, 2, 3, 4)
    pairs = np.argwhere(np.ones((n_a, n_b), bool))
    return _Walked(to_b, to_a, left_a, left_b, batches, pairs)


def _table(engine: Engine, rows: int, columns: int, wanted: bool = True) -> np.ndarray:
    bins, bands = len(engine.time_edges) - 1, engine.air.shape[1]
    return np.zeros((rows, columns, bins if wanted else 0, CHANNELS, bands), np.float32)


def _trace(
    engine: Engine,
    own: _Ends,
    other: _Ends,
    early: np.ndarray,
    arrive: np.ndarray,
    leave: np.ndarray,
    progress: Progress | None,
    before: int,
) -> tuple[_Left, np.ndarray]:
    """Fill the tables with the walks of `own` at `other`; what they leave, and batch sums."""
    bands = engine.air.shape[1]
    vertices = _empty_vertices(engine, len(own.points), bands)
    batches = np.zeros((*arrive.shape[:2], BATCHES, WINDOWS, bands))
    chunk = 4 * numba.get_num_threads()  # progress and Ctrl-C between calls
    parts: list[SortedHalves] = []
    # Room for as many halves as walks have events in typical rooms; more where it turns out too small.
    capacity = engine.settings.walks * 32 if engine.settings.merging else 0
    for start in range(0, len(own.points), chunk):
        some = slice(start, start + chunk)
        rows = Vertices(*(v[some] for v in vertices))
        while True:
            halves = _empty_halves(len(own.points[some]), capacity, bands)
            trace_specular(
                engine.geometry, engine.surfaces, engine.settings, own.points[some], own.keys[some],
                own.detectors.section[some], other.detectors, early[some], engine.bin_of_step,
                engine.air, arrive[some], leave[some], batches[some],
            )  # fmt: skip
            trace_points(
                engine.geometry, engine.surfaces, engine.patches, engine.settings, own.points[some],
                own.keys[some], own.detectors.section[some], other.detectors, early[some],
                engine.bin_of_step, engine.air, rows, halves, arrive[some], leave[some], batches[some],
            )  # fmt: skip
            most = int(halves.count.max())
            if most <= capacity:
                break
            capacity = most + most // 8
            for filled in (arrive[some], leave[some], batches[some], rows.count):
                filled[:] = 0
        parts.append(_sort(engine, own.keys[some], halves))
        if progress is not None:
            progress(before + min(start + chunk, len(own.points)))
    return _Left(vertices, _concatenate(parts)), batches


def _empty_halves(points: int, capacity: int, bands: int) -> Halves:
    return Halves(
        np.empty((points, capacity), np.int32), np.empty((points, capacity), np.float32),
        np.empty((points, capacity), np.float32), np.empty((points, capacity), np.int32),
        np.empty((points, capacity, bands), np.float32), np.zeros(points, np.int64),
    )  # fmt: skip


def _sort(engine: Engine, keys: np.ndarray, halves: Halves) -> SortedHalves:
    """The halves of a few points by patch, without the unused room."""
    order, start = sort_halves(halves, len(engine.patches.weight))
    chosen = [(i, order[i, :n]) for i, n in enumerate(halves.count)]

    def pick(column: np.ndarray) -> np.ndarray:
        return np.concatenate([column[i, rows] for i, rows in chosen])

    before = np.concatenate([[0], np.cumsum(halves.count)[:-1]])
    walks = engine.settings.walks if engine.settings.merging else 0
    return SortedHalves(
        keys, start + before[:, None], first_harmonics(keys, walks), pick(halves.length),
        pick(halves.previous), pick(halves.walk), pick(halves.beta),
    )  # fmt: skip


def _concatenate(parts: list[SortedHalves]) -> SortedHalves:
    before = np.concatenate([[0], np.cumsum([len(part.length) for part in parts])[:-1]])
    moved = [p._replace(start=p.start + n) for p, n in zip(parts, before, strict=True)]
    return SortedHalves(*(np.concatenate(column) for column in zip(*moved, strict=True)))


def _close_pairs(
    engine: Engine, side_a: _Ends, side_b: _Ends, early: np.ndarray, walked: _Walked
) -> None:
    """Join and merge the walks of every pair of the tile, into its tables."""
    settings, left_a, left_b = engine.settings, walked.left_a, walked.left_b
    if settings.join_length > 0.0:
        join_pairs(
            engine.geometry, engine.surfaces, settings, side_a.detectors,
            engine.bin_of_step, engine.air, walked.pairs,
            side_a.points, side_a.keys, side_a.detectors.section, left_a.vertices,
            side_b.points, side_b.keys, side_b.detectors.section, left_b.vertices,
            early, walked.to_b, walked.to_a, walked.batches,
        )  # fmt: skip
    if settings.merging:

        def flat(table: np.ndarray) -> np.ndarray:
            return table.reshape(*table.shape[:3], table.shape[3] * table.shape[4])  # a view

        merge_pairs(
            settings, 4.0 * engine.patches.weight, engine.bin_of_step,
            walked.pairs, left_a.halves, left_b.halves, early, flat(walked.to_b), flat(walked.to_a),
            walked.batches,
        )  # fmt: skip
    if side_a is side_b:  # each pair was closed once: mirror its batches
        lower = np.tri(len(side_a.points), k=-1, dtype=bool)
        walked.batches[lower] = walked.batches.transpose(1, 0, 2, 3, 4)[lower]


def _empty_vertices(engine: Engine, points: int, bands: int) -> Vertices:
    walks, depth = engine.settings.joined, engine.settings.join_depth
    if engine.settings.join_length <= 0.0:
        depth = 1
    return Vertices(
        np.empty((points, walks, depth, VERTEX_COLUMNS)),
        np.empty((points, walks, depth, bands)),
        np.zeros((points, walks), np.int64),
        np.empty((points, walks, CHANNELS)),
    )


@dataclass(frozen=True)
class _EarlyPaths:
    """Early mirror paths of a tile, sorted by (pair, length). Directions at both ends."""

    pair: np.ndarray  # (n,) i * columns + j
    length: np.ndarray  # (n,)
    at_b: np.ndarray  # (n, 3)
    at_a: np.ndarray  # (n, 3)
    energy: np.ndarray  # (n, bands), air included
    planes: np.ndarray  # (n, 2) in order from a

    def reversed(self, rows: int, columns: int) -> _EarlyPaths:
        """The same paths from b to a."""
        pair = self.pair % columns * rows + self.pair // columns
        planes = np.where(self.planes[:, 1:] >= 0, self.planes[:, ::-1], self.planes)
        return _EarlyPaths(pair, self.length, self.at_a, self.at_b, self.energy, planes).sorted()

    def sorted(self) -> _EarlyPaths:
        order = np.lexsort((self.planes[:, 1], self.planes[:, 0], self.length, self.pair))
        return _EarlyPaths(
            self.pair[order], self.length[order], self.at_b[order], self.at_a[order],
            self.energy[order], self.planes[order],
        )  # fmt: skip


def _early_paths(engine: Engine, side_a: _Ends, side_b: _Ends, same: bool) -> _EarlyPaths:
    geometry, surfaces, mirrors = engine.geometry, engine.surfaces, engine.mirrors
    planes = len(mirrors.offset)

    def sequences(side: _Ends) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        seen = find_sequences(geometry, surfaces, mirrors, side.points)
        rows = np.argwhere(seen)
        start = np.searchsorted(rows[:, 0], np.arange(len(side.points) + 1))
        codes = rows[:, 1:].copy()
        codes[codes[:, 1] == planes, 1] = -1
        return seen, start, codes

    seen_a, start_a, codes_a = sequences(side_a)
    _, start_b, codes_b = (seen_a, start_a, codes_a) if same else sequences(side_b)
    n_a, n_b, bands = len(side_a.points), len(side_b.points), engine.air.shape[1]
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    for i in range(n_a if planes else 0):
        partners = np.arange(i if same else 0, n_b)
        p = side_a.points[i]
        rows, found = mirror_paths(
            geometry, surfaces, mirrors, (p[0], p[1], p[2]), codes_a[start_a[i] : start_a[i + 1]],
            seen_a[i], side_b.points, partners, start_b, codes_b,
            side_a.keys[i] > side_b.keys[partners],
        )  # fmt: skip
        parts.append((i * n_b + partners[np.nonzero(found)[0]], rows[found]))
    pair = np.concatenate([k for k, _ in parts] or [np.empty(0, np.int64)])
    rows = np.concatenate([r for _, r in parts] or [np.empty((0, 9 + bands))])
    energy = rows[:, 9:] * np.exp(-rows[:, 2, None] * air_rates(engine.config))
    early = _EarlyPaths(
        pair, rows[:, 2], rows[:, 3:6], rows[:, 6:9], energy, rows[:, :2].astype(np.int64)
    )
    if same:  # the other direction of every pair of two different points
        back = early.reversed(n_a, n_b)
        other = back.pair // n_b != back.pair % n_b
        early = _EarlyPaths(
            *(
                np.concatenate([x, y[other]])
                for x, y in zip(vars(early).values(), vars(back).values(), strict=True)
            )
        )
    return early.sorted()


def _collect(
    engine: Engine,
    sources: np.ndarray,
    listeners: np.ndarray,
    energy: np.ndarray,
    direct: np.ndarray,
    length: np.ndarray,
    walls: np.ndarray,
    early: _EarlyPaths,
    batches: np.ndarray,
) -> Echograms:
    c = engine.config.c
    n_pairs = len(sources) * len(listeners)
    total = batches.sum(axis=2)  # (S, L, windows, bands)
    # Batch sums are each 1/BATCHES of the estimate: its variance is that of their sum.
    spread = batches.std(axis=2, ddof=1) * np.sqrt(BATCHES)
    reference = total.copy()
    reference[:, :, 0] += direct
    s, l = early.pair // len(listeners), early.pair % len(listeners)
    late = early.length > length[s, l] + EARLY_S * c
    np.add.at(reference, (s, l, late.astype(int)), early.energy)
    error = np.divide(spread, reference, out=np.zeros_like(spread), where=reference > 0.0)
    arrivals = Arrivals(early.length / c, early.energy, early.at_b, early.planes)
    return Echograms(
        engine.config.bands, c, sources, listeners, engine.time_edges, energy,
        np.ascontiguousarray(direct), length, walls,
        np.searchsorted(early.pair, np.arange(n_pairs + 1)), arrivals,
        error.astype(np.float32),
    )  # fmt: skip
