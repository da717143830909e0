"""Job arrays of a SLURM cluster, by submitit.

Each element of the array does a share of the tiles, one after the other, and has a log of its own. One that is
preempted or runs out of time is put back in the queue and goes on where it was, since finished tiles are skipped.
The elements need this command no more once they are submitted: `wait=false` returns at once.
"""

from __future__ import annotations

import logging
import os
import shlex
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import submitit
from submitit.core.utils import FailedJobError, UncompletedJobError
from submitit.helpers import Checkpointable

from soundspaces_sim import ConfigError, DatasetError, SoundSpacesSimError
from soundspaces_sim.parts import (
    Engine,
    EngineOptions as Options,
    TaskDone as Done,
    TaskWatch as Watch,
    TileTask as Task,
    adopt_profile as adopt,
    check_interrupts as check,
    end_with,
    isolated_children,
    refuse_task as refuse,
    work_tile as work,
)

_log = logging.getLogger(__name__)
logging.getLogger("submitit").setLevel(
    logging.ERROR
)  # it warns at every look where there is no accounting
_SHARES = 200  # elements of an array by default; clusters allow some 1,000
_TRIES = 3
_LOOK_S = 0.5


class SlurmOptions(Options, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """As sbatch's: `partition`, `account`, `qos`, `constraint` (one type of CPU!), `exclude`, `timeout_min`,
    `mem_gb`, `cpus_per_task`; `array_parallelism`: elements at once; `elements` of the array in all; `logs`: folder
    for their logs. `wait=false`: return when all is submitted. `cluster=local`: submitit's processes of
    this machine instead of SLURM, to try it."""

    cluster: Literal["slurm", "local"] = "slurm"
    partition: str | None = None
    account: str | None = None
    qos: str | None = None
    constraint: str | None = None
    exclude: str | None = None
    timeout_min: int = 240
    mem_gb: float = 4.0
    cpus_per_task: int = 4
    array_parallelism: int = 64
    elements: int | None = None
    logs: str | None = None
    wait: bool = True


class Share(Checkpointable):
    """Some tasks, for one element of an array; `work` skips those that are done, so it may begin anew."""

    def __init__(
        self, tasks: Sequence[tuple[str, int]], threads: int, parent: int | None = None
    ) -> None:
        self.tasks, self.threads, self.parent = tuple(tasks), threads, parent

    def __call__(self) -> list[Done] | str:
        """What became of each task, or what a user should be told. Ends with the process `parent`, if any."""
        if self.parent is not None:
            end_with(self.parent)
        try:
            return [work(folder, number, self.threads) for folder, number in self.tasks]
        except SoundSpacesSimError as error:
            return str(error)


def run(tasks: Sequence[Task], options: SlurmOptions, cores: int, watch: Watch) -> None:
    """Do the tasks in a job array. Raises `ConfigError`, `DatasetError`."""
    executor = _executor(tasks, options)
    threads = (
        options.cpus_per_task
        if options.cluster == "slurm"
        else max(min(options.cpus_per_task, cores), 1)
    )
    count = min(options.elements or (_SHARES if options.cluster == "slurm" else cores), len(tasks))
    shares = [tuple(tasks[k::count]) for k in range(count)]
    parent = os.getpid() if options.cluster == "local" and options.wait else None
    submitted = _submit(executor, shares, threads, parent)
    jobs = {job: (share, 1) for job, share in zip(submitted, shares, strict=True)}
    _log.info("%s: submitted %d elements, logs in %s", options.cluster, len(jobs), executor.folder)
    while jobs and options.wait:
        check()
        for job in [j for j in jobs if j.done()]:
            share, tries = jobs.pop(job)
            if not _told(job, share, watch):
                if tries >= _TRIES:
                    refuse(share[0], f"its job failed {_TRIES} times; its log is {job.paths.stderr}")
                _log.warning("job %s was lost; its tiles are submitted again", job.job_id)
                (again,) = _submit(executor, [share], threads, parent)
                jobs[again] = (share, tries + 1)
        time.sleep(_LOOK_S)


def _told(job: Any, share: Sequence[Task], watch: Watch) -> bool:
    """Whether a job that has ended did its share; `watch` is told. Raises `DatasetError` if a tile failed."""
    try:
        made = job.result()
    except UncompletedJobError:
        return False
    except Exception as error:  # submitit's, about a job that raised
        refuse(share[0], f"its job failed ({error}); its log is {job.paths.stderr}", error)
    if isinstance(made, str):
        raise DatasetError(f"{made} (log: {job.paths.stderr})")
    for task, done in zip(share, made, strict=True):
        adopt(done.profile)
        watch.done(task, done.made)
    return True


def _submit(
    executor: Any, shares: Sequence[Sequence[Task]], threads: int, parent: int | None
) -> list[Any]:
    calls = [Share([(str(t.folder), t.number) for t in share], threads, parent) for share in shares]
    try:
        with isolated_children(), executor.batch():
            jobs = [executor.submit(call) for call in calls]
    except FailedJobError as error:
        said = " ".join(str(error).split())
        raise ConfigError(f"engine slurm: sbatch refused the job: {said}") from error
    return jobs


def _executor(tasks: Sequence[Task], options: SlurmOptions) -> Any:
    if options.cluster == "slurm" and shutil.which("sbatch") is None:
        raise ConfigError(
            "engine slurm: this machine has no sbatch; run this on a cluster's login node, or try it here with "
            "--engine-option cluster=local"
        )
    for name in ("timeout_min", "cpus_per_task", "array_parallelism", "elements", "mem_gb"):
        value = getattr(options, name)
        if value is not None and value <= 0:
            raise ConfigError(f"engine slurm: option {name}={value}: expected more than 0")
    logs = Path(options.logs) if options.logs else tasks[0].folder.parent / "logs"
    python: dict[str, Any] = {f"{options.cluster}_python": f"{shlex.quote(sys.executable)} -P"}
    executor = submitit.AutoExecutor(folder=str(logs), cluster=options.cluster, **python)
    given: dict[str, Any] = {
        "name": "soundspaces_sim",
        "timeout_min": options.timeout_min,
        "mem_gb": options.mem_gb,
        "cpus_per_task": options.cpus_per_task,
    }
    if options.cluster == "slurm":
        given["slurm_array_parallelism"] = options.array_parallelism
        for name in ("partition", "account", "qos", "constraint", "exclude"):
            if (value := getattr(options, name)) is not None:
                given[f"slurm_{name}"] = value
    executor.update_parameters(**given)
    return executor


ENGINE = Engine(SlurmOptions, run)
