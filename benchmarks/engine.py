"""Speed of the transport engine on a real house: ratios within one run.

    .venv/bin/python -m benchmarks.engine

Prints time and peak memory against the number of points, error against the number of walks, where the
time goes, rays through Embree alone, and one thread against two. The error is the mean
|difference| of energy decay curves (dB, per band, down to -30 dB) of two seeds, over all pairs of two
different points; against a converged reference it is 1 / sqrt(2) of that. Falls back to the demo scene
where ../shared is absent.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import soundspaces_sim as ss
from soundspaces_sim.build.plan import block_size, make_tiles
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.scene.rays.diffuse_walk import diffuse_walks
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import simulate_pairs
from soundspaces_sim.transport.techniques import TECHNIQUES

HOUSE = Path(__file__).resolve().parents[2] / "shared" / "scenes" / "aws_small_house"


def decay_curves(echoes: Echograms, bin_s: float = 0.01) -> np.ndarray:
    """(S, L, bins, bands) backward-integrated energy, dB."""
    width = int(np.ceil(echoes.time_edges[-1] / bin_s - 1e-9))
    histogram = np.zeros((*echoes.shape, width, len(echoes.bands) - 1))
    rows = np.minimum((echoes.time_edges[:-1] / bin_s + 1e-9).astype(int), width - 1)
    for i, row in enumerate(rows):
        histogram[:, :, row] += echoes.energy[:, :, i, 0]
    s, l = np.indices(echoes.shape)
    at = np.minimum((echoes.direct_length / echoes.speed_of_sound / bin_s).astype(int), width - 1)
    np.add.at(histogram, (s, l, at), echoes.direct_energy)
    pair = np.repeat(np.arange(len(echoes)), np.diff(echoes.early_start))
    at = np.minimum((echoes.early.delay / bin_s).astype(int), width - 1)
    np.add.at(histogram, (pair // echoes.shape[1], pair % echoes.shape[1], at), echoes.early.energy)
    remaining = np.cumsum(histogram[:, :, ::-1], axis=2)[:, :, ::-1]
    return np.asarray(10.0 * np.log10(np.maximum(remaining, 1e-30)))


def edc_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Mean |difference| in dB down to -30 dB, over pairs of two different points."""
    use = (a - a[:, :, :1]) > -30.0
    use &= ~np.eye(len(a), dtype=bool)[:, :, None, None]
    return float(np.abs(a - b)[use].mean())


def timed(model: Model, points: np.ndarray) -> tuple[float, Echograms]:
    start = time.perf_counter()
    echoes = simulate_tile(model, points, None)[0]
    return time.perf_counter() - start, echoes


def _model(scene: ss.Scene, points: np.ndarray, seed: int = 0, **settings: object) -> Model:
    return make_model(scene, points, ss.SimulationConfig(duration=0.8, **settings), seed)  # type: ignore[arg-type]


def embree_alone(model: Model, points: np.ndarray) -> float:
    """Million rays per second of diffuse walks that do nothing else."""
    local, keys = points - model.scene.center, point_keys(points, 0)
    geometry, materials = model.scene.geometry, len(model.scene.materials.names)
    diffuse_walks(geometry, local[:1], keys[:1], 8, 10, materials)
    start = time.perf_counter()
    walks = diffuse_walks(geometry, local, keys, 1000, 100, materials)
    return float(walks.hits.sum()) / (time.perf_counter() - start) / 1e6


def stage_times(model: Model, points: np.ndarray) -> dict[str, float]:
    """Share of a tile's time in each technique."""
    spent = {technique.name: 0.0 for technique in TECHNIQUES}

    def clocked(name: str, door: Callable[..., None] | None) -> Callable[..., None] | None:
        def call(*args: Any) -> None:
            start = time.perf_counter()
            assert door is not None
            door(*args)
            spent[name] += time.perf_counter() - start

        return call if door is not None else None

    clocks = [
        replace(t, trace=clocked(t.name, t.trace), connect=clocked(t.name, t.connect))
        for t in TECHNIQUES
    ]
    start = time.perf_counter()
    simulate_tile(model, points, None, techniques=clocks)
    total = time.perf_counter() - start
    return {name: seconds / total for name, seconds in spent.items()}


def run_tiles(model: Model, points: np.ndarray) -> float:
    """Seconds for all pairs, cut into tiles as a dataset job cuts them; results are dropped."""
    start = time.perf_counter()
    for t in make_tiles(len(points), block_size(len(points), model)):
        a, b = points[slice(*t.a)], None if t.a == t.b else points[slice(*t.b)]
        simulate_pairs(model, a, b)
    return time.perf_counter() - start


def main() -> None:
    scene = ss.load_scene(HOUSE if HOUSE.is_dir() else "demo")
    fine = ss.make_grid(scene, 0.55 if HOUSE.is_dir() else 0.5).points
    grid = ss.make_grid(scene, 1.0 if HOUSE.is_dir() else 0.75).points
    shuffled = grid[np.random.default_rng(0).permutation(len(grid))]
    timed(_model(scene, grid, walks=16), shuffled[:4])  # compile
    simulate_pairs(_model(scene, grid, walks=16), shuffled[:2], shuffled[2:4])
    threads = thread_count()
    print(f"{scene.name}: {len(scene.faces)} triangles, {threads} threads")

    print("\nall pairs in tiles of a job, 250 walks per point")
    print(f"{'points':>8s}{'s':>9s}{'ms/pair':>9s}{'pairs/s':>9s}{'peak MB':>9s}")
    fine = fine[np.random.default_rng(1).permutation(len(fine))]
    for n in (50, 100, 200, 400, 566):
        if n <= len(fine):
            t = run_tiles(_model(scene, fine, walks=250), fine[:n])
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
            print(f"{n:8d}{t:9.2f}{t / n**2 * 1e3:9.3f}{n**2 / t:9.0f}{peak:9.0f}", flush=True)

    print("\nerror against walks, all pairs of one tile")
    print(f"{'points':>8s}{'walks':>8s}{'ms/pair':>9s}{'pairs/s':>9s}{'|dEDC| dB':>11s}"
          f"{'late error':>12s}{'10 ms bins':>12s}")  # fmt: skip
    for n, walks, merging in ((180, 1000, True), (60, 1000, True), (60, 1000, False), (60, 2000, True)):
        times, curves, bins = [], [], []
        for seed in (1, 2):
            t, echoes = timed(_model(scene, grid, seed, walks=walks, merging=merging), shuffled[:n])
            times.append(t)
            curves.append(decay_curves(echoes))
            bins.append(_late_bins(echoes))
        late = float(np.median(echoes.relative_error[:, :, 1]))
        ms = float(np.mean(times)) / min(n, len(grid)) ** 2 * 1e3
        per_bin = _bin_error(*bins)
        note = "" if merging else "  (no merges)"
        print(f"{n:8d}{walks:8d}{ms:9.3f}{1e3 / ms:9.0f}{edc_difference(*curves):11.2f}{late:12.3f}"
              f"{per_bin:12.3f}{note}", flush=True)  # fmt: skip

    points = shuffled[:100]
    shares = stage_times(_model(scene, grid, walks=1000), points)
    print("\nwhere the time goes (100 points, 1000 walks): "
          + ", ".join(f"{name} {share:.0%}" for name, share in shares.items()))  # fmt: skip
    print(f"Embree alone, diffuse walks: {embree_alone(_model(scene, grid), points):.1f} M rays/s")

    if threads > 1:
        model = _model(scene, grid, walks=1000)
        both, _ = timed(model, points[:60])
        set_thread_count(1)
        one, _ = timed(model, points[:60])
        set_thread_count(threads)
        print(f"{threads} threads are {one / both:.2f} times as fast as one")


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


if __name__ == "__main__":
    main()
