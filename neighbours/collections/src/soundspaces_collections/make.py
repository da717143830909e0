"""The datasets of a collection: one building a process, as `build.rooms` does it, or in batches by another
engine."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from soundspaces_rooms.many_rooms import in_processes

from soundspaces_collections.records import Record, add_record, describe, read_records
from soundspaces_sim import (
    ConfigError,
    DatasetError,
    JobConfig,
    SimulationError,
    SoundSpacesSimError,
    build_dataset,
    build_datasets,
    load_scene,
    open_dataset,
)
from soundspaces_sim.parts import MANIFEST_NAME as MANIFEST, core_count, forecast, read_manifest

Log = Callable[[str], None]
Progress = Callable[[int, int, str], None]
_BATCH = 32  # buildings that another engine is given at a time
_FAILURES = 5  # in a row after which something else than the building is wrong
_SAMPLE = 2  # buildings that are measured for a forecast, where none is finished
_KNOWN = 3  # finished ones of which a forecast is made instead


@dataclass(frozen=True)
class Collection:
    """Buildings ``<kind>-0`` to ``<kind>-<count - 1>`` in the folder `out`; `command`: what makes one of them."""

    out: Path
    count: int
    config: JobConfig
    kind: str = "home"
    episodes: int = 20  # per building

    def __post_init__(self) -> None:
        for name, value, most in (("homes", self.count, 10**6), ("episodes", self.episodes, 10**5)):
            if not 1 <= value <= most:
                raise ConfigError(f"{name}: expected 1 to {most:,}, got {value}")

    @property
    def names(self) -> list[str]:
        """Of all buildings."""
        return [f"{self.kind}-{k}" for k in range(self.count)]

    def is_whole(self, name: str) -> bool:
        """Whether a building's dataset is finished. Raises `DatasetError` if it was made with other settings."""
        folder = self.out / name
        if not (folder / MANIFEST).exists():
            return False
        found = read_manifest(folder)
        return found.complete and found.config == self.settings_of(found.config)

    def settings_of(self, found: JobConfig) -> JobConfig:
        """These settings, with what a job chooses for itself as it was found."""
        chosen = found.simulation.radiance_transfer
        own = self.config.simulation.radiance_transfer
        if own.subpaths != "auto":
            return self.config
        simulation = msgspec.structs.replace(self.config.simulation, radiance_transfer=chosen)
        return msgspec.structs.replace(self.config, simulation=simulation)


def split_of(name: str) -> str:
    """The split of a building, by its number alone: of ten, the ninth is for validation and the tenth for tests. No
    building changes its split when more are made."""
    return {8: "val", 9: "test"}.get(int(name.rpartition("-")[2]) % 10, "train")


class Task(NamedTuple):
    """A building to be made, or, if its dataset is there, to be described."""

    name: str
    out: Path
    config: JobConfig
    make: bool


def make_task(task: Task) -> Record:
    """Make and describe a building. Whatever goes wrong with it is in its record, and stops no other."""
    wall, processor = time.monotonic(), time.process_time()
    times: dict[str, float] = {}
    try:
        scene = load_scene(task.name)
        if task.make:
            build_dataset(scene, task.out, task.config, 1, command=rebuild(task.name))
            spent = time.process_time() - processor, time.monotonic() - wall
            times = {"processor_s": round(spent[0], 2), "wall_s": round(spent[1], 2)}
        with open_dataset(task.out / task.name) as ds:
            return msgspec.structs.replace(describe(ds, scene), **times)
    except Exception as error:
        return Record(scene=task.name, error=f"{type(error).__name__}: {error}"[:2000])


def rebuild(name: str) -> str:
    """The command that makes one building again."""
    return f"soundspaces-sim rirs {name} --config pipelines/collection.toml"


def make_all(
    of: Collection,
    jobs: int | None,
    engine: str,
    options: Mapping[str, Any] | Sequence[str],
    log: Log,
    progress: Progress,
) -> dict[str, Record]:
    """Datasets and records of all buildings; those that are there are left alone. Raises `SimulationError` when
    several fail one after the other."""
    records = read_records(of.out)
    whole = {name for name in of.names if of.is_whole(name)}
    left = [name for name in of.names if name not in whole]
    if left and engine != "local":
        _by_engine(of, left, jobs, engine, options, log)
        whole |= {name for name in left if of.is_whole(name)}
    tasks = [
        Task(name, of.out, of.config, name not in whole)
        for name in of.names
        if name not in whole or not (name in records and records[name].described)
    ]
    row = 0
    done = of.count - len(tasks)
    for record in in_processes(make_task, tasks, jobs):
        add_record(of.out, record)
        done, row = done + 1, row + 1 if record.error else 0
        took = "" if record.processor_s is None else f", {record.processor_s:.0f} s of processor time"
        text = record.error or f"{record.points} points, {record.bytes / 1e6:.1f} MB{took}"
        log(f"{record.scene}: {text}")
        progress(done, of.count, record.scene)
        if row == _FAILURES:
            raise SimulationError(
                f"{row} buildings failed one after the other, at last {record.scene}: {record.error}"
            )
    return {name: r for name, r in read_records(of.out).items() if name in set(of.names)}


def _by_engine(
    of: Collection, left: list[str], jobs: int | None, engine: str, options: Any, log: Log
) -> None:
    """Batches of datasets as one job each. Of a batch that fails each building is left to be tried alone, here."""
    for first in range(0, len(left), _BATCH):
        batch = left[first : first + _BATCH]
        log(f"{batch[0]} to {batch[-1]} by {engine}")
        try:
            build_datasets(
                [_loader(name) for name in batch],
                of.out,
                of.config,
                jobs,
                command="",
                engine=engine,
                options=options,
            )
        except (SimulationError, DatasetError) as error:
            log(f"a batch failed ({error}); its buildings are made one by one")


def _loader(name: str) -> Callable[[], Any]:
    return lambda: load_scene(name)


@dataclass(frozen=True)
class CollectionForecast:
    """Of what is left: buildings, core-seconds with their standard error over buildings (nan of one), bytes;
    `basis`: how many buildings tell, and whether they are `finished` ones."""

    left: int
    core_s: float
    core_s_error: float
    bytes: float
    basis: int
    finished: bool


def forecast_collection(of: Collection, log: Log) -> CollectionForecast:
    """Time and bytes of what is left: from finished buildings if there are three, else from some that are
    measured."""
    left = [name for name in of.names if not of.is_whole(name)]
    known = [r for r in read_records(of.out).values() if r.processor_s is not None and r.described]
    if not left or len(known) >= _KNOWN:
        times, sizes = [float(r.processor_s or 0.0) for r in known], [float(r.bytes) for r in known]
    else:
        chosen = [left[k] for k in np.unique(np.linspace(0, len(left) - 1, _SAMPLE).astype(int))]
        times, sizes = [], []
        for name in chosen:
            log(f"measuring {name} for a forecast")
            try:
                found = forecast(load_scene(name), of.config)
            except SoundSpacesSimError as why:  # it will be among the failures
                log(f"{name} cannot be measured: {why}")
                continue
            times.append(3600.0 * found.core_hours)
            sizes.append(float(found.bytes))
    if not left or not times:
        return CollectionForecast(len(left), 0.0, 0.0, 0.0, 0, True)
    error = float(np.std(times, ddof=1) / np.sqrt(len(times))) if len(times) > 1 else float("nan")
    return CollectionForecast(
        len(left),
        len(left) * float(np.mean(times)),
        len(left) * error,
        len(left) * float(np.mean(sizes)),
        len(times),
        len(known) >= _KNOWN,
    )


def check_room(of: Collection, expected: CollectionForecast) -> None:
    """Raise `DatasetError` if the disk has no room for what is forecast."""
    free = shutil.disk_usage(of.out).free
    if not expected.bytes <= free:
        raise DatasetError(
            f"{of.out}: {free / 1e9:.1f} GB are free, about {expected.bytes / 1e9:.1f} GB needed; choose "
            f"another --out, "
            "or fewer --homes"
        )


def cores_of(jobs: int | None) -> int:
    """How many cores a job uses here."""
    return min(jobs or core_count(), core_count())
