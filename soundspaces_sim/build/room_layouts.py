"""Layouts of the files of random rooms: what `rooms --count` writes.

A layout is a function of a shard's number, its items (`RoomStream`) and their rate. It gives the files, bytes by
name, and where the responses of every item are: per source, the file and, in files of many, the member. A new one
is a function here and a line below.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.io.hdf5 import create_hdf5, written
from soundspaces_sim.dataset.exporters.wav import wav_bytes

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
