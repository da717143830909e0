"""What every engine calls on its workers: one tile, from the folder and a number; or, here, several as one."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from soundspaces_sim.build.finish import is_finished
from soundspaces_sim.build.job_file import has_job, open_job
from soundspaces_sim.build.square import squares
from soundspaces_sim.build.tile import build_tiles
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


def work(folder: str, number: int, threads: int | None = None, timeout_s: float = TIMEOUT_S) -> Done:
    """Make tile `number` of the job in `folder` with `threads` threads (None: as many as this process uses).

    Waits `timeout_s` for a job that is not visible here yet. A job that somebody else finished meanwhile has
    all its tiles. Raises `DatasetError`, which names this machine.
    """
    if threads is not None:
        set_thread_count(threads)
    return _work(Path(folder), [number], (), timeout_s, None)[number]


def work_here(folder: str, numbers: Sequence[int], progress: Progress | None = None) -> dict[int, Done]:
    """Make the first of these tiles of a job, and those of them that are simulated with it as one (`build.square`);
    the others come afterwards, in this process. By number what was made. Raises as `work` does."""
    path = Path(folder)
    first = (
        squares(open_job(path).plan, numbers, open_job(path).side)[0].numbers
        if has_job(path)
        else numbers
    )
    return _work(path, first, [n for n in numbers if n not in first], 0.0, progress)


def _work(
    path: Path,
    numbers: Sequence[int],
    upcoming: Sequence[int],
    timeout_s: float,
    progress: Progress | None,
) -> dict[int, Done]:
    start, collected = time.perf_counter(), here() is not None
    try:
        with profiled("tiles") as found:
            wait_for(lambda: has_job(path) or is_finished(path), path, timeout_s)
            made = build_tiles(open_job(path), numbers, progress, upcoming)
    except DatasetError as error:
        if has_job(path) or not is_finished(path):
            raise DatasetError(f"{error} (on {socket.gethostname()})") from error
        made = dict.fromkeys(numbers, 0)
    seconds = (time.perf_counter() - start) / len(numbers)
    profile = None if collected else found.stage
    return {
        number: Done(made[number], seconds, profile if number == numbers[0] else None)
        for number in numbers
    }
