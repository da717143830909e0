"""Many rooms with few pairs each: `simulate_many`."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterator

import numpy as np
import pytest
from soundspaces_rooms.many_rooms import simulate_many

import soundspaces_sim as ss
from tests.marks import CI_SLOW

AUTO = ss.RadianceTransferConfig(subpaths="auto")
CONFIG = ss.SimulationConfig(walks=32, duration=0.15, radiance_transfer=AUTO)
SOURCE, LISTENERS = np.array([[1.0, 1.0, 1.0]]), np.array([[2.0, 2.0, 1.2], [2.5, 1.0, 1.4]])


def room(number: int) -> ss.Scene:
    return ss.shoebox((3.0 + number, 4.0, 2.5), absorption=0.3, scattering=0.4)


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=CI_SLOW)])
def test_each_room_is_as_simulate_gives_it(jobs: int) -> None:
    """In order, for one process and two, whether a room is a scene or a function that makes it."""
    rooms = [room(0), lambda: room(1), room(2)]
    found = list(simulate_many(rooms, [SOURCE] * 3, [LISTENERS] * 3, CONFIG, 7, jobs))
    for number, echoes in enumerate(found):
        expected = ss.simulate(room(number), SOURCE, LISTENERS, CONFIG, 7)
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
            yield room(0)

    stream = simulate_many(
        rooms(), itertools.repeat(SOURCE), itertools.repeat(LISTENERS), CONFIG, jobs=1
    )
    assert len(list(itertools.islice(stream, 2))) == 2 and made == 2


def test_errors_name_theroom() -> None:
    outside = np.array([[50.0, 1.0, 1.0]])
    stream = simulate_many([room(0), room(1)], [SOURCE, outside], [LISTENERS] * 2, CONFIG, jobs=1)
    next(stream)
    with pytest.raises(ss.PointError, match="room 1: sources"):
        next(stream)
    with pytest.raises(ss.PointError, match="room 1: expected sources and listeners"):
        list(simulate_many([room(0)] * 2, [SOURCE], [LISTENERS] * 2, CONFIG, jobs=1))


def test_the_choice_follows_the_number_of_points(caplog: pytest.LogCaptureFixture) -> None:
    """One point has fewer subpaths of its own than patches have; forty have more. It is said."""
    from soundspaces_sim.transport.preparation import make_model

    rng = np.random.default_rng(0)
    points = rng.uniform(0.5, 2.0, (40, 3))
    chosen = []
    with caplog.at_level(logging.INFO, "soundspaces_sim"):
        for count in (1, 40):
            model = make_model(room(0), points[:count], ss.SimulationConfig(
                walks=304, duration=0.15, radiance_transfer=AUTO
            ))  # fmt: skip
            chosen.append(model.config.radiance_transfer.subpaths)
    assert chosen == ["own", "shared"]
    assert "Transfer subpaths: shared (40 points" in caplog.text
