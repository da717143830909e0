"""Many workers: throughput, overhead per tile, and a large job through Dask's scheduler.

Question: How does a job spread over workers, and what do the scheduler and the forecast cost or miss?

Method: One job of the demo with more and more workers, one run each; core-seconds hold where other work keeps
the machine busy, seconds do not. Tiles against the plan's forecast. 10,000 tiles that sleep as long as measured
tiles take, scaled, drawn from those of Matterport3D; all else is real: a scheduler, worker processes, the
engine, one connection each.

Amortised: Nothing: processes' start and loading of kernels are in the table of engines. Connections of the
large job are made before.

Takes: 30 minutes. Arguments: scenes whose costs are measured (demo; the last one's make the large job). Needs
the extra ``dask``.
"""

from __future__ import annotations

import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from scipy.stats import norm

import soundspaces_sim as ss
from benchmarks.tools.record import Table, UnavailableError, table
from soundspaces_sim.build import worker
from soundspaces_sim.build.build import build_dataset
from soundspaces_sim.build.cores import use_cores
from soundspaces_sim.build.engines import Task, Watch, find_engine, read_options
from soundspaces_sim.build.estimate import Cost, measure
from soundspaces_sim.build.forecast import wall_time
from soundspaces_sim.build.plan import even_block, make_tiles
from soundspaces_sim.build.prepare import plan_job

MEASURES = ("core", "scene", "transport", "build", "dataset/format")
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


def throughput(scene: ss.Scene) -> Table:
    """One job of the demo, 21 tiles, with more and more workers."""
    rows = []
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
        rows.append((engine, f"{processes} × {threads}", total, rirs / total, used, rirs / used))
    heads = [
        "engine", "workers × threads", ("clock", "s"), ("responses", "1/s"), ("processor", "s"),
        ("responses per processor's second", "1/s"),
    ]  # fmt: skip
    return table(f"A job of {scene.name}, 250 subpaths, tiles of 16 × 16 points", heads, rows)


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
        sizes = (some // 3, min(some, len(planned.points)))
        cost = measure(planned, sizes, math.inf, time.process_time)
    return cost, planned.plan.draft.duration


def collections(cost: Cost, what: str) -> tuple[Table, list[float]]:
    """Core-hours and bytes of the paper's collections with these costs; seconds of Matterport3D's tiles."""
    rows = []
    seconds: list[float] = []
    for name, (scenes, least, mean, most) in COLLECTIONS.items():
        sizes = scene_sizes(scenes, least, mean, most)
        tiles = [t for n in sizes for t in make_tiles(int(n), even_block(int(n), _TILE))]
        seconds = [cost.seconds(t) for t in tiles]
        pairs = int((sizes.astype(float) ** 2).sum())
        here, there = wall_time(seconds, 8) / 3600.0, wall_time(seconds, 64, 4) / 60.0
        gigabytes, hours = pairs * cost.stored / 1e9, sum(seconds) / 3600.0
        rows.append((name, scenes, int(sizes.sum()), pairs, len(tiles), gigabytes, hours, here, there))
    heads = [
        "", "scenes", "points", "responses", "tiles", ("size", "GB"), ("processor", "h"), ("8 workers × 1", "h"),
        ("64 × 4", "min"),
    ]  # fmt: skip
    return table(f"The paper's collections, with the costs of {what}", heads, rows), seconds


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


def through_dask(address: str, naps: np.ndarray, costs: np.ndarray) -> float:
    """Seconds that the engine takes for tiles that sleep, those of most cost first."""
    from soundspaces_sim.build.engines import dask as engine

    vars(engine)["work"] = nap
    runner = find_engine("dask")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "naps.npy"
        np.save(path, naps)
        tasks = [Task(path, int(k), float(costs[k])) for k in np.argsort(costs)[::-1]]
        start = time.perf_counter()
        runner.run(tasks, read_options("dask", runner, {"address": address}), 1, Watch())
        return time.perf_counter() - start


def large_job(seconds: Sequence[float], ratios: np.ndarray) -> Table:
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
    heads = [
        ("tile, mean", "s"), ("longest", "s"), ("took", "s"), ("evenly shared", "s"), ("longest first", "s"),
        ("scheduler and tail", "%"), ("an empty tile", "ms"), ("client's memory", "MB"),
    ]  # fmt: skip
    row = (
        real.mean(), real.max(), took, least, best, 100 * (took / least - 1), empty / 2000 * 1e3, peak
    )  # fmt: skip
    return table(
        f"{_FAKES:,} tiles scaled to {_MEAN_S:g} s, asleep on {_SLOTS} workers of Dask", heads, [row]
    )


def tile_overhead(scene: ss.Scene) -> float:
    """ms that a tile costs beside its work: one whose shards are there, in a process that has the job."""
    with tempfile.TemporaryDirectory() as out:
        folder = Path(out) / scene.name
        build_dataset(scene, out, job(64, 16), share=(1, 2))
        tiles = make_tiles(_points(folder), 16)
        done = [worker.work(str(folder), k, 1, 0.0) for k in range(len(tiles))]
        start = time.process_time()
        for k in range(len(tiles)):
            worker.work(str(folder), k, 1, 0.0)
        again = (time.process_time() - start) / len(tiles)
    if not any(d.made for d in done):
        raise RuntimeError("expected some tiles to be made")
    return 1e3 * again


def run(*names: str) -> list[Table]:
    """Engines, forecast, collections, the large job."""
    if not find_spec("distributed"):
        raise UnavailableError("the extra dask is not installed")
    scene = ss.load_scene("demo")
    tables = [throughput(scene)]
    cost, _ = calibrate(scene, 250)
    ratios = residuals(scene, cost)
    row = (len(ratios), ratios.mean(), ratios.std(), ratios.min(), ratios.max(), tile_overhead(scene))
    heads = ["tiles", "mean", "standard deviation", "least", "largest", ("a tile that is there", "ms")]
    title = "Tiles of the demo of 16 × 16 points, processor time over the plan's forecast"
    tables.append(table(title, heads, [row]))
    costs = []
    for name in names or ["demo"]:
        cost, length = calibrate(ss.load_scene(name), ss.SimulationConfig().walks)
        costs.append((Path(name).name, length, 1e3 * cost.subpaths, 1e3 * cost.pair, cost.stored))
        of_paper, seconds = collections(cost, Path(name).name)
        tables.append(of_paper)
    units = ["scene", ("length", "s"), ("a point", "ms"), ("a pair", "ms"), ("a pair", "bytes")]
    return [*tables, table("Costs of one core", units, costs), large_job(seconds, ratios)]
