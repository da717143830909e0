"""Many random rooms as files for training: what `soundspaces-sim rooms --count` does.

OUT/rooms.jsonl                  a response per line: where it is, how long, labels with standard errors
OUT/failed.jsonl                 rooms in which nothing that was drawn has room for all, if there are any
OUT/recordings.jsonl.gz, supervisions.jsonl.gz  of WAV files, as Lhotse has them
OUT/rooms-000000.tar, …          or .h5, or audio/000000/…: `room_layouts`
OUT/parts/000000.json            of each shard, when it is whole: what it was made of, its files and lines

Every room is a function of the stream's settings and its number (`RoomStream`), and results come in order, so that
files are the same for any number of processes. A shard that is whole is left alone; more rooms go on after the
others.
"""

from __future__ import annotations

import hashlib
import io
import json
import tarfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from soundspaces_exports.lhotse import packed_lines, recording as recording, supervision as supervision

from soundspaces_rooms.many_rooms import in_processes
from soundspaces_rooms.room_stream import RoomStream
from soundspaces_sim import ConfigError, DatasetError, SceneError, SimulationError, __version__
from soundspaces_sim.parts import (
    code_target,
    create_hdf5,
    make_folder,
    publish_file as publish,
    read_text,
    wav_bytes,
    written_hdf5 as written,
)

Item = dict[str, Any]


class Place(NamedTuple):
    """Where a response is; `member`: its name within the file, None if the file is the response."""

    path: str
    member: str | None = None


class Files(NamedTuple):
    """`content` by name below the folder; `places` of the responses of each item, by source."""

    content: dict[str, bytes]
    places: list[list[Place]]


Layout = Callable[[int, Sequence[Item], int], Files]


def room_id(number: int) -> str:
    """The name of a room in files and manifests."""
    return f"room-{number:08d}"


def webdataset(shard: int, items: Sequence[Item], rate: int) -> Files:
    """A tar file; of each room `<id>.<source>.wav` of all microphones, and `<id>.json` with its labels."""
    name, places, data = f"rooms-{shard:06d}.tar", [], io.BytesIO()
    with tarfile.open(fileobj=data, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for item in items:
            key = room_id(item["room"])
            members = {f"{key}.{s}.wav": wav_bytes(rir, rate) for s, rir in enumerate(item["rir"])}
            places.append([Place(name, member) for member in members])
            members[f"{key}.json"] = json.dumps(labels(item), allow_nan=False).encode()
            for member, content in members.items():
                info = tarfile.TarInfo(member)
                info.size, info.mode = len(content), 0o644
                tar.addfile(info, io.BytesIO(content))
    return Files({name: data.getvalue()}, places)


def hdf5(shard: int, items: Sequence[Item], rate: int) -> Files:
    """An HDF5 file; of each room a dataset `<id>` (sources, microphones, samples) with its `labels` as JSON."""
    name, places, data = f"rooms-{shard:06d}.h5", [], io.BytesIO()
    with create_hdf5(data) as file:
        file.attrs["rate"] = rate
        for item in items:
            key = room_id(item["room"])
            stored = file.create_dataset(key, data=np.asarray(item["rir"], "<f4"))
            stored.attrs["labels"] = json.dumps(labels(item), allow_nan=False)
            places.append([Place(name, f"{key}/{s}") for s in range(len(item["rir"]))])
    return Files({name: written(data, name)}, places)


def wav(shard: int, items: Sequence[Item], rate: int) -> Files:
    """A file for each source, `audio/<shard>/<id>-<source>.wav`, of all microphones."""
    content: dict[str, bytes] = {}
    places: list[list[Place]] = []
    for item in items:
        own = [
            Place(f"audio/{shard:06d}/{room_id(item['room'])}-{s}.wav") for s in range(len(item["rir"]))
        ]
        content |= {
            place.path: wav_bytes(rir, rate) for place, rir in zip(own, item["rir"], strict=True)
        }
        places.append(own)
    return Files(content, places)


LAYOUTS: Mapping[str, Layout] = {"webdataset": webdataset, "hdf5": hdf5, "wav": wav}

_SIGNALS = ("rir", "early", "direct")


def labels(item: Item) -> dict[str, Any]:
    """All of an item but its signals, as JSON has it: lists, and None for what is not known."""
    return {name: _plain(value) for name, value in item.items() if name not in _SIGNALS}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [_plain(x) for x in value.tolist()]
    if isinstance(value, list):
        return [_plain(x) for x in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


PER_FILE = 100  # rooms
_MOST = 2**30  # bytes of a part
_Line = dict[str, Any]


class Progress(NamedTuple):
    """After each room: rooms that are finished or failed, of so many; those that were there, and that failed."""

    done: int
    rooms: int
    there: int
    failed: int


class _Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    key: str
    rooms: int
    files: dict[str, tuple[int, str]]  # bytes and SHA-256
    lines: list[_Line]
    failed: list[_Line]


@dataclass(frozen=True)
class _Set:
    """A stream of `rooms` rooms on its way to a folder."""

    stream: RoomStream
    out: Path
    layout: str
    per_file: int
    rooms: int
    key: str

    def shards(self) -> list[range]:
        return [
            range(k, min(k + self.per_file, self.rooms)) for k in range(0, self.rooms, self.per_file)
        ]

    def part(self, shard: int) -> Path:
        return self.out / "parts" / f"{shard:06d}.json"


class _Task(NamedTuple):
    stream: RoomStream
    number: int


def build_random_rooms(
    stream: RoomStream,
    out: str | Path,
    layout: str = "webdataset",
    jobs: int | None = None,
    per_file: int = PER_FILE,
) -> Iterator[Progress]:
    """Write the rooms of a stream that has a `count` and no speech, and tell of each.

    `layout`: of `room_layouts.LAYOUTS`. `jobs`: processes, of one thread each; by default one per core. The early
    and direct parts are not stored: they are what comes up to 50 and 2.5 ms after ``arrival_s``. Raises
    `ConfigError`, and `DatasetError` where `out` was made with other settings.
    """
    of = _set(stream, Path(out), layout, per_file)
    make_folder(of.out / "parts", "choose another --out")
    found = [_whole(of, k, len(numbers)) for k, numbers in enumerate(of.shards())]
    return _built(of, found, jobs)


def _set(stream: RoomStream, out: Path, layout: str, per_file: int) -> _Set:
    if layout not in LAYOUTS:
        raise ConfigError(f"layout: expected {' or '.join(LAYOUTS)}, got {layout!r}")
    if stream.count is None or stream.count < 1:
        raise ConfigError(f"count: expected 1 or more rooms, got {stream.count}")
    if not 1 <= per_file <= 100_000:
        raise ConfigError(f"per_file: expected 1 to 100000 rooms, got {per_file}")
    if stream.speech is not None or stream.shard != (0, 1):
        raise ConfigError("stream: expected one without speech, and not a share of one")
    settings = [
        msgspec.to_builtins(stream.config),
        *(stream.seed, stream.epoch, stream.rate, stream.low_equalisation_db),
        *(stream.kinds, stream.sources, stream.microphones, layout, per_file),
        *(__version__, code_target()),
    ]
    key = hashlib.sha256(json.dumps(settings).encode()).hexdigest()
    return _Set(stream, out, layout, per_file, stream.count, key)


def _whole(of: _Set, shard: int, rooms: int) -> _Part | None:
    """What is there of a shard, if it is whole. Raises `DatasetError` if it was made of something else."""
    path = of.part(shard)
    if not path.exists():
        return None
    try:
        part = msgspec.json.decode(read_text(path, DatasetError, "record of a shard", _MOST), type=_Part)
    except msgspec.MsgspecError as error:
        raise DatasetError(f"{path}: {error}; delete it, and run the same command again") from error
    if part.key != of.key:
        raise DatasetError(
            f"{of.out} holds rooms of other settings or another version; choose another --out"
        )
    sizes = ((of.out / name, size) for name, (size, _) in part.files.items())
    intact = all(path.is_file() and path.stat().st_size == size for path, size in sizes)
    return part if intact and part.rooms == rooms else None


def _built(of: _Set, found: list[_Part | None], jobs: int | None) -> Iterator[Progress]:
    shards = of.shards()
    there = sum(len(n) for n, part in zip(shards, found, strict=True) if part is not None)
    failed = sum(len(part.failed) for part in found if part is not None)
    done = there
    missing = [k for k, part in enumerate(found) if part is None]
    tasks = (_Task(of.stream, number) for k in missing for number in shards[k])
    results = in_processes(_make, tasks, jobs)
    for k in missing:
        items: list[Item] = []
        errors: list[_Line] = []
        for number in shards[k]:
            result = next(results)
            if isinstance(result, str):
                errors.append({"id": room_id(number), "error": result})
            else:
                items.append(result)
            done, failed = done + 1, failed + isinstance(result, str)
            if number != shards[k][-1]:
                yield Progress(done, of.rooms, there, failed)
        found[k] = _write(of, k, items, errors)
        yield Progress(done, of.rooms, there, failed)
    next(results, None)  # lets the processes end
    _finish(of, [part for part in found if part is not None])
    if not missing:
        yield Progress(done, of.rooms, there, failed)


def _make(task: _Task) -> Item | str:
    """An item without the parts that follow from it, or why there is none."""
    try:
        item = task.stream.item(task.number)
    except (SimulationError, SceneError) as error:
        return str(error)
    return {name: value for name, value in item.items() if name not in ("direct", "early")}


def _write(of: _Set, shard: int, items: list[Item], errors: list[_Line]) -> _Part:
    files = LAYOUTS[of.layout](shard, items, of.stream.rate)
    for name, content in files.content.items():
        make_folder((of.out / name).parent)
        publish(of.out / name, content)
    part = _Part(
        key=of.key,
        rooms=len(items) + len(errors),
        files={n: (len(c), hashlib.sha256(c).hexdigest()) for n, c in files.content.items()},
        lines=_lines(of, items, files),
        failed=errors,
    )
    publish(of.part(shard), msgspec.json.encode(part))
    return part


def _lines(of: _Set, items: list[Item], files: Files) -> list[_Line]:
    """A line of the manifest for each response."""
    per_source = ("heading_deg", "arrival_s", "t30", "c50", "drr", "t30_error", "c50_error", "drr_error")
    bands = {"bands_hz": list(of.stream.config.bands)}
    out = []
    for item, places in zip(items, files.places, strict=True):
        known, (_, channels, samples) = labels(item), np.shape(item["rir"])
        shared = {name: known[name] for name in ("room", "kind", "array", "microphones")}
        for s, place in enumerate(places):
            where = {"path": place.path} | ({} if place.member is None else {"member": place.member})
            length = {
                "sampling_rate": of.stream.rate,
                "num_samples": samples,
                "duration": samples / of.stream.rate,
                "channels": channels,
            }
            own = {"source": known["sources"][s], **{name: known[name][s] for name in per_source}}
            out.append(
                {"id": f"{room_id(item['room'])}-{s}", **where, **length, **shared, **own, **bands}
            )
    return out


def _finish(of: _Set, parts: list[_Part]) -> None:
    """The manifests of the whole."""
    rows = [line for part in parts for line in part.lines]
    failed = [line for part in parts for line in part.failed]
    publish(of.out / "rooms.jsonl", b"".join(msgspec.json.encode(row) + b"\n" for row in rows))
    if failed:
        publish(of.out / "failed.jsonl", b"".join(msgspec.json.encode(row) + b"\n" for row in failed))
    if of.layout == "wav":
        records, supervisions = [], []
        for row in rows:
            shape = row["channels"], row["num_samples"]
            records.append(recording(row["id"], row["path"], shape, of.stream.rate))
            supervisions.append(supervision(row["id"], shape, of.stream.rate, row))
        publish(of.out / "recordings.jsonl.gz", packed_lines(records))
        publish(of.out / "supervisions.jsonl.gz", packed_lines(supervisions))
