"""The job behind `make rirs`: grid, plan, tiles, finish. Resumable and idempotent."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np

from soundspaces_sim.base.config import JobConfig
from soundspaces_sim.base.errors import ConfigError, DatasetError
from soundspaces_sim.base.files import publish, remove_stale
from soundspaces_sim.jobs.engines import BuildProgress, Progress, find_engine
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
from soundspaces_sim.transport.model import prepare
from soundspaces_sim.transport.simulate import as_points

__all__ = ["BuildProgress", "BuildResult", "Progress", "build_dataset"]
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BuildResult:
    """Where the dataset is; `built` of `shards` were made now, the others were there."""

    folder: Path
    manifest: Manifest
    built: int
    shards: int


def build_dataset(
    scene: Scene,
    out: str | Path,
    config: JobConfig | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
    points: np.ndarray | None = None,
    command: str = "",
    engine: str = "local",
) -> BuildResult:
    """Simulate all pairs of a scene's grid into `out`/<scene name>/; goes on where it was stopped.

    `jobs`: threads, at most the cores. `points` (N, 3) m: these instead of a grid. `command`: what rebuilds
    the dataset. `engine`: who runs the tiles, of `jobs.engines.ENGINES`. Raises `SceneError` if no point
    survives, `PointError` for points outside, `DatasetError` if the folder holds a dataset made from
    something else or cannot be written.
    """
    config = config or JobConfig()
    run = find_engine(engine)
    check_renderer(config.dataset.renderer)
    with _threads(jobs):
        folder = Path(out) / scene.name
        if points is None:
            grid = make_grid(scene, config=config.grid)
        else:
            grid = grid_at(scene, as_points(points, "points"), config.grid)
        graph = make_graph(scene, grid, config.graph)
        model = prepare(scene, grid.points, config.simulation, config.dataset.seed)
        plan = make_plan(scene, grid.points, graph, model, config, command)
        if _already_complete(folder, plan.draft):
            remove_job(folder)
            return BuildResult(folder, read_manifest(folder), 0, len(plan.draft.shards))
        job = Job(folder, plan, scene, graph.geodesic, model)
        _open_folder(job, grid)
        built = run(job, progress)
        manifest = finish_job(job)
    return BuildResult(folder, manifest, built, len(manifest.shards))


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
    before, most = numba.get_num_threads(), int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    if jobs is not None and jobs < 1:
        raise ConfigError(f"jobs: expected 1 to {most} (the cores of this machine), got {jobs}")
    if jobs is not None and jobs > most:
        _log.info("%d jobs were asked for; this machine has %d cores, so %d it is", jobs, most, most)
    numba.set_num_threads(before if jobs is None else min(jobs, most))
    try:
        yield
    finally:
        numba.set_num_threads(before)


def _already_complete(folder: Path, draft: Manifest) -> bool:
    """True if the folder holds this very dataset, whole. Raises if it holds another."""
    if not (folder / NAME).exists():
        return False
    found = read_manifest(folder)
    if found.key != draft.key:
        raise DatasetError(
            f"{folder} holds a dataset made from another scene, grid, config, seed or version (key "
            f"{found.key[:12]}, now {draft.key[:12]}); choose another OUT, or delete that folder"
        )
    if not found.complete or found.config != draft.config:
        return False
    return all(
        (folder / e.file).is_file() and (folder / e.file).stat().st_size == e.bytes for e in found.shards
    )
