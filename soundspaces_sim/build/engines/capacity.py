"""How much of a machine a job may use: processes × threads, from its cores and its memory."""

from __future__ import annotations

from typing import NamedTuple

from soundspaces_sim.core.errors import ConfigError

PROCESS_BYTES = 4e9  # a tile's tables and what is loaded beside them; measured, see docs/clusters.md
_PROCESS_CORES = (
    4  # a tile keeps so many busy; more wait for what it does in one thread, packing its shards
)


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

    Raises `ConfigError` for numbers below 1.
    """
    for name, value in (("processes", processes), ("threads", threads)):
        if value is not None and value < 1:
            raise ConfigError(f"{name}: expected at least 1, got {value}")
    if processes is None:
        wanted = cores // (threads or _PROCESS_CORES)
        processes = max(min(wanted, int(memory / PROCESS_BYTES), tasks), 1)
    return Shape(processes, threads or max(cores // processes, 1))
