"""Other processes of this machine."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from soundspaces_sim.core.platforms import process_runs

if TYPE_CHECKING:
    from loky.process_executor import ProcessPoolExecutor

_SAFE_PATH = "PYTHONSAFEPATH"
_lock = threading.Lock()
_before: list[str | None] = []  # of each `isolated_children` that is open, what the variable was


@contextmanager
def isolated_children() -> Iterator[None]:
    """Python processes that are started within import nothing from the current folder, where a stranger's file may
    have the name of a module.

    A variable of the environment, since pools of other libraries name no flags; their processes start whenever they
    are needed, and start others.
    """
    with _lock:
        _before.append(os.environ.get(_SAFE_PATH))
        os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        with _lock:
            last = _before.pop()
            if not _before and last is None:
                del os.environ[_SAFE_PATH]
            elif not _before:
                os.environ[_SAFE_PATH] = str(last)


_EVERY_S = 0.5


def end_with(parent: int) -> None:
    """End this process within about a second of the end of process `parent`, from which it stems."""
    threading.Thread(target=_watch, args=(parent,), name="end with parent", daemon=True).start()


def _watch(parent: int) -> None:
    own = os.getppid() == parent
    while os.getppid() == parent if own else process_runs(parent):
        time.sleep(_EVERY_S)
    os._exit(1)  # nothing is left to clean up for: files are whole or absent


def start_worker(parent: int) -> None:
    """Of a worker process of the process `parent`."""
    end_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent ends it


@contextmanager
def worker_pool(
    processes: int, start: Callable[[int], None] = start_worker
) -> Iterator[ProcessPoolExecutor]:
    """Processes of this machine, which import nothing from the current folder and end with this one; `start` is
    called in each with this process's number."""
    from loky.process_executor import ProcessPoolExecutor

    with isolated_children():
        pool = ProcessPoolExecutor(processes, initializer=start, initargs=(os.getpid(),))
        try:
            yield pool
        finally:
            pool.shutdown(wait=True, kill_workers=True)
