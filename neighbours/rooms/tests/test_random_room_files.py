"""`rooms --count`: random rooms as shards, the same for any number of processes, resumable."""

from __future__ import annotations

import gzip
import io
import json
import tarfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io.wavfile
from soundspaces_rooms import RoomStream
from soundspaces_rooms.random_room_files import build_random_rooms, hdf5
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.cli.app import app
from tests.core.test_hdf5 import WrongChecksum
from tests.marks import ci_slow

CONFIG = ss.SimulationConfig(
    walks=32, duration=0.15, radiance_transfer=ss.RadianceTransferConfig(subpaths="auto")
)
ROOMS = 4


def _stream(**more: Any) -> RoomStream:
    given = {
        "seed": 3, "count": ROOMS, "rate": 8000, "config": CONFIG, "kinds": ("shoebox",), "sources": (1, 2),
        "microphones": (2, 3),
    }  # fmt: skip
    return RoomStream(**{**given, **more})


def _files(out: Path) -> dict[str, bytes]:
    return {str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}


def _lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


@pytest.fixture(scope="module")
def items() -> list[dict[str, Any]]:
    return list(_stream())


@pytest.fixture(scope="module")
def tars(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("tars")
    told = list(build_random_rooms(_stream(), out, jobs=1, per_file=3))
    assert [p.done for p in told] == [1, 2, 3, 4] and told[-1].rooms == 4
    assert told[-1].there == told[-1].failed == 0
    return out


def test_a_shard_has_the_responses_and_labels_of_the_stream(
    tars: Path, items: list[dict[str, Any]]
) -> None:
    assert {p.name for p in tars.glob("*.tar")} == {"rooms-000000.tar", "rooms-000001.tar"}
    lines = _lines(tars / "rooms.jsonl")
    assert len(lines) == sum(len(item["rir"]) for item in items)
    rows = iter(lines)
    for item in items:
        for s, rir in enumerate(item["rir"]):
            line = next(rows)
            assert line["id"] == f"room-{item['room']:08d}-{s}"
            with tarfile.open(tars / line["path"]) as tar:
                stored = tar.extractfile(line["member"])
                assert stored is not None
                rate, signal = scipy.io.wavfile.read(io.BytesIO(stored.read()))
                extra = tar.extractfile(f"room-{item['room']:08d}.json")
                assert extra is not None and json.load(extra)["sources"] == item["sources"].tolist()
            assert rate == line["sampling_rate"] == 8000 and signal.dtype == np.float32
            np.testing.assert_array_equal(signal.T, rir)
            assert (line["channels"], line["num_samples"]) == rir.shape
            assert line["duration"] == rir.shape[1] / 8000
            np.testing.assert_allclose(line["arrival_s"], item["arrival_s"][s])
            for name in ("c50", "c50_error", "t30", "t30_error"):
                known = [np.nan if v is None else v for v in line[name]]
                np.testing.assert_array_equal(known, item[name][s])
            assert len(line["bands_hz"]) == len(line["t30"]) + 1


@ci_slow
def test_files_are_the_same_for_any_number_of_processes(tars: Path, tmp_path: Path) -> None:
    list(build_random_rooms(_stream(), tmp_path, jobs=2, per_file=3))
    assert _files(tmp_path) == _files(tars)


def test_what_is_whole_stays_and_more_rooms_go_on(
    tars: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two rooms first, then four in shards of three: the first shard is made anew as it has more, then a lost file
    is; what is whole is not simulated again."""
    list(build_random_rooms(_stream(count=2), tmp_path, jobs=1, per_file=3))
    list(build_random_rooms(_stream(), tmp_path, jobs=1, per_file=3))
    assert _files(tmp_path) == _files(tars)
    (tmp_path / "rooms-000001.tar").unlink()
    made, item = [], RoomStream.item

    def noted(stream: RoomStream, number: int) -> dict[str, Any]:
        made.append(number)
        return item(stream, number)

    monkeypatch.setattr(RoomStream, "item", noted)
    told = list(build_random_rooms(_stream(), tmp_path, jobs=1, per_file=3))
    assert made == [3] and told[-1].there == 3
    assert _files(tmp_path) == _files(tars)
    told = list(build_random_rooms(_stream(), tmp_path, jobs=1, per_file=3))
    assert made == [3] and told == [(4, 4, 4, 0)]
    with pytest.raises(ss.DatasetError, match="other settings"):
        build_random_rooms(_stream(seed=4), tmp_path, jobs=1, per_file=3)
    (tmp_path / "parts" / "000000.json").write_text("{}")
    with pytest.raises(ss.DatasetError, match="delete it, and run the same command again"):
        build_random_rooms(_stream(), tmp_path, jobs=1, per_file=3)


def test_other_layouts_hold_the_same(tmp_path: Path, items: list[dict[str, Any]]) -> None:
    few = _stream(count=2)
    list(build_random_rooms(few, tmp_path / "h", "hdf5", jobs=1))
    line = _lines(tmp_path / "h" / "rooms.jsonl")[0]
    with h5py.File(tmp_path / "h" / line["path"]) as file:
        room, source = line["member"].split("/")
        np.testing.assert_array_equal(file[room][int(source)], items[0]["rir"][0])
        assert json.loads(file[room].attrs["labels"])["kind"] == "shoebox" and file.attrs["rate"] == 8000
    list(build_random_rooms(few, tmp_path / "w", "wav", jobs=1))
    line = _lines(tmp_path / "w" / "rooms.jsonl")[0]
    _, signal = scipy.io.wavfile.read(tmp_path / "w" / line["path"])
    np.testing.assert_array_equal(signal.T, items[0]["rir"][0])
    with gzip.open(tmp_path / "w" / "recordings.jsonl.gz", "rt") as packed:
        record = json.loads(packed.readline())
    assert record["sources"][0]["source"] == line["path"] and line["path"].startswith("audio/")
    assert record["num_samples"] == line["num_samples"]
    with gzip.open(tmp_path / "w" / "supervisions.jsonl.gz", "rt") as packed:
        assert json.loads(packed.readline())["custom"]["c50"] == line["c50"]


def test_a_room_that_fails_stops_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    item = RoomStream.item

    def second_fails(stream: RoomStream, number: int) -> dict[str, Any]:
        if number == 1:
            raise ss.SimulationError("room 1: no room for 3 places")
        return item(stream, number)

    monkeypatch.setattr(RoomStream, "item", second_fails)
    told = list(build_random_rooms(_stream(count=2), tmp_path, jobs=1))
    assert told[-1] == (2, 2, 0, 1)
    assert {line["room"] for line in _lines(tmp_path / "rooms.jsonl")} == {0}
    assert _lines(tmp_path / "failed.jsonl") == [
        {"id": "room-00000001", "error": "room 1: no room for 3 places"}
    ]


@pytest.mark.parametrize(
    ("stream", "given", "message"),
    [
        ({}, {"layout": "zip"}, "layout: expected webdataset or hdf5 or wav, got 'zip'"),
        ({"count": None}, {}, "count: expected 1 or more rooms, got None"),
        ({"count": 0}, {}, "count: expected 1 or more"),
        ({}, {"per_file": 0}, "per_file: expected 1 to"),
        ({"shard": (0, 2)}, {}, "not a share"),
        ({"speech": [np.ones(9)]}, {}, "without speech"),
    ],
)
def test_what_cannot_be_is_refused(
    tmp_path: Path, stream: dict[str, Any], given: dict[str, Any], message: str
) -> None:
    with pytest.raises(ss.ConfigError, match=message):
        build_random_rooms(_stream(**stream), tmp_path, **given)


def test_the_command(tmp_path: Path) -> None:
    settings = tmp_path / "rooms.toml"
    settings.write_text("[simulation]\nwalks = 32\nduration = 0.15\n")
    command = [
        "rooms", "--count", "1", "--out", str(tmp_path / "out"), "--format", "wav", "--rate", "8000", "--sources", "1",
        "1", "--microphones", "2", "2", "--kind", "polygon", "--config", str(settings), "--jobs", "1",
        "--low-equalisation", "5",
    ]  # fmt: skip
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0 and "Wrote 1 rooms" in result.stdout, result.output
    (line,) = _lines(tmp_path / "out" / "rooms.jsonl")
    assert line["channels"] == 2 and line["kind"] == "polygon"
    for wrong in (["rooms"], ["rooms", "list.jsonl", "--count", "2"]):
        result = CliRunner().invoke(app, wrong)
        assert result.exit_code != 0 and "either LIST or --count" in result.output


def test_a_file_that_cannot_be_opened_is_not_published(monkeypatch: pytest.MonkeyPatch) -> None:
    items = [{"room": 0, "rir": np.ones((1, 2, 8))}]
    assert hdf5(0, items, 16000).content
    monkeypatch.setattr(io, "BytesIO", WrongChecksum)
    with pytest.raises(ss.DatasetError, match="checksum"):
        hdf5(0, items, 16000)
