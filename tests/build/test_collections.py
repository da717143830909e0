"""Several scenes as one job, shares of a job, and what is said before and while it runs."""

from __future__ import annotations

import itertools
import json
import math
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from typer.testing import CliRunner, Result

import soundspaces_sim as ss
from soundspaces_sim.build import estimate
from soundspaces_sim.build.build import build_datasets, in_order, scenes_of, share_of
from soundspaces_sim.build.engines import Task
from soundspaces_sim.build.engines.capacity import choose_shape
from soundspaces_sim.build.estimate import measure
from soundspaces_sim.build.finish import finish_folder
from soundspaces_sim.build.forecast import ALONE, forecast, wall_time
from soundspaces_sim.build.plan import even_block, make_tiles
from soundspaces_sim.build.prepare import plan_job
from soundspaces_sim.build.status import find_datasets, read_status
from soundspaces_sim.cli.app import app
from soundspaces_sim.scene.load import find_scenes
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.simulate import simulate_rays
from tests.build.test_engines import hashes
from tests.conftest import small_job
from tests.marks import ci_slow, few
from tests.rooms import box, table


def _shards(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.glob("*.h5"))}


def _room(name: str, length: float) -> ss.Scene:
    return replace(box((length, 3.0, 2.5), table(0.4, 0.5)), name=name)


def test_two_halves_make_the_same_bytes(
    tmp_path: Path, dataset_folder: Path, small_scene: ss.Scene
) -> None:
    """Shares of a job, in any order; a finish before the last one says what is missing; none is made twice."""
    made = []
    for share in ((2, 2), (1, 2)):
        with pytest.raises(ss.DatasetError, match=r"no job|no dataset|shards are missing"):
            finish_folder(tmp_path / "two_rooms")
        result = ss.build_dataset(small_scene, tmp_path, small_job(), share=share)
        made.append(result.built)
        assert not result.manifest.complete
    assert sum(made) == len(_shards(dataset_folder)) and min(made) > 0
    assert finish_folder(tmp_path / "two_rooms").complete
    assert hashes(tmp_path / "two_rooms") == hashes(dataset_folder)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 40])
def test_shares_are_a_partition(n: int) -> None:
    tasks = [Task(Path("a"), k) for k in range(23)]
    shares = [share_of(tasks, (k, n)) for k in range(1, n + 1)]
    assert sorted(t.number for share in shares for t in share) == list(range(23))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1
    for wrong in ((0, n), (n + 1, n)):
        with pytest.raises(ss.ConfigError, match=r"tiles: expected share k/n"):
            share_of(tasks, wrong)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 40])
@pytest.mark.parametrize("scenes", [1, 2, 3, 5, 90])
def test_shares_of_scenes_are_a_partition(scenes: int, n: int) -> None:
    """Every tile is one share's; a share has whole scenes or a part of one."""
    tiles = 11
    found: list[tuple[int, int]] = []
    for k in range(1, n + 1):
        numbers, share = scenes_of(scenes, (k, n))
        assert share is not None and (len(numbers) == 1 or share == (1, 1))
        found += [(i, t) for i in numbers for t in range(tiles)[share[0] - 1 :: share[1]]]
    assert sorted(found) == [(i, t) for i in range(scenes) for t in range(tiles)]
    assert scenes_of(scenes, None) == (range(scenes), None)


def test_a_share_prepares_its_own_scenes_alone(tmp_path: Path) -> None:
    rooms, loaded = [_room("hall", 5.0), _room("cell", 3.0)], []

    def load(room: ss.Scene) -> ss.Scene:
        loaded.append(room.name)
        return room

    for k, name in ((1, "hall"), (2, "cell")):
        share = build_datasets([partial(load, r) for r in rooms], tmp_path, small_job(), share=(k, 2))
        assert loaded[-1] == name and len(loaded) == k and [r.folder.name for r in share] == [name]
        assert not share[0].manifest.complete and share[0].built == share[0].shards
        assert finish_folder(tmp_path / name).complete


def test_scenes_are_one_job(tmp_path: Path) -> None:
    """The bytes of each are those of a job of its own; a scene may be loaded when it is needed."""
    rooms = [_room("hall", 6.0), _room("cell", 3.0)]
    loaded: list[str] = []

    def load(room: ss.Scene) -> ss.Scene:
        loaded.append(room.name)
        return room

    results = build_datasets([partial(load, r) for r in rooms], tmp_path / "all", small_job(tile=4))
    assert loaded == ["hall", "cell"]
    assert [r.folder.name for r in results] == ["hall", "cell"]
    for room, result in zip(rooms, results, strict=True):
        assert result.manifest.complete and result.built == result.shards
        alone = ss.build_dataset(room, tmp_path / "alone", small_job(tile=4))
        assert hashes(alone.folder) == hashes(result.folder)
    again = build_datasets(rooms, tmp_path / "all", small_job(tile=4))
    assert [r.built for r in again] == [0, 0]
    with pytest.raises(ss.ConfigError, match="two of the scenes are called hall"):
        build_datasets([rooms[0], rooms[0]], tmp_path / "twice", small_job())


def test_the_longest_tiles_begin(tmp_path: Path) -> None:
    """In order of cost within a factor of two; among those, scene by scene."""
    plans = {}
    for name, length, duration in (("a", 6.0, 0.1), ("b", 6.0, 0.4)):
        config = small_job(tile=4)
        points = np.random.default_rng(0).uniform([0.5, 0.5, 1.0], [5.5, 2.5, 1.5], (13, 3))
        job, _ = plan_job(_room(name, length), tmp_path / name, config, points)
        draft = job.plan.draft
        plans[tmp_path / name] = replace(job.plan, draft=structs.replace(draft, duration=duration))
    tasks = in_order(plans)
    assert sorted((t.folder, t.number) for t in tasks) == [
        (f, k) for f, plan in plans.items() for k in range(len(plan.tiles))
    ]
    costs = np.array([t.cost for t in tasks])
    assert (costs[1:] <= 2.0 * costs[:-1]).all() and costs[0] == costs.max()
    first_of_a = next(k for k, t in enumerate(tasks) if t.folder.name == "a")
    assert all(t.folder.name == "b" for t in tasks[:first_of_a]) and first_of_a >= 6
    of_b = [t.cost for t in tasks if t.folder.name == "b"]
    assert of_b == sorted(of_b, reverse=True)


def test_folders_of_scenes(tmp_path: Path) -> None:
    for name in ("b.obj", "a.ply", "notes.txt"):
        (tmp_path / name).touch()
    assert find_scenes(["demo", str(tmp_path)]) == [
        "demo",
        str(tmp_path / "a.ply"),
        str(tmp_path / "b.obj"),
    ]
    (tmp_path / "empty").mkdir()
    with pytest.raises(ss.SceneError, match="neither a scene nor a folder of scenes"):
        find_scenes([str(tmp_path / "empty")])


def test_status_reads_the_folder_alone(
    tmp_path: Path, dataset_folder: Path, small_scene: ss.Scene
) -> None:
    ss.build_dataset(small_scene, tmp_path, small_job(), share=(1, 3))
    folder = tmp_path / "two_rooms"
    part, whole = read_status(folder), read_status(dataset_folder)
    assert (part.complete, part.tiles, part.rirs) == (False, (1, 3), (32, 64))  # the tile there and back
    assert (whole.complete, whole.tiles, whole.rirs) == (True, (3, 3), (64, 64))
    assert part.bytes == sum(p.stat().st_size for p in folder.glob("s*.h5"))
    assert 0.0 <= part.age_s < 60.0
    with ss.open_dataset(dataset_folder) as ds:
        rows = ds.table(collocated=True)
    late = np.concatenate([rows[f"late_error_{b}"] for b in range(4)])
    assert whole.error == pytest.approx(np.median(late[(late > 0.0) & np.isfinite(late)]), rel=1e-3)
    for path in folder.glob("s*.h5"):
        path.unlink()
    none = read_status(folder)
    assert (none.tiles, none.rirs, none.bytes) == ((0, 3), (0, 64), 0)
    assert math.isnan(none.error) and math.isnan(none.age_s)
    assert find_datasets(tmp_path) == find_datasets(folder) == [folder]
    with pytest.raises(ss.DatasetError, match="no dataset at"):
        find_datasets(tmp_path / "two_rooms" / "nothing")


def test_wall_time_is_that_of_the_longest_first() -> None:
    assert wall_time([4, 3, 3, 2], 2) == 6.0
    assert wall_time([5, 4, 3, 3, 3], 2) == 10.0  # 18 s on two: Graham's rule misses the best, 9
    assert wall_time([8.0] * 10, 3, threads=2, overhead_s=0.5) == 4 * 4.5
    assert wall_time([1.0], 50) == 1.0
    # Cores are shared: two tiles at once with more threads than there are, then one with all of its own.
    assert wall_time([8.0, 8.0, 4.0], 2, threads=4, cores=4) == pytest.approx(20.0 / 4.0)
    assert wall_time([6.0], 1, threads=4, cores=4, alone=1.0 / 3.0) == pytest.approx(2.0 + 4.0 / 4.0)
    # Each is on one core half of the time, and then the other has three.
    two = wall_time([8.0, 8.0], 2, threads=4, cores=4, alone=0.5)
    assert 16.0 / 4.0 < two < wall_time([8.0], 1, threads=4, cores=4, alone=0.5) * 1.4


@pytest.mark.parametrize(("cores", "least"), [(16, 0.85), (64, 0.85), (256, 0.8)])
def test_cores_are_in_use(cores: int, least: float) -> None:
    """Share of the cores that work while tiles of 2,000 points are made, as measured in the house: .18 s of a point
    in a tile, 4.5 ms of an ordered pair."""
    tiles = make_tiles(2000, even_block(2000, 160))
    seconds = [0.18 * tile.cost + 0.0045 * tile.pairs for tile in tiles]
    processes, threads = choose_shape(cores, 1e13, len(tiles))
    wall = wall_time(seconds, processes, threads, 0.0, cores, ALONE)
    assert least < sum(seconds) / (cores * wall) < 1.0


@ci_slow
def test_a_forecast_is_what_the_job_then_takes(tmp_path: Path) -> None:
    """Bytes within a quarter, tiles those of the job; seconds are of the machine's mood, so only positive."""
    points = np.random.default_rng(0).uniform([0.5, 0.5, 1.0], [5.5, 2.5, 1.5], (36, 3))
    room = _room("hall", 6.0)
    told = forecast(room, small_job(tile=12), points)
    result = ss.build_dataset(room, tmp_path, small_job(tile=12), points=points)
    assert (told.scene, told.points, told.pairs, told.duration) == ("hall", 36, 1296, 0.2)
    assert len(told.tiles) == 6 and min(told.tiles) > 0.0
    assert told.core_hours == pytest.approx(sum(told.tiles) / 3600.0)
    assert told.bytes == pytest.approx(sum(e.bytes for e in result.manifest.shards), rel=0.25)
    assert not (tmp_path / "hall" / "job.npz").exists()


@pytest.mark.parametrize(
    ("seconds", "told_of", "measured"),
    few(
        [
            (0.0, [2, 2, 4, 8], (4, 8)),
            (3.0, [2, 2, 4, 8], (4, 8)),
            (4.5, [2, 2, 4, 8], (4, 8)),
            (4.99, [2, 2, 4, 8], (4, 8)),
            (10.1, [2, 2], (2,)),
            (19.9, [2, 2], (2,)),
            (20.1, [2], (2,)),
            (40.0, [2], (2,)),
        ],
        (4.99, [2, 2, 4, 8], (4, 8)),
        (10.1, [2, 2], (2,)),
        (19.9, [2, 2], (2,)),
        (20.1, [2], (2,)),
    ),
)
def test_what_is_measured_is_bounded(
    tmp_path: Path, seconds: float, told_of: list[int], measured: tuple[int, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Every tile takes so many seconds. One of twice the points takes two to four times as long: with up to 5 s
    for the one before it is within 20 s, with more than 10 s not, and a tile that takes longer than that is not
    made twice.
    Points are those that are told of; subpaths those of these points, for each way."""
    points = np.random.default_rng(0).uniform([0.5, 0.5, 1.0], [5.5, 2.5, 1.5], (8, 3))
    job, _ = plan_job(_room("hall", 6.0), tmp_path, small_job(tile=12), points)
    now = itertools.count(0.0, seconds)
    told: list[int] = []
    traced: list[int] = []

    def counted(model: Model, a: np.ndarray, b: None) -> object:
        traced.append(len(a) * model.world.settings.subpaths)
        return simulate_rays(model, a, b)

    monkeypatch.setattr(estimate, "simulate_rays", counted)
    cost = measure(job, (2, 4, 8), 20.0, lambda: next(now), told.append)
    assert cost.measured == measured and told == told_of
    assert traced == [points * 64 for points in told_of]
    (tile,) = job.plan.tiles
    assert 0.0 <= cost.least_seconds(tile) <= cost.seconds(tile)


@pytest.mark.parametrize("share", [0.0, 0.5])
@pytest.mark.parametrize(
    ("fixed", "point", "pair"),
    few([(40.0, 0.5, 0.0), (0.0, 3.0, 0.1), (1.0, 1.0, 0.01)], (40.0, 0.5, 0.0), (0.0, 3.0, 0.1)),
)
def test_what_a_tile_takes_lies_between_the_bounds(
    tmp_path: Path, fixed: float, point: float, pair: float, share: float
) -> None:
    """Of tiles that take fixed + point k + pair k² seconds, whichever of the three outweighs, from 2 and 4
    points; a share of what points take is in the stages that work on pairs."""
    points = np.random.default_rng(0).uniform([0.5, 0.5, 1.0], [5.5, 2.5, 1.5], (8, 3))
    job, _ = plan_job(_room("hall", 6.0), tmp_path, small_job(tile=12), points)
    (tile,) = job.plan.tiles
    timed = [
        estimate._Timed(k, fixed + point * k + pair * k**2, share * point * k + pair * k**2, 1000 * k**2)
        for k in (2, 4)
    ]
    true = fixed + point * 8 + pair * 64
    for done in (timed, timed[:1]):
        cost = estimate._cost(job, done)
        assert cost.least_seconds(tile) <= true + 1e-9
        assert true <= cost.seconds(tile) + 1e-9 or len(done) == 1  # one tile does not tell of pairs


def _cli(*arguments: str) -> Result:
    """A command in this process; an error of ours is its `exception`."""
    return CliRunner(env={"COLUMNS": "160"}).invoke(app, [*arguments])


@ci_slow
def test_commands_from_plan_to_finish(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`plan` writes nothing; two shares, `status` between them, `finish`; the manifest is that of one command."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick.toml").write_text(
        "[grid]\nrays = 100\n[simulation]\nwalks = 16\nconnections.subpaths = 2\nduration = 0.1\nradiance_transfer = false\n"
        "diffraction = false\n[dataset]\ntile = 4\n"
    )
    how = ("demo", "--spacing", "3", "--config", "quick.toml")
    planned = _cli("plan", *how, "--json")
    assert planned.exit_code == 0, planned.output
    told = json.loads(planned.stdout.splitlines()[-1])
    assert told["pairs"] == told["points"] ** 2 and told["core_hours"] > 0.0
    assert [p.name for p in tmp_path.iterdir()] == ["quick.toml"]
    tables = _cli("plan", *how, "--workers", "7")
    assert "demo: placing points" in tables.stderr and "measuring 2 of" in tables.stderr
    assert "demo: measured on tiles of" in tables.stdout
    assert f"{told['pairs']:,}" in tables.stdout and "7 × 1" in tables.stdout
    half = _cli("rirs", *how, "--tiles", "1/2")
    assert half.exit_code == 0 and "soundspaces-sim finish out/demo" in half.stdout, half.output
    status = json.loads(_cli("status", "--json").stdout)
    assert 0 < status["tiles"][0] < status["tiles"][1] and not status["complete"]
    early = _cli("finish")
    assert isinstance(early.exception, ss.DatasetError) and "shards are missing" in str(early.exception)
    assert _cli("rirs", *how, "--tiles=2/2").exit_code == 0
    done = _cli("finish", "out")
    assert done.exit_code == 0 and f"{told['pairs']:,} room impulse responses" in done.stdout
    table = _cli("status", "out/demo")
    assert table.exit_code == 0 and "complete" in table.stdout and "ago" in table.stdout
    shares = hashes(tmp_path / "out" / "demo")
    shutil.move(tmp_path / "out", tmp_path / "before")
    assert _cli("rirs", *how, "--jobs", "1").exit_code == 0
    assert hashes(tmp_path / "out" / "demo") == shares


@pytest.mark.parametrize("share", ["0/2", "3/2", "a/b", "1", "1/0", "-1/2"])
def test_shares_that_are_none(share: str) -> None:
    result = _cli("rirs", "demo", f"--tiles={share}")
    assert isinstance(result.exception, ss.ConfigError)
    assert str(result.exception).startswith(f"--tiles {share}: expected k/n")


def test_points_are_of_one_scene(tmp_path: Path) -> None:
    (tmp_path / "points.txt").write_text("0 1.0 1.0 1.5\n1 2.0 1.0 1.5\n")
    result = _cli("rirs", "demo", "demo", "--points", str(tmp_path / "points.txt"))
    assert isinstance(result.exception, ss.ConfigError)
    assert "these are points of one scene, and there are 2" in str(result.exception)
