"""Rooms from a list in a file, each into an echogram shard of its own: what `soundspaces-sim rooms` does.

The list has a room per line, JSON: `name`, `sources`, `listeners`, and either `scene` (what `load_scene` takes) or
`size` of a shoebox with its `absorption`, `scattering` and `transmission` (`build.shoebox`). A shard is written
whole or not at all; one that is there and was made of the same is left alone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np

from soundspaces_rooms.many_rooms import ROOM_CONFIG, in_processes, room_named
from soundspaces_sim import (
    ConfigError,
    DatasetError,
    JobConfig,
    Scene,
    Stage,
    __version__,
    load_scene,
    profiled,
    shoebox,
)
from soundspaces_sim.parts import (
    as_points,
    code_target,
    encode_echograms,
    is_valid_shard as is_valid,
    make_folder,
    model_between,
    profile_here as here,
    profile_stage as stage,
    publish_file as publish,
    read_text,
    simulate_between,
    with_notes,
)

_MOST = 2**30  # bytes of a list
_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,199}\Z"

_Value = float | str | dict[str, float | str]
_Fraction = float | dict[str, float]
_Point = tuple[float, float, float]


class RoomLine(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A line of the list. Points in m."""

    name: Annotated[str, msgspec.Meta(pattern=_NAME)]
    sources: tuple[_Point, ...]
    listeners: tuple[_Point, ...]
    scene: str | None = None
    size: _Point | None = None
    absorption: _Value = 0.1
    scattering: _Fraction = 0.5
    transmission: _Fraction = 0.0


class RoomTask(NamedTuple):
    """A room to be made, of so many."""

    line: RoomLine
    file: Path
    config: JobConfig
    rooms: int


class RoomDone(NamedTuple):
    """What became of it; `profile`: where time went, unless this process collects that (`core.profile`)."""

    file: Path
    pairs: int
    made: bool  # False: it was there
    rooms: int  # of the list
    profile: Stage | None = None


def read_rooms(path: Path) -> list[RoomLine]:
    """The rooms of a list. Raises `ConfigError`, which names the line."""
    rooms: list[RoomLine] = []
    seen: dict[str, int] = {}
    for number, text in enumerate(read_text(path, ConfigError, "list of rooms", _MOST).splitlines(), 1):
        if not text.strip():
            continue
        where = f"{path}, line {number}"
        try:
            room = msgspec.json.decode(text, type=RoomLine)
        except msgspec.MsgspecError as error:
            raise ConfigError(f"{where}: {error}") from error
        if (room.scene is None) == (room.size is None):
            raise ConfigError(f"{where}: expected either a scene or the size of a shoebox")
        if room.name in seen:
            raise ConfigError(f"{where}: line {seen[room.name]} has the name {room.name!r} as well")
        seen[room.name] = number
        rooms.append(room)
    if not rooms:
        raise ConfigError(f"{path}: expected a room per line, as JSON, got none")
    return rooms


def build_rooms(
    path: str | Path, out: str | Path, config: JobConfig | None = None, jobs: int | None = None
) -> Iterator[RoomDone]:
    """Simulate the rooms of a list (see the commands' page) into `out`/NAME.h5, in turn, and tell of each.

    `config`: by default subpaths are added until every pair has an error of 5 %. `jobs`: processes, of one thread
    each; by default one per core. Rooms whose files are there are left alone. Raises `ConfigError` for a bad list,
    and the errors of `simulate` with the name of the room: files of rooms before it are whole.
    """
    rooms, folder = read_rooms(Path(path)), Path(out)
    make_folder(folder, "choose another --out")
    settings = config or JobConfig(simulation=ROOM_CONFIG)
    tasks = (RoomTask(room, folder / f"{room.name}.h5", settings, len(rooms)) for room in rooms)
    return in_processes(_make, tasks, jobs)


def _make(task: RoomTask) -> RoomDone:
    collected = here() is not None
    with profiled("room") as found:
        done = _made(task)
    return done if collected else done._replace(profile=found.stage)


def _made(task: RoomTask) -> RoomDone:
    with room_named(task.line.name):
        with stage("scene"):
            scene = _scene(task.line)
        a = as_points(task.line.sources, "sources")
        b = as_points(task.line.listeners, "listeners")
        key = _key(scene, a, b, task.config)
        if is_valid(task.file, "echogram", key):
            return RoomDone(task.file, len(a) * len(b), False, task.rooms)
        if task.file.exists():
            raise DatasetError(
                f"{task.file} is damaged, or was made of another room or other settings; delete it, or choose "
                "another --out"
            )
        settings, dataset = task.config.simulation, task.config.dataset
        model = model_between(scene, a, b, settings, dataset.seed)
        echoes = with_notes(model, simulate_between(model, a, b))
        attributes = {
            "key": key,
            "scene": scene.name,
            "scene_digest": scene.digest,
            "config": json.dumps(msgspec.to_builtins([None, None, model.config])),
            "code_version": __version__,
            "seed": dataset.seed,
            "speed_of_sound": settings.c,
            "licence": dataset.licence,
            "citation": dataset.citation,
        }
        with stage("encoding"):
            content = encode_echograms(echoes, np.arange(len(a)), len(a) + np.arange(len(b)), attributes)
            publish(task.file, content)
    return RoomDone(task.file, len(a) * len(b), True, task.rooms)


def _scene(line: RoomLine) -> Scene:
    if line.size is None:
        return load_scene(line.scene)
    surfaces: tuple[Any, ...] = line.absorption, line.scattering, line.transmission
    return shoebox(line.size, *surfaces, name=line.name)


def _key(scene: Scene, a: np.ndarray, b: np.ndarray, config: JobConfig) -> str:
    """Of all that decides a room's file."""
    sha = hashlib.sha256(scene.digest.encode())
    dataset = config.dataset
    content = [config.simulation, dataset.seed, dataset.licence, dataset.citation]
    sha.update(json.dumps([msgspec.to_builtins(content), __version__, code_target()]).encode())
    for points in (a, b):
        sha.update(np.ascontiguousarray(points, "<f8").tobytes() + b"|")
    return sha.hexdigest()
