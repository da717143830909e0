"""The job behind `make rirs`: grid, plan, tiles, finish. Resumable and idempotent, of one scene or many."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.build.cores import use_cores
from soundspaces_sim.build.engines import BuildProgress, Progress, Task, Watch, find_engine, read_options
from soundspaces_sim.build.estimate import Estimate, estimate, sum_estimates
from soundspaces_sim.build.finish import finish_folder
from soundspaces_sim.build.job_file import job_in_memory
from soundspaces_sim.build.plan import JobPlan
from soundspaces_sim.build.prepare import Prepared, open_dataset_job
from soundspaces_sim.build.worker import TIMEOUT_S
from soundspaces_sim.core.config import JobConfig
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.profile import profiled, stage
from soundspaces_sim.dataset.format.manifest import Manifest
from soundspaces_sim.rendering.renderers import check_renderer
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.simulate import as_points

_TRACING = 0.4  # of the time of a tile of a hundred points, about: pairs take the rest, when all points are traced


@dataclass(frozen=True)
class BuildResult:
    """Where the dataset is; `built` of `shards` were made now, the others were there. `changed`: settings
    of the folder's dataset that are now others, as ``dataset.rate 44100, now 8000``. A dataset of which a share
    of the tiles was made, or whose tiles were handed over, has a `manifest` that is not `complete`."""

    folder: Path
    manifest: Manifest
    built: int
    shards: int
    changed: tuple[str, ...] = ()


def build_dataset(
    scene: Scene | str | Path | Any,
    out: str | Path,
    config: JobConfig | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
    points: np.ndarray | None = None,
    command: str = "",
    engine: str = "local",
    announce: Callable[[Estimate], None] | None = None,
    options: Mapping[str, Any] | Iterable[str] = (),
    share: tuple[int, int] | None = None,
) -> BuildResult:
    """Simulate all pairs of a scene's grid into `out`/<scene name>/; goes on where it was stopped.

    `scene`: a `Scene`, or what `load_scene` takes: a name, a path, a `trimesh.Trimesh`. `jobs`: cores of this
    machine to use, at most those it has. `points` (N, 3) m: these instead of a grid. `command`: what rebuilds the
    dataset. `engine`: runs the tiles, of `build.engines.ENGINES`, with its `options`. `announce` is told before
    the first tile how long the job may take; the measurement costs some tens of pairs. `share` (k, n): only every
    n-th tile, from the k-th of them on; `finish_folder` ends the job when all shares are made. Raises `SceneError`
    if no point survives, `PointError` for points outside, `DatasetError` if the folder holds a dataset made from
    something else or cannot be written.
    """
    (result,) = build_datasets(
        [scene], out, config, jobs, progress, points, command, engine, announce, options, share
    )
    return result


def build_datasets(
    scenes: Sequence[Scene | Callable[[], Scene] | str | Path | Any],
    out: str | Path,
    config: JobConfig | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
    points: np.ndarray | None = None,
    command: str = "",
    engine: str = "local",
    announce: Callable[[Estimate], None] | None = None,
    options: Mapping[str, Any] | Iterable[str] = (),
    share: tuple[int, int] | None = None,
) -> list[BuildResult]:
    """`build_dataset` for several scenes as one job: their tiles are done side by side, the longest first.

    A scene may be given as a function that loads it, so that a collection is not in memory at once. All are
    planned before anything is simulated. A `share` has whole scenes, each n-th, where there are n or more, else a
    part of one: only these are loaded, and only of these are there results.
    """
    config = config or JobConfig()
    runner = find_engine(engine)
    chosen = read_options(engine, runner, options)
    check_renderer(config.dataset.renderer)
    given = None if points is None else as_points(points, "points")
    with use_cores(jobs) as cores, profiled("build"):
        numbers, of_tiles = scenes_of(len(scenes), share)
        own = [scenes[number] for number in numbers]
        opened = _open_all(own, Path(out), config, given, command, progress, announce)
        left = {p.folder: p.plan for p in opened if not p.whole}
        tasks = share_of(in_order(left), of_tiles)
        watch = _Count(left, tasks, progress)
        if tasks:
            with ExitStack() as stack:
                for job in (p.job for p in opened if p.job is not None):
                    stack.enter_context(job_in_memory(job))
                runner.run(tasks, chosen, cores, watch)
        timeout = TIMEOUT_S if runner.remote else 0.0
        return [_result(p, watch, share is None, timeout) for p in opened]


def _open_all(
    scenes: Sequence[Scene | Callable[[], Scene] | str | Path | Any],
    out: Path,
    config: JobConfig,
    points: np.ndarray | None,
    command: str,
    progress: Progress | None,
    announce: Callable[[Estimate], None] | None,
) -> list[Prepared]:
    """Plan all scenes and open their folders. Of several, what was prepared is not kept in memory."""
    opened: list[Prepared] = []
    expected = []

    def told(points: int) -> None:
        if progress is not None:
            progress(BuildProgress(f"Measuring {points} points", 0, 0, 0))

    for scene in scenes:
        with stage("scene"):
            loaded = scene() if callable(scene) else load_scene(scene)
        folder = out / loaded.name
        if any(p.folder == folder for p in opened):
            raise ConfigError(f"two of the scenes are called {loaded.name}; they would share {folder}")
        prepared = open_dataset_job(loaded, folder, config, points, command, progress)
        if announce is not None and prepared.job is not None and not prepared.whole:
            with stage("forecast"):
                expected.append(estimate(prepared.job, told))
        if len(scenes) > 1:
            prepared = replace(prepared, job=None)
        opened.append(prepared)
    if announce is not None and expected:
        announce(sum_estimates(expected))
    return opened


def _result(prepared: Prepared, watch: _Count, finish: bool, timeout_s: float) -> BuildResult:
    folder, draft = prepared.folder, prepared.plan.draft
    built = watch.made[folder]
    if prepared.whole:
        assert prepared.found is not None
        return BuildResult(folder, prepared.found, 0, len(prepared.found.shards))
    if not finish or not watch.is_done(folder):
        return BuildResult(folder, draft, built, len(draft.shards), prepared.changed)
    manifest = finish_folder(folder, timeout_s)
    return BuildResult(folder, manifest, built, len(manifest.shards), prepared.changed)


class _Count(Watch):
    """Adds up what tasks report, for `progress`."""

    def __init__(
        self, plans: Mapping[Path, JobPlan], tasks: Sequence[Task], progress: Progress | None
    ) -> None:
        self._plans, self._progress, self._rirs = plans, progress, 0
        self._points = {t: plans[t.folder].tiles[t.number].cost for t in tasks}
        self._total, self._traced = sum(self._points.values()), 0
        self._left = Counter(t.folder for t in tasks)
        self.made: Counter[Path] = Counter()

    def is_done(self, folder: Path) -> bool:
        """Whether all tasks in a folder are done."""
        return self._left[folder] == 0

    def under_way(self, task: Task, points: int) -> None:
        """So many points of what began with a task are traced. That is not half of the time that they take."""
        tile = self._plans[task.folder].tiles[task.number]
        done = int(_TRACING * points)
        self._tell("Simulating", self._traced + done, tile.pairs * done / tile.cost)

    def done(self, task: Task, made: int) -> None:
        self.made[task.folder] += made
        self._left[task.folder] -= 1
        self._traced += self._points[task]
        self._rirs += self._plans[task.folder].tiles[task.number].pairs if made else 0
        self._tell("Stored", self._traced)

    def _tell(self, stage: str, points: int, under_way: float = 0.0) -> None:
        if self._progress is not None:
            self._progress(BuildProgress(stage, points, self._total, self._rirs, under_way))


def in_order(plans: Mapping[Path, JobPlan]) -> list[Task]:
    """All tiles of some folders' jobs, the longest first, so that none is left for the end alone.

    Of tiles that take about as long (within a factor of two) those of one scene follow each other: a worker
    prepares a scene when it meets it.
    """
    tasks = [
        Task(folder, number, tile.cost * plan.draft.duration)
        for folder, plan in plans.items()
        for number, tile in enumerate(plan.tiles)
    ]
    rank = {folder: k for k, folder in enumerate(plans)}
    return sorted(tasks, key=lambda t: (-round(math.log2(t.cost)), rank[t.folder], -t.cost, t.number))


Share = tuple[int, int]  # k of n, from 1


def scenes_of(scenes: int, share: Share | None) -> tuple[range, Share | None]:
    """The numbers of the scenes of which a share has tiles, and its share of theirs; None: all. Only these need to
    be prepared: they are each n-th where there are as many scenes as shares, else one, of which others have the
    rest. Raises `ConfigError`."""
    if share is None:
        return range(scenes), None
    k, n = _checked(share)
    if scenes >= n:
        return range(k - 1, scenes, n), (1, 1)
    number = (k - 1) % scenes
    return range(number, number + 1), ((k - 1) // scenes + 1, len(range(number, n, scenes)))


def _checked(share: Share) -> Share:
    k, n = share
    if not 1 <= k <= n:
        raise ConfigError(f"tiles: expected share k/n with 1 <= k <= n, got {k}/{n}")
    return share


def share_of(tasks: Sequence[Task], share: tuple[int, int] | None) -> list[Task]:
    """Share k of n (from 1) of tasks in order, each n-th; None: all. Raises `ConfigError`."""
    if share is None:
        return list(tasks)
    k, n = _checked(share)
    return list(tasks[k - 1 :: n])
