"""This machine: tiles one after the other in this process, or side by side in processes of their own.

A process of its own has no share in this one's state: tiles leave it as files, so the bytes are the same. One
that is killed (out of memory, `kill -9`) costs the tiles that were in work: they begin anew in new processes.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial

from soundspaces_sim.build.engines import Engine, Options, Task, Watch, refuse
from soundspaces_sim.build.engines.capacity import Shape, choose_shape
from soundspaces_sim.build.worker import Done, work, work_here
from soundspaces_sim.core.interrupts import check
from soundspaces_sim.core.memory import free_memory
from soundspaces_sim.core.numerics.kernel import thread_count
from soundspaces_sim.core.processes import worker_pool
from soundspaces_sim.core.profile import adopt

_log = logging.getLogger(__name__)
_TRIES = 3  # of a task whose process is killed
_LOOK_S = 0.5
_WORTH_S = 30.0  # jobs that take less are done before processes have started and loaded their kernels


class LocalOptions(Options, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`processes` and the `threads` of each; by default from cores and memory."""

    processes: int | None = None
    threads: int | None = None


def run(tasks: Sequence[Task], options: LocalOptions, cores: int, watch: Watch) -> None:
    """Do the tasks here. Raises `DatasetError`.

    Where nobody says how many processes, the last tile, which is the smallest, is made in this one, and others are
    started if what is left is worth it.
    """
    memory = free_memory()
    shape = choose_shape(cores, memory, len(tasks), options.processes, options.threads)
    if options.processes is None and options.threads is None and shape.processes > 1:
        start = time.perf_counter()
        _run_here(tasks[-1:], watch)
        left = sum(t.cost for t in tasks[:-1]) / tasks[-1].cost * (time.perf_counter() - start)
        tasks = tasks[:-1]
        if left < _WORTH_S:
            shape = Shape(1, cores)
    _log.info("%s (%d cores, %.1f GB of memory free)", shape, cores, memory / 1e9)
    if shape.processes > 1 or shape.threads != thread_count():
        _run_processes(tasks, shape, watch)
    else:
        _run_here(tasks, watch)


def _run_here(tasks: Sequence[Task], watch: Watch) -> None:
    left = list(tasks)
    while left:
        first = left[0]
        of_folder = {t.number: t for t in left if t.folder == first.folder}
        traced = partial(watch.under_way, first)
        done = {of_folder[n]: d for n, d in work_here(str(first.folder), [*of_folder], traced).items()}
        for task, made in done.items():
            watch.done(task, made.made)
        left = [task for task in left if task not in done]


def _run_processes(tasks: Sequence[Task], shape: Shape, watch: Watch) -> None:
    waiting, tries = list(reversed(tasks)), dict.fromkeys(tasks, 0)
    while waiting:
        running: dict[Future[Done], Task] = {}
        try:
            with worker_pool(shape.processes) as pool:
                while waiting or running:
                    # no queue: a lost pool costs these only
                    while waiting and len(running) < shape.processes:
                        task = waiting.pop()
                        tries[task] += 1
                        running[pool.submit(work, str(task.folder), task.number, shape.threads)] = task
                    for future in wait(running, _LOOK_S, FIRST_COMPLETED).done:
                        done = future.result()
                        adopt(done.profile)
                        watch.done(running.pop(future), done.made)
                    check()
        except BrokenProcessPool as error:
            for task in running.values():
                if tries[task] >= _TRIES:
                    refuse(task, f"its process was killed {_TRIES} times (out of memory?)", error)
            _log.warning("a process was killed; its tiles begin again")
            waiting += running.values()


ENGINE = Engine(LocalOptions, run, remote=False)
