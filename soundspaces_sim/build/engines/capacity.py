"""How much of a machine a job may use: processes × threads, from its cores and its memory."""

from __future__ import annotations

from typing import NamedTuple

from soundspaces_sim.core.errors import ConfigError

PROCESS_BYTES = 4e9  # a tile's tables and what is loaded beside them; measured, see docs/clusters.md
_PROCESS_CORES = 8  # that a process keeps busy: some 2 % of what it does is done on one core
_TILES = 4  # of a process, at least, as others trace anew what one has traced, …
_MOST_CORES = 32  # … unless each would have so many cores
_SHARED = 2  # threads for each core: while one process works on one core, others use its cores


class Shape(NamedTuple):
    """Processes, and threads of each."""

    processes: int
    threads: int

    def __str__(self) -> str:
        p = f"{self.processes} process{'es' if self.processes > 1 else ''}"
        return f"{p} × {self.threads} thread{'s' if self.threads > 1 else ''}"


def choose_shape(
    cores: int, memory: float, tasks: int, processes: int | None = None, threads: int | None = None
) -> Shape:
    """Processes × threads for `cores` and `memory` bytes, unless given; no more processes than `tasks`.

    Several processes have more threads than there are cores: the machine deals its cores out to whoever has work,
    so that those which are left at the end have more. Raises `ConfigError` for numbers below 1.
    """
    for name, value in (("processes", processes), ("threads", threads)):
        if value is not None and value < 1:
            raise ConfigError(f"{name}: expected at least 1, got {value}")
    if processes is None:
        wanted = cores // (threads or _PROCESS_CORES)
        if threads is None:
            wanted = min(wanted, max(tasks // _TILES, cores // _MOST_CORES))
        processes = max(min(wanted, int(memory / PROCESS_BYTES), tasks), 1)
        threads = threads or min(_SHARED * cores // processes, cores)
    return Shape(processes, threads or max(cores // processes, 1))
