"""Engines: who runs the tiles of a job.

An engine is a function ``run(job, progress) -> shards made``. It sees to it that `jobs.tile.run_tile` is
called for every tile, anywhere and in any order (or `build_tile` in the process that holds the job), and
returns when all are there; it knows nothing of what a tile is. A new one is a file here and a line below.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from soundspaces_sim.base.registry import Entry, find

if TYPE_CHECKING:
    from soundspaces_sim.jobs.record import Job

ENGINES: Mapping[str, Entry] = {
    "local": Entry("soundspaces_sim.jobs.engines.local:run", "threads of this process"),
}


@dataclass(frozen=True)
class BuildProgress:
    """`done` of `total` points traced (a point counts once per tile it is in; a total of 0: not known yet);
    `rirs` finished in this run, and `under_way`: the share of the tile in work that is traced, as RIRs."""

    stage: str
    done: int
    total: int
    rirs: int
    under_way: float = 0.0


Progress = Callable[[BuildProgress], None]
Run = Callable[["Job", Progress | None], int]


def find_engine(name: str) -> Run:
    """The engine of that name. Raises `ConfigError`."""
    run: Run = find("engine", ENGINES, name)
    return run
