"""Single late bins, raw and smoothed: how far they are from the mean of other seeds' raw bins.

Question: By how much does smoothing change the error of single late bins?

Method: Per room, time and band the relative error of raw bins, and the ratio of that of smoothed ones to it:
root mean square over seeds (and the bins of a step of time), median over the pairs of 12 points. The reference
of a seed is the mean of the raw bins of all others; what it has of noise itself is taken off. Both from the
same subpaths, default settings; bins as stored and added up to 10 ms. A ratio below 1 is less error. Beside it
smoothing's share of the processor time of a tile, and what it does to a shard's bytes.

Amortised: Compiling and loading kernels, and making the model.

Takes: 30 minutes. Arguments: rooms (all). Needs ../shared.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from benchmarks.accuracy import ptb_studio
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import house, one_material, require, shoebox
from benchmarks.tools.shards import encoded
from soundspaces_sim.core.numerics.kernel import set_thread_count
from soundspaces_sim.transport.integrator import trace_tile
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.smoothing import smoothed
from tests.rooms import box
from tests.rooms import table as materials

MEASURES = ("core", "scene", "transport", "echogram", "dataset/format")
POINTS, SEEDS, LENGTH_S, WIDE_S = 12, 8, 0.8, 0.01
STEPS_S = ((0.06, 0.08), (0.12, 0.15), (0.2, 0.25), (0.3, 0.35))

Room = tuple[ss.Scene, np.ndarray]


def _on_grid(scene: ss.Scene, spacing: float) -> Room:
    grid = ss.make_grid(scene, spacing).points
    return scene, grid[np.random.default_rng(0).permutation(len(grid))[:POINTS]]


def _within(scene: ss.Scene) -> Room:
    low, high = scene.vertices.min(axis=0) + 0.4, scene.vertices.max(axis=0) - 0.4
    return scene, np.random.default_rng(1).uniform(low, high, (POINTS, 3))


def _one_material() -> Room:
    scene, points = _on_grid(house(), 1.0)
    return one_material(scene), points


ROOMS: dict[str, Callable[[], Room]] = {
    "house": lambda: _on_grid(house(), 1.0),
    "house, one material": _one_material,
    "demo": lambda: _on_grid(ss.load_scene("demo"), 0.75),
    "PTB studio": lambda: _on_grid(ptb_studio.load_studio("open")[0], 1.0),
    "shoebox": lambda: _within(shoebox()),
    # hard walls that scatter .02: two of them, the rest soft; and all of them
    "flutter": lambda: _within(
        box((7.0, 5.0, 3.0), materials([0.04, 0.5], [0.02, 0.02]), [0, 0, 1, 1, 1, 1])
    ),
    "hard box": lambda: _within(box((7.0, 5.0, 3.0), materials([0.1], [0.02]))),
    "corridor": lambda: _within(
        box((20.0, 2.0, 2.6), materials([0.05, 0.4, 0.2], [0.1, 0.3, 0.5]), [2, 2, 0, 0, 0, 1])
    ),
}


def _widened(energy: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(seeds, pairs, bins, bands) added up to `WIDE_S`."""
    rows = (edges[:-1] / WIDE_S + 1e-9).astype(int)
    return np.add.reduceat(energy, np.flatnonzero(np.diff(rows, prepend=-1)), axis=2)


def errors(raw: np.ndarray, bins: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(steps, bands) relative errors of single `bins` (seeds, pairs, bins, bands)."""
    seeds, mean = len(raw), raw.mean(axis=0)
    of_reference = raw.var(axis=0, ddof=1) / (seeds - 1)
    others = (raw.sum(axis=0) - raw) / (seeds - 1)
    square = (((bins - others) ** 2).mean(axis=0) - of_reference) / np.maximum(mean, 1e-30) ** 2
    out = []
    for start, end in STEPS_S:
        inside = (edges[:-1] > start - 1e-9) & (edges[1:] < end + 1e-9)
        out.append(np.sqrt(np.maximum(np.median(square[:, inside].mean(axis=1), axis=0), 0.0)))
    return np.array(out)


def measure(
    name: str, scene: ss.Scene, points: np.ndarray
) -> tuple[list[tuple[object, ...]], tuple[object, ...]]:
    """Rows of errors and ratios of a room, and its row of costs."""
    config = ss.SimulationConfig(duration=LENGTH_S)
    base = make_model(scene, points, config)
    smoothed(base, trace_tile(base, points[:2], None))  # compile and load
    pairs = np.triu_indices(POINTS, 1)
    runs: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    sizes, seconds = [0, 0], [0.0, 0.0]
    for seed in range(SEEDS):
        model = replace(base, seed=seed)
        start = time.process_time()
        traced = trace_tile(model, points, None)
        seconds[0] += time.process_time() - start
        for which in range(2):
            if which == 1:
                start = time.process_time()
                smoothed(model, traced)
                seconds[1] += time.process_time() - start
            runs[which].append(traced.forward.energy[..., 0, :][pairs].astype(float))
            rows = np.arange(POINTS)
            sizes[which] += len(encoded(traced.forward, rows, rows))
    edges, (raw, bins) = base.time_edges, (np.array(r) for r in runs)
    wide = np.append(np.unique(np.floor(edges[:-1] / WIDE_S + 1e-9)) * WIDE_S, edges[-1])
    ratios: list[float] = []
    rows_of: list[tuple[object, ...]] = []
    for title, e, r, b in (
        ("as stored", edges, raw, bins),
        ("10 ms", wide, _widened(raw, edges), _widened(bins, edges)),
    ):
        was, now = errors(r, r, e), errors(r, b, e)
        ratios += list((now / was).ravel())
        for (start, end), x, y in zip(STEPS_S, was, now, strict=True):
            before, ratio = (" ".join(f"{v:.3f}" for v in row) for row in (x, y / x))
            rows_of.append((name, title, f"{1e3 * start:.0f}–{1e3 * end:.0f}", before, ratio))
    cost = (
        name, float(np.mean(ratios)), max(ratios), seconds[1] / sum(seconds),
        1e6 * seconds[1] / SEEDS / POINTS**2, sizes[1] / sizes[0],
    )  # fmt: skip
    return rows_of, cost


def run(*rooms: str) -> list[Table]:
    """Errors and ratios by room, and what smoothing costs."""
    require(ptb_studio.FOLDER)
    set_thread_count(1)
    rows: list[tuple[object, ...]] = []
    costs = []
    for name in rooms or ROOMS:
        own, cost = measure(name, *ROOMS[name]())
        rows += own
        costs.append(cost)
    bands = "of the four bands"
    heads = ["room", "bins", ("time", "ms"), f"error, raw, {bands}", f"smoothed ×, {bands}"]
    of_cost = [
        "room", "mean ratio", "greatest", "share of a tile's time", ("per pair", "µs"), "bytes of a shard ×",
    ]  # fmt: skip
    return [table("Relative errors of single bins", heads, rows), table("What it costs", of_cost, costs)]
