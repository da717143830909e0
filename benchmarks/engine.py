"""Speed of the transport engine on a real house: ratios within one run.

    .venv/bin/python -m benchmarks.engine

Prints time, peak memory and error against the number of points and against the number of walks; one
thread against two; where the time goes; and the same rays through Embree alone. The error is the mean
|difference| of energy decay curves (dB, per band, down to -30 dB) of two seeds, over all pairs of two
different points; against a converged reference it is 1 / sqrt(2) of that. Falls back to the demo scene
where ../shared is absent.
"""

from __future__ import annotations

import resource
import time
from pathlib import Path

import numba
import numpy as np

import soundspaces_sim as ss
from soundspaces_sim.echogram import Echograms
from soundspaces_sim.prepare import Engine, prepare
from soundspaces_sim.tile import simulate_tile
from soundspaces_sim.transport.closedness import measure_closedness
from soundspaces_sim.transport.rng import point_keys

HOUSE = Path(__file__).resolve().parents[2] / "shared" / "scenes" / "aws_small_house"


def decay_curves(echoes: Echograms, bin_s: float = 0.01) -> np.ndarray:
    """(S, L, bins, bands) backward-integrated energy, dB."""
    width = int(np.ceil(echoes.time_edges[-1] / bin_s - 1e-9))
    histogram = np.zeros((*echoes.shape, width, len(echoes.bands) - 1))
    rows = np.minimum((echoes.time_edges[:-1] / bin_s + 1e-9).astype(int), width - 1)
    for i, row in enumerate(rows):
        histogram[:, :, row] += echoes.energy[:, :, i, 0]
    s, l = np.indices(echoes.shape)  # noqa: E741
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


def timed(engine: Engine, points: np.ndarray) -> tuple[float, Echograms]:
    start = time.perf_counter()
    echoes = simulate_tile(engine, points, None)[0]
    return time.perf_counter() - start, echoes


def _engine(scene: ss.Scene, points: np.ndarray, seed: int = 0, **settings: object) -> Engine:
    return prepare(scene, points, ss.SimulationConfig(duration=0.8, **settings), seed)  # type: ignore[arg-type]


def embree_alone(engine: Engine, points: np.ndarray) -> float:
    """Million rays per second of diffuse walks that do nothing else."""
    local, keys = points - engine.scene.center, point_keys(points, 0)
    measure_closedness(engine.geometry, local[:1], keys[:1], 8, 10)
    start = time.perf_counter()
    closed, _ = measure_closedness(engine.geometry, local, keys, 1000, 100)
    return float(closed.sum()) * 1e5 / (time.perf_counter() - start) / 1e6


def main() -> None:
    scene = ss.load_scene(HOUSE if HOUSE.is_dir() else "demo")
    grid = ss.make_grid(scene, 1.0 if HOUSE.is_dir() else 0.75).points
    shuffled = grid[np.random.default_rng(0).permutation(len(grid))]
    timed(_engine(scene, grid, walks=16), shuffled[:4])  # compile
    threads = numba.get_num_threads()
    print(f"{scene.name}: {len(scene.faces)} triangles, {len(grid)} points, {threads} threads")

    print("\nagainst the number of points (1000 walks per point)")
    print(f"{'points':>8s}{'s':>9s}{'ms/pair':>9s}{'pairs/s':>9s}{'peak MB':>9s}")
    for n in (25, 50, 100, 180):
        if n <= len(grid):
            t, _ = timed(_engine(scene, grid, walks=1000), shuffled[:n])
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
            print(f"{n:8d}{t:9.2f}{t / n**2 * 1e3:9.3f}{n**2 / t:9.0f}{peak:9.0f}")

    print("\nerror against time (60 points)")
    print(f"{'walks':>8s}{'joined':>8s}{'ms/pair':>9s}{'|dEDC| dB':>11s}{'late error':>12s}")
    points = shuffled[:60]
    for walks, joined in ((500, 32), (1000, 32), (1000, 0), (2000, 32), (4000, 32)):
        times, curves = [], []
        for seed in (1, 2):
            t, echoes = timed(_engine(scene, grid, seed, walks=walks, joined_walks=joined), points)
            times.append(t)
            curves.append(decay_curves(echoes))
        late = float(np.median(echoes.relative_error[:, :, 1]))
        difference = edc_difference(*curves)
        print(f"{walks:8d}{joined:8d}{np.mean(times) / 3.6:9.3f}{difference:11.2f}{late:12.3f}")

    print("\nwhere the time goes (100 points, 1000 walks)")
    points = shuffled[:100]
    everything, _ = timed(_engine(scene, grid, walks=1000), points)
    no_joins, _ = timed(_engine(scene, grid, walks=1000, joined_walks=0), points)
    tiny, _ = timed(
        _engine(scene, grid, walks=1000, joined_walks=0, radius_min=1e-3, radius_max=1e-3), points
    )
    print(f"  walking {tiny / everything:.0%}, detecting {(no_joins - tiny) / everything:.0%}, "
          f"joining {(everything - no_joins) / everything:.0%}")  # fmt: skip
    print(f"  Embree alone, diffuse walks: {embree_alone(_engine(scene, grid), points):.1f} M rays/s")

    if threads > 1:
        engine = _engine(scene, grid, walks=1000)
        both, _ = timed(engine, points)
        numba.set_num_threads(1)
        one, _ = timed(engine, points)
        numba.set_num_threads(threads)
        print(f"\n{threads} threads are {one / both:.2f} times as fast as one")


if __name__ == "__main__":
    main()
