"""Engines run the tiles of a job.

An engine is a record `ENGINE` of a module, here or in neighbours/clusters: the options that it takes, and a
function ``run(tasks, options, cores, watch)``. It calls `build.worker.work` once per task, anywhere
and in any order, and returns when all are done; it knows nothing of what a tile is. A new one is a file here and
a line below.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import msgspec

from soundspaces_sim.core.errors import ConfigError, DatasetError
from soundspaces_sim.core.registry import Entry, find

ENGINES: Mapping[str, Entry] = {
    "local": Entry(
        "soundspaces_sim.build.engines.local:ENGINE", "threads and processes of this machine"
    ),
    "dask": Entry("soundspaces_clusters.dask:ENGINE", "workers of a Dask scheduler, or processes here"),
    "slurm": Entry("soundspaces_clusters.slurm:ENGINE", "job arrays of a SLURM cluster, by submitit"),
    "ray": Entry("soundspaces_clusters.ray:ENGINE", "workers of a Ray cluster, or processes here"),
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


@dataclass(frozen=True)
class Task:
    """A tile of the job in `folder`; `cost`: how long it takes, compared with others."""

    folder: Path
    number: int
    cost: float = 1.0

    def __str__(self) -> str:
        return f"tile {self.number} of {self.folder}"


class Watch:
    """Who is told how far the tasks are; this one keeps it for itself."""

    def under_way(self, task: Task, points: int) -> None:
        """So many points of a task are traced; of engines that know it."""

    def done(self, task: Task, made: int) -> None:
        """A task is done; `made`: shards that were missing."""


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What an engine can be told, ``--engine-option name=value``; a field's default holds where nothing is."""


Run = Callable[[Sequence[Task], Any, int, Watch], None]


@dataclass(frozen=True)
class Engine:
    """`run(tasks, options, cores, watch)`: tasks in the order in which they should begin; `cores`: how many
    the job may use on this machine. `remote`: whether files may become visible here later than there."""

    options: type[Options]
    run: Run
    remote: bool = True


def find_engine(name: str) -> Engine:
    """The engine of that name. Raises `ConfigError`, also where what it needs is not installed."""
    try:
        engine: Engine = find("engine", ENGINES, name)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"engine {name}: needs {error.name}, which is not installed; in a clone: "
            f".venv/bin/pip install './neighbours/clusters[{name}]'"
        ) from error
    return engine


def read_options(name: str, engine: Engine, given: Mapping[str, Any] | Iterable[str]) -> Options:
    """The options of an engine from ``{key: value}`` or ``key=value`` texts. Raises `ConfigError`."""
    pairs = dict(given.items() if isinstance(given, Mapping) else map(_split, given))
    fields = msgspec.structs.fields(engine.options)
    known = ", ".join(sorted(f.name for f in fields)) or "none"
    for key in pairs:
        if key not in {f.name for f in fields}:
            raise ConfigError(f"engine {name}: no option '{key}'; its options are {known}")
    for key, value in pairs.items():
        try:
            msgspec.convert({key: value}, engine.options, strict=False)
        except msgspec.ValidationError as error:
            what = str(error).split(" - at ")[0]
            raise ConfigError(
                f"engine {name}: option {key}={value}: {what[0].lower()}{what[1:]}"
            ) from error
    return msgspec.convert(pairs, engine.options, strict=False)


def _split(text: str) -> tuple[str, str]:
    key, sign, value = text.partition("=")
    if not sign or not key.strip():
        raise ConfigError(f"--engine-option {text}: expected key=value")
    return key.strip(), value.strip()


def refuse(task: Task, what: str, error: BaseException | None = None) -> NoReturn:
    """Raise the `DatasetError` of a task that no worker could do."""
    raise DatasetError(
        f"{task}: {what}; finished shards are safe: run the same command again to go on"
    ) from error
