"""The job behind `make rirs`: grid, plan, tiles, finish. Resumable and idempotent."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soundspaces_sim.base.config import JobConfig, differences
from soundspaces_sim.base.errors import ConfigError, DatasetError
from soundspaces_sim.base.files import publish, remove_stale
from soundspaces_sim.base.kernel import core_count, set_thread_count, thread_count
from soundspaces_sim.jobs import warm_up
from soundspaces_sim.jobs.engines import BuildProgress, Progress, find_engine
from soundspaces_sim.jobs.estimate import Estimate, estimate
from soundspaces_sim.jobs.finish import finish_job
from soundspaces_sim.jobs.plan import make_plan
from soundspaces_sim.jobs.record import Job, remove_job, write_job
from soundspaces_sim.places.floorplan import make_floorplan
from soundspaces_sim.places.graph import make_graph
from soundspaces_sim.places.grid import grid_at, make_grid
from soundspaces_sim.places.records import Grid
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.sound.renderers import check_renderer
from soundspaces_sim.storage.floorplan import NAME as FLOORPLAN
from soundspaces_sim.storage.floorplan import encode_floorplan
from soundspaces_sim.storage.manifest import NAME, Manifest, read_manifest, write_manifest
from soundspaces_sim.transport.model import make_model
from soundspaces_sim.transport.simulate import as_points

__all__ = ["BuildProgress", "BuildResult", "Progress", "build_dataset"]
_log = logging.getLogger(__name__)
_DECIDES = re.compile(r"simulation\.|grid\.|dataset\.seed")  # settings that decide what is simulated


@dataclass(frozen=True)
class BuildResult:
    """Where the dataset is; `built` of `shards` were made now, the others were there. `changed`: settings
    of the folder's dataset that are now others, as ``dataset.rate 44100, now 8000``."""

    folder: Path
    manifest: Manifest
    built: int
    shards: int
    changed: tuple[str, ...] = ()


def build_dataset(
    scene: Scene,
    out: str | Path,
    config: JobConfig | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
    points: np.ndarray | None = None,
    command: str = "",
    engine: str = "local",
    announce: Callable[[Estimate], None] | None = None,
) -> BuildResult:
    """Simulate all pairs of a scene's grid into `out`/<scene name>/; goes on where it was stopped.

    `jobs`: threads, at most the cores. `points` (N, 3) m: these instead of a grid. `command`: what rebuilds
    the dataset. `engine`: who runs the tiles, of `jobs.engines.ENGINES`. `announce` is told before the
    first tile how long the job may take; the measurement costs some tens of pairs. Raises `SceneError` if no
    point survives, `PointError` for points outside, `DatasetError` if the folder holds a dataset made from
    something else or cannot be written.
    """
    config = config or JobConfig()
    run = find_engine(engine)
    check_renderer(config.dataset.renderer)
    given = None if points is None else as_points(points, "points")
    with _threads(jobs):
        job, grid = _prepared(scene, Path(out) / scene.name, config, given, command, progress)
        folder, draft = job.folder, job.plan.draft
        found = _found(folder, draft)
        if found is not None and found.config == draft.config and _whole(folder, found):
            remove_job(folder)
            return BuildResult(folder, found, 0, len(found.shards))
        _open_folder(job, grid)
        if announce is not None:
            announce(estimate(job))
        built = run(job, progress)
        manifest = finish_job(job)
    changed = differences(found.config, draft.config) if found is not None else []
    return BuildResult(folder, manifest, built, len(manifest.shards), tuple(changed))


def _prepared(
    scene: Scene, folder: Path, config: JobConfig, points: np.ndarray | None, command: str,
    progress: Progress | None,
) -> tuple[Job, Grid]:  # fmt: skip
    """The job and its grid; no files. `progress` is told of each step."""

    def step(name: str, done: int = 0, total: int = 0) -> None:
        if progress is not None:
            progress(BuildProgress(name, done, total, 0))

    compiling = warm_up.start()
    try:
        step(
            "Placing points" if compiling is None else "Placing points, while kernels are compiled, once"
        )
        grid = (
            make_grid(scene, config=config.grid)
            if points is None
            else grid_at(scene, points, config.grid)
        )
        step("Walking graph")
        graph = make_graph(scene, grid, config.graph)
        if compiling is not None:
            compiling.wait(lambda done, total: step("Compiling kernels, once", done, total))
    except BaseException:
        if compiling is not None:
            compiling.stop()
        raise
    step("Preparing the scene")
    model = make_model(scene, grid.points, config.simulation, config.dataset.seed)
    height = grid.height if points is None else None
    plan = make_plan(scene, grid.points, graph, model, config, command, height)
    return Job(folder, plan, scene, graph.geodesic, model), grid


def _open_folder(job: Job, grid: Grid) -> None:
    """Make the folder, or take over one whose job was interrupted or stored less."""
    try:
        job.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(
            f"{job.folder}: cannot make this folder ({error.strerror}); choose another OUT"
        ) from error
    remove_stale(job.folder)
    write_manifest(job.folder, job.plan.draft)
    publish(job.folder / FLOORPLAN, encode_floorplan(make_floorplan(job.scene, grid)))
    write_job(job)


@contextmanager
def _threads(jobs: int | None) -> Iterator[None]:
    """Let kernels use `jobs` threads for a while, or as many as there are cores if it asks for more."""
    before, most = thread_count(), core_count()
    if jobs is not None and jobs < 1:
        raise ConfigError(f"jobs: expected 1 to {most} (the cores of this machine), got {jobs}")
    if jobs is not None and jobs > most:
        _log.info("%d jobs were asked for; this machine has %d cores, so %d it is", jobs, most, most)
    set_thread_count(before if jobs is None else min(jobs, most))
    try:
        yield
    finally:
        set_thread_count(before)


def _found(folder: Path, draft: Manifest) -> Manifest | None:
    """The folder's manifest, if it has one. Raises if it is that of another dataset."""
    if not (folder / NAME).exists():
        return None
    found = read_manifest(folder)
    if found.key != draft.key:
        raise DatasetError(
            f"{folder} holds a dataset made from another {'; '.join(_why(found, draft))}; choose another OUT, "
            "or delete that folder"
        )
    return found


def _why(found: Manifest, draft: Manifest) -> list[str]:
    """In what two manifests with different keys differ."""
    out = []
    if found.scene_digest != draft.scene_digest:
        out.append("scene (its triangles or materials differ)")
    if found.code_version != draft.code_version:
        out.append(f"version of soundspaces_sim ({found.code_version}, now {draft.code_version})")
    if found.target != draft.target:
        out.append(f"machine (code for {found.target or 'one not recorded'}, now for {draft.target})")
    settings = [d for d in differences(found.config, draft.config) if _DECIDES.match(d)]
    out += [f"setting ({d})" for d in settings]
    if found.points != draft.points and not any(d.startswith("grid.") for d in settings):
        out.append(f"set of points ({len(found.points)}, now {len(draft.points)})")
    if not out and found.duration != draft.duration:
        out.append(f"duration ({found.duration:g} s, now {draft.duration:g} s)")
    return out or [f"version of the code (key {found.key[:12]}, now {draft.key[:12]})"]


def _whole(folder: Path, found: Manifest) -> bool:
    """Whether all shards of a complete manifest are there, by size."""
    return found.complete and all(
        (folder / e.file).is_file() and (folder / e.file).stat().st_size == e.bytes
        for e in found.entries
    )
