"""Speed of the transport engine on a real house: ratios within one run.

Question: How long does the engine take for a pair, and what does that buy in accuracy?

Method: aws_small_house. All pairs of N points in tiles as a dataset job cuts them, 250 subpaths; all pairs of one
tile by number of subpaths, with the mean |difference| of energy decay curves (dB, per band, down to -30 dB) of
two seeds over all pairs of two different points (against a converged reference it is 1 / sqrt(2) of that); the
techniques' shares of a tile; one thread against two. By the clock.

Amortised: Compiling and loading kernels, and making the scene and the model ready, are not counted.

Takes: 15 minutes. Needs ../shared.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.curves import decay_curves, edc_difference
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import house
from soundspaces_sim.build.plan import block_size, make_tiles
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import simulate_pairs
from soundspaces_sim.transport.techniques import TECHNIQUES

MEASURES = ("core", "scene", "transport", "echogram")
_COUNTS = (50, 100, 200, 400, 566)
_CASES = ((180, 1000, True), (60, 1000, True), (60, 1000, False), (60, 2000, True))


def _timed(model: Model, points: np.ndarray) -> tuple[float, Echograms]:
    start = time.perf_counter()
    echoes = simulate_tile(model, points, None)[0]
    return time.perf_counter() - start, echoes


def _model(scene: ss.Scene, points: np.ndarray, seed: int = 0, **settings: object) -> Model:
    return make_model(scene, points, ss.SimulationConfig(duration=0.8, **settings), seed)


def _stage_times(model: Model, points: np.ndarray) -> dict[str, float]:
    """Share of a tile's time in each technique."""
    spent = {technique.name: 0.0 for technique in TECHNIQUES}

    def clocked(name: str, door: Callable[..., Any] | None) -> Callable[..., Any] | None:
        def call(*args: Any) -> Any:
            start = time.perf_counter()
            assert door is not None
            made = door(*args)
            spent[name] += time.perf_counter() - start
            return made

        return call if door is not None else None

    clocks = [
        replace(t, trace=clocked(t.name, t.trace), connect=clocked(t.name, t.connect))
        for t in TECHNIQUES
    ]
    start = time.perf_counter()
    simulate_tile(model, points, None, techniques=clocks)
    total = time.perf_counter() - start
    return {name: seconds / total for name, seconds in spent.items()}


def _run_tiles(model: Model, points: np.ndarray) -> float:
    """Seconds for all pairs, cut into tiles as a dataset job cuts them; results are dropped."""
    start = time.perf_counter()
    for t in make_tiles(len(points), block_size(len(points), model)):
        a, b = points[slice(*t.a)], None if t.a == t.b else points[slice(*t.b)]
        simulate_pairs(model, a, b)
    return time.perf_counter() - start


def _tiles(scene: ss.Scene) -> Table:
    fine = ss.make_grid(scene, 0.55).points
    fine = fine[np.random.default_rng(1).permutation(len(fine))]
    rows = []
    for n in _COUNTS:
        if n > len(fine):
            raise ValueError(f"{scene.name}: expected at least {n} points, got {len(fine)}")
        t = _run_tiles(_model(scene, fine, walks=250), fine[:n])
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        rows.append((n, t, t / n**2 * 1e3, n**2 / t, peak))
    heads = ["points", ("time", "s"), ("per pair", "ms"), ("pairs", "1/s"), ("peak memory", "MB")]
    return table("All pairs in tiles of a job, 250 subpaths per point", heads, rows)


def _by_walks(scene: ss.Scene, grid: np.ndarray, shuffled: np.ndarray) -> Table:
    rows = []
    for n, walks, transfer in _CASES:
        times, curves, bins = [], [], []
        for seed in (1, 2):
            t, echoes = _timed(
                _model(scene, grid, seed, walks=walks, radiance_transfer=transfer), shuffled[:n]
            )
            times.append(t)
            curves.append(decay_curves(echoes))
            bins.append(_late_bins(echoes))
        late = float(np.median(echoes.relative_error[:, :, 1]))
        ms = float(np.mean(times)) / min(n, len(grid)) ** 2 * 1e3
        shown = "yes" if transfer else "no"
        rows.append((n, walks, shown, ms, 1e3 / ms, edc_difference(*curves), late, _bin_error(*bins)))
    heads = [
        "points", "subpaths", "radiance transfer", ("per pair", "ms"), ("pairs", "1/s"), ("|ΔEDC|", "dB"),
        "relative error of late energy", "of late 10 ms bins",
    ]  # fmt: skip
    return table("All pairs of one tile; differences of two seeds, errors are medians", heads, rows)


def run() -> list[Table]:
    """Tiles, walks, techniques, threads."""
    scene = house()
    grid = ss.make_grid(scene, 1.0).points
    shuffled = grid[np.random.default_rng(0).permutation(len(grid))]
    _timed(_model(scene, grid, walks=16), shuffled[:4])  # compile
    simulate_pairs(_model(scene, grid, walks=16), shuffled[:2], shuffled[2:4])
    points, threads = shuffled[:100], thread_count()
    tables = [_tiles(scene), _by_walks(scene, grid, shuffled)]
    shares = _stage_times(_model(scene, grid, walks=1000), points)
    title = "Share of a tile's time by technique, 100 points, 1,000 subpaths"
    tables.append(table(title, ["technique", "share"], list(shares.items())))
    model = _model(scene, grid, walks=1000)
    both, _ = _timed(model, points[:60])
    set_thread_count(1)
    one, _ = _timed(model, points[:60])
    set_thread_count(threads)
    heads = ["threads", ("time", "s")]
    return [*tables, table("A tile of 60 points by threads", heads, [(1, one), (threads, both)])]


def _late_bins(echoes: Echograms) -> np.ndarray:
    """(S, L, bins, bands) energy of the 10 ms bins from 200 to 400 ms."""
    first, last = np.searchsorted(echoes.time_edges, (0.2 - 1e-9, 0.4 - 1e-9))
    return np.asarray(echoes.energy[:, :, first:last, 0])


def _bin_error(a: np.ndarray, b: np.ndarray) -> float:
    """Median relative standard error of single bins, from two seeds."""
    off = ~np.eye(len(a), dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.abs(a - b)[off] / (0.5 * (a + b)[off])
    # The median of |x| of a normal x is 0.674 standard deviations; a difference has sqrt(2) of one.
    return float(np.nanmedian(relative) / 0.6745 / np.sqrt(2.0))
