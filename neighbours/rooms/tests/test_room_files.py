"""`soundspaces-sim rooms LIST`: files of rooms."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from soundspaces_rooms.room_files import RoomLine, read_rooms
from typer.testing import CliRunner

import soundspaces_sim as ss
from neighbours.rooms.tests.test_simulate_many import CONFIG, LISTENERS, SOURCE, room
from soundspaces_sim.cli.app import app
from tests.test_readme import blocks_of


def _list(folder: Path, *rooms: dict[str, object]) -> Path:
    path = folder / "rooms.jsonl"
    path.write_text("\n".join(json.dumps(room) for room in rooms))
    return path


def _line(name: str, **more: object) -> dict[str, object]:
    room = {"size": [4.0, 4.0, 2.5], "absorption": 0.3, "scattering": 0.4}
    return {
        "name": name, "sources": SOURCE.tolist(), "listeners": LISTENERS.tolist(), **room, **more
    }  # fmt: skip


def test_files_of_rooms(tmp_path: Path) -> None:
    """What is read back is what `simulate` gives, to a step of 0.4 dB; a second run makes nothing; the file says
    which estimator was chosen."""
    settings = tmp_path / "rooms.toml"
    settings.write_text(
        "[simulation]\nwalks = 32\nduration = 0.15\n[simulation.radiance_transfer]\nsubpaths = 'auto'\n"
    )
    listed, out = (
        _list(tmp_path, _line("first"), _line("second", size=[5.0, 4.0, 2.5])),
        tmp_path / "out",
    )
    command = ["rooms", str(listed), "--out", str(out), "--config", str(settings), "--jobs", "1"]
    result = CliRunner().invoke(app, command)
    assert (
        result.exit_code == 0 and "Wrote 2 rooms" in result.stdout and "4 room impulse" in result.stdout
    )
    found = ss.read_room(out / "second.h5")
    expected = ss.simulate(room(2), SOURCE, LISTENERS, CONFIG)
    for listener in range(2):
        stored, made = found[0][listener], expected[0, listener]
        np.testing.assert_allclose(stored.histogram().sum(), made.histogram().sum(), rtol=0.05)
        np.testing.assert_allclose(stored.arrivals[0].delay, made.arrivals[0].delay, rtol=1e-6)
    import h5py

    with h5py.File(out / "first.h5") as file:
        chosen = json.loads(file.attrs["config"])[2]
    assert chosen["radiance_transfer"]["subpaths"] == "own"
    bytes_before = (out / "first.h5").read_bytes()
    again = CliRunner().invoke(app, command)
    assert "Wrote 0 rooms" in again.stdout and "2 were there" in again.stdout
    (out / "first.h5").unlink()
    CliRunner().invoke(app, command)
    assert (out / "first.h5").read_bytes() == bytes_before


@pytest.mark.parametrize(
    ("room", "message"),
    [
        (_line("../x"), "line 1"),
        (_line("a", scene="demo"), "either a scene or the size"),
        (_line("a", sources=[[1.0, 2.0]]), "line 1"),
        (_line("a", colour="red"), "colour"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, room: dict[str, object], message: str) -> None:
    with pytest.raises(ss.ConfigError, match=message):
        read_rooms(_list(tmp_path, room))


def test_names_are_unique_and_some_are_there(tmp_path: Path) -> None:
    with pytest.raises(ss.ConfigError, match="line 2: line 1 has the name 'a'"):
        read_rooms(_list(tmp_path, _line("a"), _line("a")))
    with pytest.raises(ss.ConfigError, match="got none"):
        read_rooms(_list(tmp_path))


@pytest.mark.parametrize("end", ["\n", "\r", "\x00"])
def test_names_do_not_end_in_a_line(end: str) -> None:
    line = {"name": f"a{end}", "sources": [], "listeners": []}
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(line, RoomLine)


def test_the_list_of_the_page_is_simulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (text,) = blocks_of(Path(__file__).parents[1] / "README.md", "text")
    Path("list.jsonl").write_text(text, "utf-8")
    done = CliRunner().invoke(app, ["rooms", "list.jsonl", "--out", "rooms", "--jobs", "1"])
    assert done.exit_code == 0, (done.output, done.exception)
    assert len(ss.read_room("rooms/r1.h5")) == 1 and Path("rooms/r2.h5").is_file()


def test_the_command_prints_where_time_went(tmp_path: Path) -> None:
    listed = _list(tmp_path, _line("a", listeners=LISTENERS[:1].tolist()))
    command = ["rooms", str(listed), "--out", str(tmp_path / "out"), "--walks", "16", "--jobs", "1"]
    said = CliRunner().invoke(app, [*command, "--profile"]).output
    assert "specular" in said and "\n1 pairs; each " in said, said
    assert "specular" not in CliRunner().invoke(app, command).output
