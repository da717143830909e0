"""What each technique makes: its share of the energy, its noise, its share of the time; and paths round edges.

Question: Which technique gives how much of the energy, of the noise and of the time?

Method: The house as labelled and with one material (absorption .2, scattering .3): per window and technique the
mean share of the energy of a pair, and the root mean square, over pairs, of its standard deviation over seeds
relative to all energy of the pair in that window. Mean over pairs of two different points, band from 775 to
3,409 Hz. What techniques take of the processor time of a tile of 12, 48 and 150 points, one thread.

Amortised: Compiling and loading kernels, and making the model.

Takes: 15 minutes. Argument: "cost" for the shares of processor time alone. Needs ../shared.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import house, one_material, shuffled_points
from soundspaces_sim.core.numerics.kernel import set_thread_count
from soundspaces_sim.echogram.echogram import KINDS, MIRRORS
from soundspaces_sim.transport.arrivals.prepared import prepare_wedges
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.state import ReflectionBlock, Tables, Vertices
from soundspaces_sim.transport.technique import Technique, TraceRows
from soundspaces_sim.transport.techniques import TECHNIQUES
from soundspaces_sim.transport.tile import Arrived, Side, Sums, Tile, Walks

WINDOWS_S = ((0.05, 0.1), (0.1, 0.2), (0.2, 0.35))
BAND, POINTS, SEEDS, LENGTH_S = 2, 12, 8, 0.8
TILES = (12, 48, 150)


class Clocked:
    """A technique that notes how long it takes."""

    def __init__(self, technique: Technique) -> None:
        self.technique = technique
        self.seconds = 0.0

    def _timed(self, door: Callable[..., Any] | None) -> Callable[..., Any] | None:
        if door is None:
            return None

        def through(*args: Any) -> Any:
            start = time.process_time()
            made = door(*args)
            self.seconds += time.process_time() - start
            return made

        return through

    def _trace(self, own: Side, other: Side) -> TraceRows:
        assert self.technique.trace is not None
        rows_of = self._timed(self.technique.trace(own, other))
        assert rows_of is not None
        return rows_of

    def watched(self) -> Technique:
        technique = self.technique
        return replace(
            technique,
            trace=self._trace if technique.trace else None,
            connect=self._timed(technique.connect),
            join=self._timed(technique.join),
        )


class Watched:
    """A technique that notes what it adds to a tile of one side, and how long it takes."""

    def __init__(self, technique: Technique) -> None:
        self.technique = technique
        self.added: np.ndarray | float = 0.0
        self.seconds = 0.0

    def _trace(self, own: Side, other: Side) -> TraceRows:
        assert self.technique.trace is not None
        trace = self.technique.trace(own, other)

        def rows_of(rows: slice, tables: Tables, vertices: Vertices) -> ReflectionBlock | None:
            before = tables.arrive[..., 0, BAND].copy(), tables.leave[..., 0, BAND].copy()
            start = time.process_time()
            left = trace(rows, tables, vertices)
            self.seconds += time.process_time() - start
            added = np.zeros((POINTS, POINTS, before[0].shape[2]))
            added[rows] += tables.arrive[..., 0, BAND] - before[0]
            added[:, rows] += (tables.leave[..., 0, BAND] - before[1]).transpose(1, 0, 2)
            self.added = self.added + added
            return left

        return rows_of

    def _connect(self, tile: Tile) -> Arrived:
        start = time.process_time()
        assert self.technique.connect is not None
        found = self.technique.connect(tile)
        self.seconds += time.process_time() - start
        return found

    def _join(self, tile: Tile, of_a: Walks, of_b: Walks, sums: Sums) -> None:
        before, start = sums.to_b[..., 0, BAND].copy(), time.process_time()
        assert self.technique.join is not None
        self.technique.join(tile, of_a, of_b, sums)
        self.seconds += time.process_time() - start
        self.added = self.added + (sums.to_b[..., 0, BAND] - before)

    def watched(self) -> Technique:
        return replace(
            self.technique,
            trace=self._trace if self.technique.trace else None,
            connect=self._connect if self.technique.connect else None,
            join=self._join if self.technique.join else None,
        )


def shares_of(title: str, scene: ss.Scene, points: np.ndarray) -> Table:
    """Share and noise of every technique by window."""
    config = ss.SimulationConfig(duration=LENGTH_S)
    simulate_tile(make_model(scene, points, config), points, None)  # compile and load
    energies: dict[str, list[list[np.ndarray]]] = {t.name: [] for t in TECHNIQUES}
    seconds = dict.fromkeys(energies, 0.0)
    for seed in range(SEEDS):
        model = make_model(scene, points, config, seed)
        watches = [Watched(t) for t in TECHNIQUES]
        echoes = simulate_tile(model, points, None, techniques=[w.watched() for w in watches])[0]
        edges = model.time_edges
        for watch in watches:
            added = np.broadcast_to(watch.added, (POINTS, POINTS, len(edges) - 1))
            cuts = [tuple(np.searchsorted(edges, t - 1e-9) for t in w) for w in WINDOWS_S]
            energies[watch.technique.name].append([added[:, :, a:b].sum(axis=2) for a, b in cuts])
            seconds[watch.technique.name] += watch.seconds
    off = ~np.eye(POINTS, dtype=bool)
    by_name = {name: np.array(values)[:, :, off] for name, values in energies.items()}
    total = sum(values.mean(axis=0) for values in by_name.values())
    rows = []
    for name, values in by_name.items():
        share = (values.mean(axis=0) / total).mean(axis=1)
        noise = np.sqrt((values.var(axis=0, ddof=1) / total**2).mean(axis=1))
        cells = [f"{s:.3f} ± {n:.3f}" for s, n in zip(share, noise, strict=True)]
        rows.append((name, seconds[name] / sum(seconds.values()), *cells))
    hidden = (echoes.walls > 0) & off
    bent = np.array(
        [any(a.kind != KINDS[MIRRORS] for a in echoes[i, j].arrivals) for i, j in np.argwhere(hidden)]
    )
    heads = ["technique", "share of time", *(f"{1e3 * a:.0f}–{1e3 * b:.0f} ms" for a, b in WINDOWS_S)]
    note = (
        f"{hidden.sum()} ordered pairs are out of sight, {bent.sum()} of them have a path round edges."
    )
    return table(f"{title}: share of the energy ± noise by window", heads, rows, note)


def cost(scene: ss.Scene, grid: np.ndarray) -> Table:
    """Processor time of the techniques, in parts of a tile's."""
    model = make_model(scene, grid, ss.SimulationConfig())
    rows = []
    set_thread_count(1)
    for points in (TILES[0], *TILES):  # the first one loads
        watches = [Clocked(t) for t in TECHNIQUES]
        start = time.process_time()
        tile = simulate_tile(model, grid[:points], None, techniques=[w.watched() for w in watches])
        total = time.process_time() - start
        shares = (w.seconds / total for w in watches)
        rows.append((points, float((tile[0].walls > 0).mean()), total, *shares))
    set_thread_count(None)
    heads = ["points", "pairs out of sight", ("tile", "s"), *(t.name for t in TECHNIQUES)]
    wedges = model.prepared.part(prepare_wedges).wedges
    title = f"{scene.name}, {len(wedges.length)} wedges: share of a tile's processor time"
    return table(title, heads, rows[1:])


def run(what: str = "all") -> list[Table]:
    """Costs, and shares in two scenes; ``"cost"``: costs alone."""
    if what not in ("all", "cost"):
        raise ValueError(f"expected all or cost, got {what!r}")
    scene = house()
    grid = shuffled_points(scene)
    tables = [cost(scene, grid)]
    if what == "all":
        points = grid[:POINTS]
        tables.append(shares_of(f"{scene.name} as labelled, {POINTS} points", scene, points))
        tables.append(shares_of(f"{scene.name} with one material", one_material(scene), points))
    return tables
