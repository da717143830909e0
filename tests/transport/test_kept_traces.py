"""What subpaths leave is kept for the tiles to come: every point is traced once, and no bit depends on it."""

from __future__ import annotations

import errno
import itertools
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build.job_file import open_job
from soundspaces_sim.build.prepare import open_dataset_job
from soundspaces_sim.build.tile import build_tiles
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.transport import integrator
from soundspaces_sim.transport.kept_traces import MEMORY, KeptTraces
from soundspaces_sim.transport.memory import SUBPATHS_ALONE
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import simulate_pairs
from soundspaces_sim.transport.tile import Walks
from tests.marks import CI_SLOW, ci_slow

SIZE = (6.0, 5.0, 2.7)
CONFIG = ss.SimulationConfig(walks=16, duration=0.2)
POINTS = np.random.default_rng(0).uniform(0.5, np.array(SIZE) - 0.5, (7, 3))
BLOCKS = (POINTS[:3], POINTS[3:5], POINTS[5:])
TILES = tuple(itertools.combinations_with_replacement(range(3), 2))


@pytest.fixture(scope="module")
def model() -> Model:
    return make_model(ss.shoebox(SIZE, absorption=0.3, scattering=0.4), POINTS, CONFIG)


@pytest.fixture
def traced(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many points are traced, call by call."""
    calls: list[int] = []
    trace = integrator._trace_side

    def counted(techniques: Any, wanted: Any, own: Any, other: Any, add: Any) -> Walks:
        calls.append(len(own.ends.points))
        return trace(techniques, wanted, own, other, add)

    monkeypatch.setattr(integrator, "_trace_side", counted)
    return calls


def _tile(i: int, j: int) -> tuple[np.ndarray, np.ndarray | None]:
    return BLOCKS[i], None if i == j else BLOCKS[j]


def _all(model: Model, order: Any, kept: KeptTraces | None) -> dict[tuple[int, int], list[Any]]:
    found = {}
    for n, (i, j) in enumerate(order):
        if kept is not None:
            kept.expect([_tile(*tile) for tile in order[n:]])
        found[i, j] = [e for e in simulate_pairs(model, *_tile(i, j), kept=kept) if e is not None]
    return found


@pytest.fixture(scope="module")
def alone(model: Model) -> dict[tuple[int, int], list[Any]]:
    """Every tile with nothing kept."""
    return _all(model, TILES, None)


def _are_the_same(
    found: dict[tuple[int, int], list[Any]], alone: dict[tuple[int, int], list[Any]]
) -> None:
    for tile, echoes in alone.items():
        for expected, got in zip(echoes, found[tile], strict=True):
            np.testing.assert_array_equal(got.energy, expected.energy)
            np.testing.assert_array_equal(got.relative_error, expected.relative_error)
            np.testing.assert_array_equal(got.measure_error, expected.measure_error)
            np.testing.assert_array_equal(got.early.energy, expected.early.energy)


@pytest.mark.parametrize(
    ("memory", "on_disk", "points"),
    [(MEMORY, False, 7), (0.0, True, 7), (2e6, True, 7), (0.0, False, 3 * 7)],
    ids=["memory", "disk", "both", "nowhere"],
)
@pytest.mark.parametrize(
    "order", [TILES, pytest.param(TILES[::-1], marks=CI_SLOW)], ids=["forth", "back"]
)
def test_every_point_is_traced_once_and_bits_stay(
    model: Model,
    alone: dict[tuple[int, int], list[Any]],
    traced: list[int],
    tmp_path: Path,
    order: Any,
    memory: float,
    on_disk: bool,
    points: int,
) -> None:
    kept = KeptTraces(model, tmp_path if on_disk else None, memory)
    found = _all(model, order, kept)
    assert sum(traced) == points
    assert not list(tmp_path.iterdir()) and not kept._parts
    _are_the_same(found, alone)


@pytest.mark.parametrize(("points", "least", "most"), [(0, 21, 21), (3, 8, 20), (1000, 7, 7)])
def test_sides_and_walks_are_kept_within_a_limit(
    model: Model,
    alone: dict[tuple[int, int], list[Any]],
    traced: list[int],
    points: int,
    least: int,
    most: int,
) -> None:
    """With room for nothing every point is traced for each tile that it is in, with room for all once; with room
    for one block, something in between."""
    kept = KeptTraces(model, walks=points * SUBPATHS_ALONE)
    _are_the_same(_all(model, TILES, kept), alone)
    assert least <= sum(traced) <= most
    assert sum(len(side.given) for side in kept._sides.values()) <= max(points, 3 + 2)


def test_a_disk_that_has_less_room_than_it_said(
    model: Model,
    alone: dict[tuple[int, int], list[Any]],
    traced: list[int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Room is asked for before a file is mapped; without, points are traced again."""

    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    caplog.set_level("INFO", "soundspaces_sim")
    _are_the_same(_all(model, TILES, KeptTraces(model, tmp_path, 0.0)), alone)
    assert sum(traced) == 3 * 7 and not list(tmp_path.iterdir())
    assert os.strerror(errno.ENOSPC) in caplog.text and "traced again" in caplog.text


@ci_slow  # tests/build/test_square.py compares such bytes too
def test_a_job_keeps_and_a_tile_alone_does_not(tmp_path: Path, traced: list[int]) -> None:
    """The shards of a job have the bytes of tiles that are made from folder and number, one by one."""
    scene = ss.shoebox(SIZE, absorption=0.3, scattering=0.4, name="room")
    config = ss.JobConfig(simulation=CONFIG, dataset=DatasetConfig(tile=3))
    result = ss.build_dataset(
        scene, tmp_path / "job", config, points=POINTS, options={"processes": 1}, jobs=1
    )
    assert sum(traced) == 7
    alone = tmp_path / "alone" / "room"
    prepared = open_dataset_job(scene, alone, config, POINTS)
    for number in range(len(prepared.plan.tiles)):
        build_tiles(open_job(alone), [number])
    shards = sorted(result.folder.glob("*.h5"))
    assert len(shards) == 9
    for shard in shards:
        assert shard.read_bytes() == (alone / shard.name).read_bytes()
