"""Many rooms with few pairs each: `simulate_many` and `soundspaces-sim rooms`."""

from __future__ import annotations

import itertools
import json
import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.build.room_files import read_rooms
from soundspaces_sim.build.rooms import simulate_many
from soundspaces_sim.cli.app import app
from tests.marks import CI_SLOW

AUTO = ss.RadianceTransferConfig(subpaths="auto")
CONFIG = ss.SimulationConfig(walks=32, duration=0.15, radiance_transfer=AUTO)
SOURCE, LISTENERS = np.array([[1.0, 1.0, 1.0]]), np.array([[2.0, 2.0, 1.2], [2.5, 1.0, 1.4]])


def _room(number: int) -> ss.Scene:
    return ss.shoebox((3.0 + number, 4.0, 2.5), absorption=0.3, scattering=0.4)


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=CI_SLOW)])
def test_each_room_is_as_simulate_gives_it(jobs: int) -> None:
    """In order, for one process and two, whether a room is a scene or a function that makes it."""
    rooms = [_room(0), lambda: _room(1), _room(2)]
    found = list(simulate_many(rooms, [SOURCE] * 3, [LISTENERS] * 3, CONFIG, 7, jobs))
    for number, echoes in enumerate(found):
        expected = ss.simulate(_room(number), SOURCE, LISTENERS, CONFIG, 7)
        np.testing.assert_array_equal(echoes.energy, expected.energy)
        np.testing.assert_array_equal(echoes.relative_error, expected.relative_error)
    assert len(found) == 3


def test_rooms_may_be_endless() -> None:
    """Only as many as are asked for are made."""
    made = 0

    def rooms() -> Iterator[ss.Scene]:
        nonlocal made
        while True:
            made += 1
            yield _room(0)

    stream = simulate_many(
        rooms(), itertools.repeat(SOURCE), itertools.repeat(LISTENERS), CONFIG, jobs=1
    )
    assert len(list(itertools.islice(stream, 2))) == 2 and made == 2


def test_errors_name_the_room() -> None:
    outside = np.array([[50.0, 1.0, 1.0]])
    stream = simulate_many([_room(0), _room(1)], [SOURCE, outside], [LISTENERS] * 2, CONFIG, jobs=1)
    next(stream)
    with pytest.raises(ss.PointError, match="room 1: sources"):
        next(stream)
    with pytest.raises(ss.PointError, match="room 1: expected sources and listeners"):
        list(simulate_many([_room(0)] * 2, [SOURCE], [LISTENERS] * 2, CONFIG, jobs=1))


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
    expected = ss.simulate(_room(2), SOURCE, LISTENERS, CONFIG)
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


def test_the_choice_follows_the_number_of_points(caplog: pytest.LogCaptureFixture) -> None:
    """One point has fewer subpaths of its own than patches have; forty have more. It is said."""
    from soundspaces_sim.transport.preparation import make_model

    rng = np.random.default_rng(0)
    points = rng.uniform(0.5, 2.0, (40, 3))
    chosen = []
    with caplog.at_level(logging.INFO, "soundspaces_sim"):
        for count in (1, 40):
            model = make_model(_room(0), points[:count], ss.SimulationConfig(
                walks=304, duration=0.15, radiance_transfer=AUTO
            ))  # fmt: skip
            chosen.append(model.config.radiance_transfer.subpaths)
    assert chosen == ["own", "shared"]
    assert "Transfer subpaths: shared (40 points" in caplog.text
