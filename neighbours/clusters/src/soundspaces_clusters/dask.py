"""Workers of a Dask scheduler, on any machines that see the folder; without one, processes of this machine.

One thread of a Dask worker does one tile at a time. A worker that is lost costs what it had in work: the
scheduler gives it to others. Where nothing has ended for long, the tiles still in work are given out a second
time: the bytes are the same on every machine, so that a machine that hangs cannot hold up a job.
"""

from __future__ import annotations

import logging
import queue
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import dask
from distributed import Client, Future, KilledWorker, LocalCluster

from soundspaces_sim import ConfigError, DatasetError
from soundspaces_sim.parts import (
    Engine,
    EngineOptions as Options,
    TaskDone as Done,
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

_log = logging.getLogger(__name__)
logging.getLogger("distributed").setLevel(logging.WARNING)  # else it tells of every connection
_LOOK_S = 0.5
_MANY_TIMES = 3.0  # the longest tile so far


class DaskOptions(Options, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`address` of a scheduler, ``tcp://host:8786``, or its `scheduler_file`; by default that of Dask's own
    configuration (``DASK_SCHEDULER_ADDRESS``), else a `LocalCluster` of `workers` processes. `threads` per
    tile; by default 1 on a scheduler's workers. `again_s`: seconds without a finished tile, at least, after which
    those in work are given out a second time."""

    address: str | None = None
    scheduler_file: str | None = None
    workers: int | None = None
    threads: int | None = None
    again_s: float = 60.0
    connect_s: float = 30.0


def run(tasks: Sequence[Task], options: DaskOptions, cores: int, watch: Watch) -> None:
    """Do the tasks on the scheduler's workers. Raises `ConfigError`, `DatasetError`."""
    with _client(options, cores, len(tasks)) as (client, threads):
        _Run(client, threads, options.again_s, watch).do(tasks)


@contextmanager
def _client(options: DaskOptions, cores: int, tasks: int) -> Iterator[tuple[Client, int]]:
    """A client, and the threads that a tile may use on its workers."""
    address = options.address or dask.config.get("scheduler-address", None)
    if address is None and options.scheduler_file is None:
        shape = choose_shape(cores, free_memory(), tasks, options.workers, options.threads)
        _log.info("Dask on this machine: %s", shape)
        with (
            isolated_children(),
            LocalCluster(
                shape.processes, threads_per_worker=1, processes=True, dashboard_address=None
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client, shape.threads
        return
    try:
        client = Client(address, scheduler_file=options.scheduler_file, timeout=options.connect_s)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"engine dask: no scheduler answers at {address or options.scheduler_file} ({error}); start one with "
            "`dask scheduler`, or leave out the address to use this machine"
        ) from error
    with client:
        _log.info("Dask at %s: %d workers", client.scheduler.address, len(client.nthreads()))
        yield client, options.threads or 1


class _Run:
    """Tasks on their way through a scheduler."""

    def __init__(self, client: Client, threads: int, again_s: float, watch: Watch) -> None:
        self._client, self._threads, self._again_s, self._watch = client, threads, again_s, watch
        self._ended: queue.SimpleQueue[tuple[Future, Task]] = queue.SimpleQueue()
        self._name = uuid.uuid4().hex[:8]
        self._copies: dict[Task, list[Future]] = {}
        self._given = 0

    def do(self, tasks: Sequence[Task]) -> None:
        """Return when every task is done. Raises `DatasetError`."""
        self._submit(tasks)
        longest, last = 0.0, time.monotonic()
        while self._copies:
            check()
            try:
                future, task = self._ended.get(timeout=_LOOK_S)
            except queue.Empty:
                self._look_at_scheduler()
                if time.monotonic() - last > max(self._again_s, _MANY_TIMES * longest):
                    self._give_out_again()
                    last = time.monotonic()
                continue
            if task not in self._copies or future not in self._copies[task]:
                continue
            done = self._result(future, task)
            adopt(done.profile)
            self._watch.done(task, done.made)
            longest, last = max(longest, done.seconds), time.monotonic()
            if copies := [f for f in self._copies.pop(task) if f is not future]:
                self._client.cancel(copies, force=True)

    def _submit(self, tasks: Sequence[Task]) -> None:
        """Once more each; they begin in the order of their keys, which is that of the tasks.

        Keys with a common head make them one group to the scheduler: it keeps what no worker can begin at once,
        instead of dealing out all of it beforehand, by a guess of how long tiles take.
        """
        keys = [(f"tile-{self._name}", self._given + k) for k in range(len(tasks))]
        self._given += len(tasks)
        folders, numbers = [str(t.folder) for t in tasks], [t.number for t in tasks]
        futures = self._client.map(
            work, folders, numbers, [self._threads] * len(tasks), key=keys, pure=False
        )
        for task, future in zip(tasks, futures, strict=True):
            self._copies.setdefault(task, []).append(future)
            future.add_done_callback(lambda f, t=task: self._ended.put((f, t)))

    def _give_out_again(self) -> None:
        if not self._client.nthreads():
            _log.warning("no worker is connected to %s; waiting for one", self._client.scheduler.address)
            return
        late = [task for task, copies in self._copies.items() if len(copies) == 1]
        if late and len(late) <= 2 * sum(self._client.nthreads().values()):
            _log.warning("nothing has ended for long: %d tiles are given out a second time", len(late))
            self._submit(late)

    def _look_at_scheduler(self) -> None:
        if self._client.status != "running":
            raise DatasetError(
                f"the Dask scheduler at {self._client.scheduler.address} is lost; finished shards are safe: run "
                "the same command again to go on"
            )

    def _result(self, future: Future, task: Task) -> Done:
        if future.status == "cancelled":
            self._look_at_scheduler()
            refuse(task, "the Dask scheduler dropped it (was it restarted?)")
        try:
            done: Done = future.result()
            return done
        except KilledWorker as error:
            refuse(task, f"the Dask workers that had it were killed (out of memory?): {error}", error)


ENGINE = Engine(DaskOptions, run)
