"""What a job would take and store, before anything is spent: measured on a few of its points, on one core."""

from __future__ import annotations

import heapq
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soundspaces_sim.build.cores import use_cores
from soundspaces_sim.build.engines import BuildProgress, Progress
from soundspaces_sim.build.engines.capacity import Shape, choose_shape
from soundspaces_sim.build.estimate import BUDGET_S, load_shared, measure
from soundspaces_sim.build.prepare import plan_job
from soundspaces_sim.core.config import JobConfig
from soundspaces_sim.core.errors import PointError
from soundspaces_sim.core.memory import free_memory
from soundspaces_sim.core.numerics.threads import core_count
from soundspaces_sim.scene.scene import Scene

# Points of the tiles that are timed, one after the other until that would take too long: the larger ones tell
# better what a pair costs beside what a tile costs anyway, but where a pair takes seconds small ones do too. Large
# ones have a fifth of a job's points at most: a forecast is much shorter than its job.
_SMALL, _LARGE, _PART = (2, 4), (16, 48), 5


@dataclass(frozen=True)
class Forecast:
    """Of one scene: `points`, `duration` s of an echogram, `bytes` on disk, and of every tile the seconds that it
    keeps one core busy at most; `least_core_hours` of all tiles, at least. The two differ by what tiles of few
    points do not tell (`estimate.Cost`)."""

    scene: str
    points: int
    duration: float
    bytes: float
    tiles: tuple[float, ...]
    least_core_hours: float
    measured: tuple[int, ...]  # points of the one or two tiles that the times come from

    @property
    def pairs(self) -> int:
        """Room impulse responses."""
        return self.points**2

    @property
    def core_hours(self) -> float:
        """Of all tiles, at most."""
        return sum(self.tiles) / 3600.0


def forecast(
    scene: Scene, config: JobConfig, points: np.ndarray | None = None, progress: Progress | None = None
) -> Forecast:
    """Plan a scene's job and measure some of its points on one core, by its CPU time; no files. `progress` is
    told of each step. The measurement is bounded: the transfer subpaths, which the job needs and finds in the
    cache, one tile of two points, and larger ones only if each should take less than 40 s.

    Raises `SceneError`, `PointError`.
    """
    job, _ = plan_job(scene, Path(scene.name), config, points, progress=progress)
    count = len(job.points)
    if count < 2:
        raise PointError(f"{scene.name}: {count} point: there is nothing to measure")

    def step(what: str) -> None:
        if progress is not None:
            progress(BuildProgress(what, 0, 0, 0))

    def tell(points: int) -> None:
        step(f"Measuring {points} of {count:,} points")

    patches = len(job.model.world.patches.weight)
    if patches:
        step(f"Tracing the transfer subpaths from {patches:,} patches")
        load_shared(job.model)  # on all cores
    small = {1 if count == 2 else _SMALL[0], *(min(k, count) for k in _SMALL)}
    sizes = sorted({*small, *(k for k in _LARGE if _PART * k <= count)})
    with use_cores(1):
        cost = measure(job, sizes, BUDGET_S, time.process_time, tell)
    return Forecast(
        scene.name,
        count,
        job.plan.draft.duration,
        count**2 * cost.stored,
        tuple(cost.seconds(t) for t in job.plan.tiles),
        sum(cost.least_seconds(t) for t in job.plan.tiles) / 3600.0,
        cost.measured,
    )


ALONE = 0.03  # of a tile's work, on one core: what 16 threads lost by waiting, docs/benchmarks.md
_GOLDEN = 0.618
_STRETCHES = 8  # of a tile, in which it works on one core and on many in turn


def local_shape(tiles: int) -> Shape:
    """Workers and their threads on this machine, for so many tiles."""
    return choose_shape(core_count(), free_memory(), tiles)


def wall_time(
    tiles: Iterable[float],
    workers: int,
    threads: int = 1,
    overhead_s: float = 0.0,
    cores: int | None = None,
    alone: float = 0.0,
) -> float:
    """Seconds until all tiles are done, the longest first, each by the first of `workers` that is free.

    `tiles`: core-seconds of each; `threads` of a worker share a tile evenly; `overhead_s` per tile. Where workers
    share `cores`, these are dealt out evenly to whoever has work. `alone`: the share of a tile in which it has work
    for one core only, in `_STRETCHES` stretches; by default none.
    """
    if cores is not None or alone:
        return _shared_wall_time(tiles, workers, threads, overhead_s, cores or workers * threads, alone)
    free = [0.0] * workers
    for seconds in sorted(tiles, reverse=True):
        heapq.heappush(free, heapq.heappop(free) + seconds / threads + overhead_s)
    return max(free)


def _shared_wall_time(
    tiles: Iterable[float], workers: int, threads: int, overhead_s: float, cores: int, alone: float
) -> float:
    waiting, clock = sorted(tiles), 0.0
    # Of a tile: stretches on one core or not, core-seconds; last first.
    under_way: list[list[tuple[bool, float]]] = []
    while waiting or under_way:
        while waiting and len(under_way) < workers:
            of_stretch = waiting.pop() / _STRETCHES
            many, one = (False, (1.0 - alone) * of_stretch), (True, alone * of_stretch)
            # The part that comes first of a stretch: tiles do not keep step.
            part = (_GOLDEN * len(waiting)) % 1.0
            order = [(False, part * many[1]), one, *[many, one] * (_STRETCHES - 1)]
            order += [(False, (1.0 - part) * many[1]), (True, overhead_s)]
            under_way.append(order[::-1])
        single = sum(of_tile[-1][0] for of_tile in under_way)
        each = min(cores / single, 1.0) if single else 1.0
        rest = max(cores - single, 0.0) / max(len(under_way) - single, 1)
        rates = [each if of_tile[-1][0] else max(min(rest, threads), 1e-9) for of_tile in under_way]
        step = min(of_tile[-1][1] / rate for of_tile, rate in zip(under_way, rates, strict=True))
        clock += step
        for of_tile, rate in zip(under_way, rates, strict=True):
            on_one, left = of_tile.pop()
            left -= step * rate
            if left > 1e-9:
                of_tile.append((on_one, left))
        under_way = [of_tile for of_tile in under_way if of_tile]
    return clock
