"""Many workers: throughput, overhead per tile, and a large job through Dask's scheduler.

    .venv/bin/python -m benchmarks.clusters

Needs the extra ``dask``. The large job has 10,000 tiles that sleep as long as measured tiles take, scaled; all
else is real: a scheduler, worker processes, the engine, one connection each.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
from scipy.stats import norm

import soundspaces_sim as ss
from soundspaces_sim.build import worker
from soundspaces_sim.build.build import build_dataset
from soundspaces_sim.build.cores import use_cores
from soundspaces_sim.build.engines import Task, Watch, find_engine, read_options
from soundspaces_sim.build.estimate import Cost, measure
from soundspaces_sim.build.forecast import wall_time
from soundspaces_sim.build.plan import even_block, make_tiles
from soundspaces_sim.build.prepare import plan_job

# Of the seed paper, section 3 and table 1: scenes, points of a scene (least, mean, most).
COLLECTIONS = {"Replica": (18, 38, 97, 566), "Matterport3D": (85, 20, 243, 2103)}
_TILE = 140  # what memory allows for echograms of .8 s
_FAKES, _SLOTS, _MEAN_S = 10_000, 64, 4.0
_PROCESSES = 4


def scene_sizes(scenes: int, least: int, mean: float, most: int) -> np.ndarray:
    """Points of each scene: evenly spread quantiles of the log-normal distribution that has this mean and largest
    scene, none below `least`."""
    z = norm.ppf((np.arange(scenes) + 0.5) / scenes)
    low, high = 0.0, 5.0
    for _ in range(60):
        sigma = 0.5 * (low + high)
        sizes = np.maximum(most * np.exp(sigma * (z - z[-1])), least)
        low, high = (sigma, high) if sizes.mean() > mean else (low, sigma)
    return np.rint(sizes).astype(int)


def job(walks: int, tile: int | None) -> ss.JobConfig:
    return ss.JobConfig(
        grid=ss.GridConfig(spacing=1.0), simulation=ss.SimulationConfig(walks=walks),
        dataset=type(ss.JobConfig().dataset)(tile=tile),
    )  # fmt: skip


def _core_seconds() -> float:
    """CPU time of this process and of its children that have ended."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usages)


def throughput(scene: ss.Scene) -> None:
    """One job of the demo, 21 tiles, with more and more workers; one run each. Core-seconds hold where other work
    keeps the machine busy, seconds do not."""
    print("| engine | workers × threads | s | RIRs/s | core-seconds | RIRs per core-second |")
    print("|---|---|---|---|---|---|")
    for engine, processes, threads in (
        ("local", 1, 1), ("local", 1, 2), ("local", 2, 1), ("dask", 1, 1), ("dask", 2, 1),
    ):  # fmt: skip
        name = "processes" if engine == "local" else "workers"
        with tempfile.TemporaryDirectory() as out:
            start, used = time.perf_counter(), _core_seconds()
            result = build_dataset(
                scene, out, job(250, 16), jobs=processes * threads, engine=engine,
                options={name: processes, "threads": threads},
            )  # fmt: skip
            total, used = time.perf_counter() - start, _core_seconds() - used
        rirs = len(result.manifest.points) ** 2
        print(
            f"| {engine} | {processes} × {threads} | {total:.1f} | {rirs / total:.0f} | {used:.1f} | "
            f"{rirs / used:.0f} |",
            flush=True,
        )


def residuals(scene: ss.Scene, cost: Cost) -> np.ndarray:
    """CPU seconds of real tiles of 16 × 16 points / those that the plan's arithmetic says, one core."""
    ratios = []
    with tempfile.TemporaryDirectory() as out, use_cores(1):
        build_dataset(scene, out, job(250, 16), share=(1, 10**6))
        folder = Path(out) / scene.name
        worker.work(str(folder), 0, 1, 0.0)  # opens the job
        whole = [(k, t) for k, t in enumerate(make_tiles(_points(folder), 16)) if t.pairs % 256 == 0]
        for number, tile in whole:
            start = time.process_time()
            if worker.work(str(folder), number, 1, 0.0).made:
                ratios.append((time.process_time() - start) / cost.seconds(tile))
    return np.array(ratios)


def _points(folder: Path) -> int:
    from soundspaces_sim.dataset.format.manifest import read_manifest

    return len(read_manifest(folder).points)


def calibrate(scene: ss.Scene, walks: int, some: int = 48) -> tuple[Cost, float]:
    """What a point and a pair of this scene cost on one core, and the length of its echograms in s."""
    planned, _ = plan_job(scene, Path(scene.name), job(walks, None))
    with use_cores(1):
        cost = measure(planned, some // 3, min(some, len(planned.points)), time.process_time)
    return cost, planned.plan.draft.duration


def collections(cost: Cost, what: str) -> list[float]:
    """Core-hours and bytes of the paper's collections with these costs; seconds of Matterport3D's tiles."""
    seconds: list[float] = []
    print(
        f"| with the costs of {what} | scenes | points | RIRs | tiles | GB | core-hours | 8 × 1 | 64 × 4 |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, (scenes, least, mean, most) in COLLECTIONS.items():
        sizes = scene_sizes(scenes, least, mean, most)
        tiles = [t for n in sizes for t in make_tiles(int(n), even_block(int(n), _TILE))]
        seconds = [cost.seconds(t) for t in tiles]
        pairs = int((sizes.astype(float) ** 2).sum())
        here, there = wall_time(seconds, 8) / 3600.0, wall_time(seconds, 64, 4) / 60.0
        print(
            f"| {name} | {scenes} | {sizes.sum():,} | {pairs:,} | {len(tiles):,} | "
            f"{pairs * cost.stored / 1e9:.1f} | {sum(seconds) / 3600:.1f} | {here:.2f} h | {there:.1f} min |"
        )
    return seconds


@cache
def _naps(path: str) -> np.ndarray:
    naps: np.ndarray = np.load(path)
    return naps


def nap(path: str, number: int, _threads: int) -> worker.Done:
    """A tile that takes as long as a real one, scaled: the seconds that stand in a file."""
    seconds = float(_naps(path)[number])
    time.sleep(seconds)
    return worker.Done(1, seconds)


@contextmanager
def cluster(threads: int) -> Iterator[str]:
    """The address of a Dask scheduler with workers, all processes of their own."""
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder) / "scheduler.json"
        dask = [sys.executable, "-m", "dask"]
        known = ["--scheduler-file", str(where), "--no-dashboard"]
        children = [
            subprocess.Popen([*dask, "scheduler", "--port", "0", *known], stderr=subprocess.DEVNULL)
        ]
        try:
            crew = ["worker", "--nworkers", str(_PROCESSES), "--nthreads", str(threads)]
            children.append(subprocess.Popen([*dask, *crew, *known], stderr=subprocess.DEVNULL))
            while not where.exists():
                time.sleep(0.1)
            from distributed import Client

            with Client(scheduler_file=str(where)) as client:
                client.wait_for_workers(_PROCESSES)
                address = str(client.scheduler_info()["address"])
            yield address
        finally:
            for child in reversed(children):
                child.terminate()
                child.wait()


def through_dask(address: str, naps: np.ndarray, costs: Sequence[float]) -> float:
    """Seconds that the engine takes for tiles that sleep, those of most cost first."""
    from soundspaces_sim.build.engines import dask as engine

    engine.work = nap  # type: ignore[assignment]
    runner = find_engine("dask")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "naps.npy"
        np.save(path, naps)
        tasks = [Task(path, int(k), float(costs[k])) for k in np.argsort(costs)[::-1]]
        start = time.perf_counter()
        runner.run(tasks, read_options("dask", runner, {"address": address}), 1, Watch())
        return time.perf_counter() - start


def large_job(seconds: Sequence[float], ratios: np.ndarray) -> None:
    """10,000 tiles, drawn from those of Matterport3D, each off its forecast by as much as measured tiles are."""
    rng = np.random.default_rng(0)
    costs = rng.choice(np.array(seconds), _FAKES)
    real = costs * rng.choice(ratios / ratios.mean(), _FAKES)
    naps = real * _MEAN_S / real.mean()
    with cluster(_SLOTS // _PROCESSES) as address:
        through_dask(address, np.full(_SLOTS * 4, 0.01), np.ones(_SLOTS * 4))  # connections
        least = naps.sum() / _SLOTS
        took = through_dask(address, naps, costs)
        best = wall_time(naps, _SLOTS)
        empty = through_dask(address, np.zeros(2000), np.ones(2000))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(
        f"{_FAKES:,} tiles of {real.mean():.0f} s on average (longest {real.max():.0f}), scaled to {_MEAN_S:g} s, "
        f"asleep on {_SLOTS} workers: {took:.1f} s; evenly shared {least:.1f} s, longest first {best:.1f}. "
        f"Scheduler and tail: {100 * (took / least - 1):.1f} %. Empty tiles: {empty / 2000 * 1e3:.2f} ms each. "
        f"Client: {peak:.0f} MB at most."
    )


def tile_overhead(scene: ss.Scene) -> None:
    """What a tile costs beside its work: one whose shards are there, in a process that has the job."""
    with tempfile.TemporaryDirectory() as out:
        folder = Path(out) / scene.name
        build_dataset(scene, out, job(64, 16), share=(1, 2))
        tiles = make_tiles(_points(folder), 16)
        done = [worker.work(str(folder), k, 1, 0.0) for k in range(len(tiles))]
        start = time.process_time()
        for k in range(len(tiles)):
            worker.work(str(folder), k, 1, 0.0)
        again = (time.process_time() - start) / len(tiles)
    made = sum(d.made > 0 for d in done)
    print(f"A tile that is there (16 × 16 points, read throughout): {again * 1e3:.0f} ms; {made} made")


def main() -> None:
    scene = ss.load_scene("demo")
    throughput(scene)
    print()
    cost, _ = calibrate(scene, 250)
    ratios = residuals(scene, cost)
    print(
        f"Tiles of the demo, measured / forecast: mean {ratios.mean():.2f}, standard deviation "
        f"{ratios.std() / ratios.mean():.2f} of it, {ratios.min():.2f} to {ratios.max():.2f} ({len(ratios)} tiles)"
    )
    tile_overhead(scene)
    print()
    for name in sys.argv[1:] or ["demo"]:
        cost, length = calibrate(ss.load_scene(name), ss.SimulationConfig().walks)
        per_pair = f"{1e3 * cost.pair:.2f} ms and {cost.stored:.0f} bytes per pair"
        print(f"{name}: {1e3 * cost.walks:.0f} ms per point, {per_pair}")
        seconds = collections(cost, f"{Path(name).name}, {length:.1f} s")
        print()
    large_job(seconds, ratios)


if __name__ == "__main__":
    main()
