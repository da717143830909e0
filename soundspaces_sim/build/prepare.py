"""The beginning of a job: points, graph, model and plan of a scene, and its folder on the disk."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from soundspaces_sim.build import warm_up
from soundspaces_sim.build.engines import BuildProgress, Progress
from soundspaces_sim.build.job_file import Job, remove_job, write_job
from soundspaces_sim.build.plan import JobPlan, make_plan
from soundspaces_sim.core.config import JobConfig, differences
from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.io.files import make_folder, publish, remove_stale
from soundspaces_sim.dataset.format.floorplan import NAME as FLOORPLAN, encode_floorplan
from soundspaces_sim.dataset.format.manifest import NAME, Manifest, read_manifest, write_manifest
from soundspaces_sim.layout.floor_plan import make_floorplan
from soundspaces_sim.layout.grid import grid_at, make_grid
from soundspaces_sim.layout.navigation_graph import make_graph, only_standing
from soundspaces_sim.layout.records import Grid
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.preparation import make_model

_DECIDES = re.compile(r"simulation\.|grid\.|dataset\.seed")  # settings that decide what is simulated


@dataclass(frozen=True)
class Prepared:
    """A job whose folder is open, and the manifest that was found in it. `whole`: nothing is left to do. `job`
    may be dropped: the folder has all of it."""

    folder: Path
    plan: JobPlan
    job: Job | None
    found: Manifest | None
    whole: bool

    @property
    def changed(self) -> tuple[str, ...]:
        """Settings of the folder's dataset that are now others, as ``dataset.rate 44100, now 8000``."""
        if self.found is None:
            return ()
        return tuple(differences(self.found.config, self.plan.draft.config))


def open_dataset_job(
    scene: Scene,
    folder: Path,
    config: JobConfig,
    points: np.ndarray | None = None,
    command: str = "",
    progress: Progress | None = None,
) -> Prepared:
    """Plan a scene's job and open its folder, or find that its dataset is whole.

    Raises `SceneError`, `PointError`, and `DatasetError` if the folder holds a dataset made from something
    else or cannot be written.
    """
    job, grid = plan_job(scene, folder, config, points, command, progress)
    draft = job.plan.draft
    found = _found(folder, draft)
    if found is not None and found.config == draft.config and _whole(folder, found):
        with suppress(DatasetError):  # a finished dataset may lie where nothing can be written
            remove_job(folder)
        return Prepared(folder, job.plan, job, found, True)
    _open_folder(job, grid)
    return Prepared(folder, job.plan, job, found, False)


def plan_job(
    scene: Scene,
    folder: Path,
    config: JobConfig,
    points: np.ndarray | None = None,
    command: str = "",
    progress: Progress | None = None,
) -> tuple[Job, Grid]:
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
        step(f"Navigation graph of {len(grid):,} points")
        graph = make_graph(scene, grid, config.graph)
        if config.grid.standing:
            grid, graph = only_standing(scene, grid, graph)
        if compiling is not None:
            compiling.wait(lambda done, total: step("Compiling kernels, once", done, total))
    except BaseException:
        if compiling is not None:
            compiling.stop()
        raise
    step(f"Preparing the scene for {len(grid):,} points")
    model = make_model(scene, grid.points, config.simulation, config.dataset.seed)
    config = msgspec.structs.replace(config, simulation=model.config)  # with what was left to the job
    height = grid.height if points is None else None
    plan = make_plan(scene, grid.points, graph, model, config, command, height)
    return Job(folder, plan, scene, graph.geodesic, model), grid


def _open_folder(job: Job, grid: Grid) -> None:
    """Make the folder, or take over one whose job was interrupted or stored less."""
    make_folder(job.folder, "choose another OUT")
    remove_stale(job.folder)
    write_manifest(job.folder, job.plan.draft)
    publish(job.folder / FLOORPLAN, encode_floorplan(make_floorplan(job.scene, grid)))
    write_job(job)


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
