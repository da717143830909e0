"""Tiles that are simulated as one: which those are, and that no byte depends on it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build import estimate, tile as tiles_of
from soundspaces_sim.build.job_file import open_job
from soundspaces_sim.build.plan import JobPlan
from soundspaces_sim.build.prepare import open_dataset_job
from soundspaces_sim.build.square import squares
from soundspaces_sim.build.tile import build_tiles
from soundspaces_sim.build.worker import work_here
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.dataset.format.manifest import Manifest
from soundspaces_sim.transport.simulate import simulate_pairs
from tests.marks import few

SIZE = (6.0, 5.0, 2.7)
POINTS = np.random.default_rng(0).uniform(0.5, np.array(SIZE) - 0.5, (8, 3))


def _config(tile: int | None = None, **simulation: object) -> ss.JobConfig:
    settings = ss.SimulationConfig(walks=16, duration=0.2, **simulation)  # type: ignore[arg-type]
    return ss.JobConfig(simulation=settings, dataset=DatasetConfig(tile=tile))


@pytest.fixture(scope="module")
def scene() -> ss.Scene:
    return ss.shoebox(SIZE, absorption=0.3, scattering=0.4, name="room")


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """How many points each simulation has on either side; 0: as on the first."""
    calls: list[tuple[int, int]] = []

    def noted(model, a, b, **options):  # type: ignore[no-untyped-def]
        calls.append((len(a), 0 if b is None else len(b)))
        return simulate_pairs(model, a, b, **options)

    monkeypatch.setattr(tiles_of, "simulate_pairs", noted)
    return calls


@pytest.fixture(scope="module")
def draft(scene: ss.Scene, tmp_path_factory: pytest.TempPathFactory) -> Manifest:
    """Of a job of all points."""
    return open_dataset_job(scene, tmp_path_factory.mktemp("out") / "room", _config(), POINTS).plan.draft


def test_squares_cover_every_tile_once(draft: Manifest) -> None:
    for block in (1, 2, 3, 8):
        plan = JobPlan(draft, block)
        random = np.random.default_rng(block)
        for side in range(1, 10):
            for share in (1.0, 0.5):
                every = np.flatnonzero(random.random(len(plan.tiles)) < share + 1e-9)
                numbers = random.permutation(every).tolist()
                found = squares(plan, numbers, side)
                assert sorted(n for s in found for n in s.numbers) == sorted(numbers)
                for square in found:
                    _check(plan, square, max(side, block))


def _check(plan: JobPlan, square, side: int) -> None:  # type: ignore[no-untyped-def]
    a, b = square.points(POINTS)
    assert len(a) <= side and (b is None or len(b) <= side)
    assert square.cost == len(a) + (0 if b is None else len(b))
    wanted = sum(plan.tiles[n].pairs for n in square.numbers)
    assert wanted <= square.pairs <= wanted / 0.75
    assert b is None or not {*map(tuple, a)} & {*map(tuple, b)}
    for n in square.numbers:
        assert plan.tiles[n].a in square.rows
        assert plan.tiles[n].b in (square.rows if b is None else square.columns)


def test_all_fit_or_what_the_user_said(draft: Manifest) -> None:
    plan = JobPlan(draft, 2)
    numbers = [*range(len(plan.tiles))]
    assert [s.numbers for s in squares(plan, numbers, 8)] == [tuple(numbers)]
    odd = JobPlan(draft, 3)  # in blocks of 3, 3 and 2
    assert [s.numbers for s in squares(odd, [*range(6)], 8)] == [tuple(range(6))]
    assert len(squares(odd, [*range(6)], 7)) == 3
    assert [len(s.numbers) for s in squares(plan, numbers, 4)] == [3, 4, 3]
    assert len(squares(plan, numbers, 3)) == len(numbers)
    told = msgspec.structs.replace(draft, config=_config(tile=2))
    assert len(squares(JobPlan(told, 2), numbers, 8)) == len(numbers)


@pytest.mark.parametrize("materials", few([False, True], False), ids=["plain", "counts"])
def test_bytes_are_those_of_tiles_made_alone(
    scene: ss.Scene, tmp_path: Path, simulated: list[tuple[int, int]], materials: bool
) -> None:
    job = _config(materials=ss.MaterialsConfig(enabled=materials))
    made = ss.build_dataset(
        scene, tmp_path / "job", job, points=POINTS, options={"processes": 1}, jobs=1
    )
    assert simulated == [(8, 0)]
    alone = tmp_path / "alone" / "room"
    prepared = open_dataset_job(scene, alone, job, POINTS)
    for number in range(len(prepared.plan.tiles)):
        build_tiles(open_job(alone), [number])
    assert simulated[1:] == [(4, 0), (4, 4), (4, 0)]
    shards = sorted(made.folder.glob("*.h5"))
    assert len(shards) == 4
    for shard in shards:
        assert shard.read_bytes() == (alone / shard.name).read_bytes()


def test_squares_of_several_sides_keep_what_was_traced(
    scene: ss.Scene, tmp_path: Path, simulated: list[tuple[int, int]]
) -> None:
    """Where memory is short, squares follow each other, and what is there already is left alone."""
    prepared = open_dataset_job(scene, tmp_path / "few" / "room", _config(), POINTS)
    job, whole = prepared.job, open_dataset_job(scene, tmp_path / "all" / "room", _config(), POINTS).job
    assert job is not None and whole is not None
    assert len(job.plan.draft.shards) == 4  # two blocks of four
    job.__dict__["side"] = 4
    numbers, made = [*range(len(job.plan.tiles))], {}
    made.update(build_tiles(job, [1], upcoming=[0, 2]))
    made.update(build_tiles(job, [0], upcoming=[2]))
    made.update(build_tiles(job, [2]))
    assert made == {0: 1, 1: 2, 2: 1} and simulated == [(4, 4), (4, 0), (4, 0)]
    assert build_tiles(whole, numbers) == made and simulated[3:] == [(8, 0)]
    assert build_tiles(whole, numbers) == dict.fromkeys(numbers, 0) and len(simulated) == 4
    for shard in sorted(whole.folder.glob("*.h5")):
        assert shard.read_bytes() == (job.folder / shard.name).read_bytes()
        if shard.name == "s00004_l00004.h5":
            shard.unlink()
    assert build_tiles(whole, numbers) == {0: 0, 1: 0, 2: 1}
    assert simulated[4:] == [(4, 0)]


def test_a_worker_tells_of_each_tile(scene: ss.Scene, tmp_path: Path) -> None:
    folder = tmp_path / "room"
    open_dataset_job(scene, folder, _config(), POINTS)
    told: list[int] = []
    done = work_here(str(folder), [1, 0, 2], told.append)
    assert {n: d.made for n, d in done.items()} == {0: 1, 1: 2, 2: 1}
    assert told[-1] == 4 + 4 + 8  # a point counts once for each tile that it is in
    assert [d.profile is None for d in (done[1], done[0], done[2])] == [False, True, True]
    with pytest.raises(ss.DatasetError, match="tile 3 is out of range"):
        build_tiles(open_job(folder), [3])


def test_a_forecast_knows_what_is_simulated_as_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twenty points in two blocks: as one, each is traced once; in two processes, twice."""
    points = np.random.default_rng(1).uniform(0.5, np.array(SIZE) - 0.5, (20, 3))
    room = ss.shoebox(SIZE, absorption=0.3, scattering=0.4, name="room")
    job = open_dataset_job(room, tmp_path / "room", _config(), points).job
    assert job is not None
    cost = estimate.Cost(1.0, 0.001, 0.0, 1.0, 0.001, 1.0, 0.0, (4, 16))
    monkeypatch.setattr(estimate, "measure", lambda *_: cost)
    monkeypatch.setattr(estimate, "thread_count", lambda: 1)
    assert estimate.estimate(job).seconds == pytest.approx(20 + 0.001 * 400)
    monkeypatch.setattr(estimate, "thread_count", lambda: 64)
    monkeypatch.setattr(estimate, "free_memory", lambda: 64e9)
    assert estimate.estimate(job).seconds == pytest.approx(40 + 0.001 * 400)
