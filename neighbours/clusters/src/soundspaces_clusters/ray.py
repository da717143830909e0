"""Workers of a Ray cluster, or processes of this machine; a worker that is lost costs what it had in work."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence

import ray

from soundspaces_sim import ConfigError, DatasetError
from soundspaces_sim.parts import (
    Engine,
    EngineOptions as Options,
    TaskWatch as Watch,
    TileTask as Task,
    adopt_profile as adopt,
    check_interrupts as check,
    choose_shape,
    free_memory,
    isolated_children,
    refuse_task as refuse,
    work_tile as work,
)

_TRIES = 3
_LOOK_S = 0.5


class RayOptions(Options, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`address` of a cluster, ``auto`` or ``ray://host:10001``; by default Ray's own (``RAY_ADDRESS``), else
    this machine. `threads` per tile, for which a worker reserves as many CPUs."""

    address: str | None = None
    threads: int | None = None


def run(tasks: Sequence[Task], options: RayOptions, cores: int, watch: Watch) -> None:
    """Do the tasks on Ray's workers. Raises `ConfigError`, `DatasetError`."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    address = options.address or os.environ.get("RAY_ADDRESS")
    shape = choose_shape(cores, free_memory(), len(tasks), threads=options.threads)
    threads = shape.threads if address is None else options.threads or 1
    here = {} if address else {"num_cpus": shape.processes * threads, "include_dashboard": False}
    try:
        with isolated_children():
            ray.init(address=address, logging_level=logging.WARNING, **here)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise ConfigError(f"engine ray: no cluster at {address} ({error})") from error
    try:
        _do(tasks, threads, watch)
    finally:
        ray.shutdown()


def _do(tasks: Sequence[Task], threads: int, watch: Watch) -> None:
    remote = ray.remote(num_cpus=threads, max_retries=_TRIES - 1)(work)
    running = {remote.remote(str(t.folder), t.number, threads): t for t in tasks}
    while running:
        check()
        for done in ray.wait(list(running), timeout=_LOOK_S)[0]:
            task = running.pop(done)
            try:
                result = ray.get(done)
            except ray.exceptions.RayTaskError as error:
                raise DatasetError(str(error.cause)) from error
            except ray.exceptions.RayError as error:
                refuse(task, f"the Ray workers that had it were lost {_TRIES} times ({error})", error)
            adopt(result.profile)
            watch.done(task, result.made)


ENGINE = Engine(RayOptions, run)
