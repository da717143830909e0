"""What every engine calls on its workers: one tile, from the folder and a number."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from soundspaces_sim.build.finish import is_finished
from soundspaces_sim.build.job_file import Job, has_job, open_job
from soundspaces_sim.build.tile import build_tile
from soundspaces_sim.build.wait import wait_for
from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.numerics.kernel import set_thread_count
from soundspaces_sim.core.profile import Stage, here, profiled
from soundspaces_sim.transport.integrator import Progress

TIMEOUT_S = 60.0  # for files that another machine has made; caches of NFS live as long


class Done(NamedTuple):
    """What a worker reports: shards that were missing and are made, how long it took, and where its time went,
    unless this process collects that (`core.profile`)."""

    made: int
    seconds: float
    profile: Stage | None = None


def work(
    folder: str,
    number: int,
    threads: int | None = None,
    timeout_s: float = TIMEOUT_S,
    progress: Progress | None = None,
    upcoming: Sequence[int] = (),
) -> Done:
    """Make tile `number` of the job in `folder` with `threads` threads (None: as many as this process uses).

    `upcoming`: tiles of the job that this process makes afterwards.

    Waits `timeout_s` for a job that is not visible here yet. A job that somebody else finished meanwhile has
    all its tiles. Raises `DatasetError`, which names this machine.
    """
    start = time.perf_counter()
    if threads is not None:
        set_thread_count(threads)
    path, collected = Path(folder), here() is not None
    try:
        with profiled("tiles") as found:
            made = build_tile(_job(path, timeout_s), number, progress, upcoming)
    except DatasetError as error:
        if not has_job(path) and is_finished(path):
            return Done(0, time.perf_counter() - start)
        raise DatasetError(f"{error} (on {socket.gethostname()})") from error
    return Done(made, time.perf_counter() - start, None if collected else found.stage)


def _job(folder: Path, timeout_s: float) -> Job:
    wait_for(lambda: has_job(folder) or is_finished(folder), folder, timeout_s)
    return open_job(folder)
