"""Single late bins, as they come and smoothed: how far they are from the mean of other seeds' raw bins.

    .venv/bin/python -m benchmarks.bins [rooms]

Per room, time and band the relative error of raw bins, and the ratio of that of smoothed ones to it: root mean
square over seeds (and the bins of a step of time), median over the pairs of 12 points. The reference of a seed is
the mean of the raw bins of all others; what it has of noise itself is taken off. Both from the same walks, default
settings; bins as stored and added up to 10 ms. A ratio below 1 is less error. Beside it what smoothing takes of the
processor time of a tile, and what it does to a shard's bytes. Rooms whose data are absent are left out.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from benchmarks import ptb_studio
from benchmarks.alternatives import one_material, shoebox
from benchmarks.engine import HOUSE
from soundspaces_sim.core.numerics.kernel import set_thread_count
from soundspaces_sim.dataset.format.writing import encode_echograms
from soundspaces_sim.transport.integrator import smoothed, trace_tile
from soundspaces_sim.transport.preparation import make_model
from tests.rooms import box, table

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
    scene, points = _on_grid(ss.load_scene(HOUSE), 1.0)
    return one_material(scene), points


ROOMS: dict[str, Callable[[], Room]] = {
    "house": lambda: _on_grid(ss.load_scene(HOUSE), 1.0),
    "house, one material": _one_material,
    "demo": lambda: _on_grid(ss.load_scene("demo"), 0.75),
    "PTB studio": lambda: _on_grid(ptb_studio.load_studio("open")[0], 1.0),
    "shoebox": lambda: _within(shoebox()),
    # hard walls that scatter .02: two of them, the rest soft; and all of them
    "flutter": lambda: _within(
        box((7.0, 5.0, 3.0), table([0.04, 0.5], [0.02, 0.02]), [0, 0, 1, 1, 1, 1])
    ),
    "hard box": lambda: _within(box((7.0, 5.0, 3.0), table([0.1], [0.02]))),
    "corridor": lambda: _within(
        box((20.0, 2.0, 2.6), table([0.05, 0.4, 0.2], [0.1, 0.3, 0.5]), [2, 2, 0, 0, 0, 1])
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


def measure(name: str, scene: ss.Scene, points: np.ndarray) -> list[float]:
    """Print a room's lines; its ratios."""
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
            sizes[which] += len(encode_echograms(traced.forward, rows, rows, _ATTRIBUTES))
    edges, (raw, bins) = base.time_edges, (np.array(r) for r in runs)
    wide = np.append(np.unique(np.floor(edges[:-1] / WIDE_S + 1e-9)) * WIDE_S, edges[-1])
    print(
        f"\n{name}: {seconds[1] / sum(seconds):.4f} of the processor time of a tile of {POINTS} points,"
        f" {1e6 * seconds[1] / SEEDS / POINTS**2:.0f} µs per pair; bytes of a shard × {sizes[1] / sizes[0]:.3f}"
    )
    ratios: list[float] = []
    for title, e, r, b in (
        ("as stored", edges, raw, bins),
        ("10 ms", wide, _widened(raw, edges), _widened(bins, edges)),
    ):
        was, now = errors(r, r, e), errors(r, b, e)
        ratios += list((now / was).ravel())
        for (start, end), x, y in zip(STEPS_S, was, now, strict=True):
            before, ratio = (" ".join(f"{v:.3f}" for v in row) for row in (x, y / x))
            print(
                f"  {title:<10s}{1e3 * start:4.0f}-{1e3 * end:<4.0f} ms  error {before}   ratio {ratio}"
            )
    print(f"  mean ratio {np.mean(ratios):.3f}, greatest {max(ratios):.3f}", flush=True)
    return ratios


_TEXTS = "key", "scene", "scene_digest", "config", "code_version", "licence", "citation"
_ATTRIBUTES = {**dict.fromkeys(_TEXTS, ""), "seed": 0, "speed_of_sound": 343.0}


def main() -> None:
    set_thread_count(1)
    for name in sys.argv[1:] or ROOMS:
        if ("house" in name and not HOUSE.is_dir()) or (
            "PTB" in name and not ptb_studio.FOLDER.is_dir()
        ):
            print(f"\n{name}: its data are absent")
            continue
        measure(name, *ROOMS[name]())


if __name__ == "__main__":
    main()
