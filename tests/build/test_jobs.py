"""Plan, tile, finish: any process makes any tile, and the folder ends with the same bytes."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build import build, job_file
from soundspaces_sim.build.engines import ENGINES, BuildProgress, Engine, Options
from soundspaces_sim.build.estimate import Estimate
from soundspaces_sim.build.finish import finish_folder
from soundspaces_sim.build.job_file import open_job
from soundspaces_sim.build.plan import make_tiles
from soundspaces_sim.build.tile import build_tiles
from soundspaces_sim.core.numerics.kernel import thread_count
from soundspaces_sim.core.registry import Entry
from tests.conftest import small_job
from tests.marks import ci_slow
from tests.rooms import plain


def run_tile(folder: Path, number: int) -> int:
    """Make a tile of the job in `folder`; how many shards were missing."""
    return build_tiles(open_job(folder), [number])[number]


def _bytes(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


@pytest.mark.parametrize(("points", "block"), [(1, 1), (1, 5), (7, 3), (9, 3), (10, 96)])
def test_tiles_cover_every_pair_once(points: int, block: int) -> None:
    covered = np.zeros((points, points), int)
    tiles = make_tiles(points, block)
    for tile in tiles:
        for (s0, s1), (l0, l1) in tile.spans:
            assert s1 - s0 <= block and l1 - l0 <= block
            covered[s0:s1, l0:l1] += 1
    np.testing.assert_array_equal(covered, 1)
    assert sum(t.pairs for t in tiles) == points**2
    blocks = -(-points // block)
    assert len(tiles) == blocks * (blocks + 1) // 2


@pytest.fixture
def started(tmp_path: Path, small_scene: ss.Scene, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a job that was started, none of whose tiles is made."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(build, "find_engine", lambda _: Engine(Options, stop))
        with pytest.raises(KeyboardInterrupt):
            ss.build_dataset(small_scene, tmp_path, small_job(tile=7))
    folder = tmp_path / small_scene.name
    assert {p.name for p in folder.iterdir()} == {"manifest.json", "floorplan.hdf5", job_file.NAME}
    return folder


@ci_slow
def test_another_engine_is_a_file_and_a_line(
    tmp_path: Path, dataset_folder: Path, small_scene: ss.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tiles made by processes that get (folder, tile number) have the bytes of those made here."""
    toy = Entry("tests.build.subprocess_engine:ENGINE", "two processes")
    monkeypatch.setitem(ENGINES, "toy", toy)
    result = ss.build_dataset(small_scene, tmp_path, small_job(), engine="toy")
    assert result.built >= result.shards == 4
    assert _bytes(result.folder) == _bytes(dataset_folder)
    with pytest.raises(
        ss.ConfigError, match="engine: expected local, dask, slurm, ray or toy, got 'steam'"
    ):
        ss.build_dataset(small_scene, tmp_path, small_job(), engine="steam")


def test_a_tile_is_idempotent_and_a_finish_needs_all(started: Path, small_scene: ss.Scene) -> None:
    tiles = open_job(started).plan.tiles
    assert len(tiles) >= 3
    assert run_tile(started, 1) == 2  # there and back
    first = _bytes(started)
    assert run_tile(started, 1) == 0
    assert _bytes(started) == first
    with pytest.raises(ss.DatasetError, match=r"shards are missing, s00000_l00000\.h5 first"):
        finish_folder(started)
    with pytest.raises(ss.DatasetError, match="not finished"):
        ss.open_dataset(started)
    with pytest.raises(ss.DatasetError, match=rf"tile {len(tiles)} is out of range"):
        run_tile(started, len(tiles))
    for number in range(len(tiles)):
        run_tile(started, number)
    manifest = finish_folder(started)
    assert manifest.complete and not (started / job_file.NAME).exists()
    assert finish_folder(started) == manifest
    with pytest.raises(ss.DatasetError, match="no job is under way here"):
        run_tile(started, 0)
    done = _bytes(started)
    assert ss.build_dataset(small_scene, started.parent, small_job(tile=7)).built == 0
    assert _bytes(started) == done


def test_a_job_that_is_not_whole_is_refused(started: Path, tmp_path: Path) -> None:
    whole = (started / job_file.NAME).read_bytes()
    for change in ("bit", "short", "empty", "gone"):
        folder = tmp_path / change
        shutil.copytree(started, folder)
        path = folder / job_file.NAME
        data = bytearray(whole)
        data[whole.index(b"geodesic.npy") + 200] ^= 1
        path.write_bytes({"bit": bytes(data), "short": whole[:-40], "empty": b"", "gone": b""}[change])
        if change == "gone":
            path.unlink()
        with pytest.raises(
            ss.DatasetError, match=r"cannot read this job|is damaged|no job is under way"
        ):
            run_tile(folder, 0)
    with np.load(started / job_file.NAME, allow_pickle=False) as file:  # no pickles in it
        arrays = {name: file[name] for name in file.files}
    arrays["absorption"] = 0.5 * arrays["absorption"]
    del arrays["digest"]
    np.savez(started / job_file.NAME, **arrays, digest=np.array(job_file._digest(arrays)))
    with pytest.raises(ss.DatasetError, match="do not give the keys of the plan"):
        run_tile(started, 0)


def test_a_job_of_another_version_is_refused(started: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_file, "__version__", "99.0")
    job_file._read.cache_clear()
    with pytest.raises(ss.DatasetError, match="need the same"):
        run_tile(started, 0)


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ({"code_version": "99.0", "novelty": 1}, r"version 99\.0 of soundspaces_sim planned this job"),
        ({"target": "toaster", "novelty": 1}, "on another machine .code for toaster"),
        ({"novelty": 1}, "not a job of this version .*novelty"),
        ('{"novelty": ' + "[" * 10**5, "not a job of this version"),
    ],
    ids=["version", "machine", "form", "nested"],
)
def test_a_plan_of_another_form_is_refused_by_name(started: Path, plan: Any, words: str) -> None:
    """Whatever another version has put in it, or left out of the file."""
    with np.load(started / job_file.NAME, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    del arrays["digest"], arrays["mounting"]
    if not isinstance(plan, str):
        plan = json.dumps(json.loads(arrays["plan"].tobytes()) | plan)
    arrays["plan"] = np.frombuffer(plan.encode(), np.uint8)
    np.savez(started / job_file.NAME, **arrays, digest=np.array(job_file._digest(arrays)))
    with pytest.raises(ss.DatasetError, match=words):
        run_tile(started, 0)


def test_threads_and_renderers_are_checked_before_work(
    tmp_path: Path, small_scene: ss.Scene, caplog: pytest.LogCaptureFixture
) -> None:

    before = thread_count()
    with pytest.raises(ss.ConfigError, match="jobs: expected 1 to"):
        ss.build_dataset(small_scene, tmp_path, small_job(), jobs=0)
    with pytest.raises(
        ss.ConfigError, match=r"dataset\.renderer: expected default, smooth, paper or direct"
    ):
        ss.build_dataset(small_scene, tmp_path, small_job(renderer="loud"))
    assert not any(tmp_path.iterdir())
    seen: list[BuildProgress] = []
    caplog.set_level("INFO", "soundspaces_sim")
    result = ss.build_dataset(small_scene, tmp_path, small_job(tile=7), jobs=1000, progress=seen.append)
    assert "1000 jobs were asked for" in caplog.text and thread_count() == before
    assert seen[-1].done == seen[-1].total and seen[-1].rirs == len(result.manifest.points) ** 2
    assert [p.done for p in seen] == sorted(p.done for p in seen)


def test_a_folder_of_something_else_says_what_differs(
    dataset_folder: Path, small_scene: ss.Scene, tmp_path: Path
) -> None:
    import msgspec

    from tests.rooms import table, two_rooms

    folder = tmp_path / dataset_folder.name
    shutil.copytree(dataset_folder, folder)
    before = _bytes(folder)
    job = small_job()
    walks = msgspec.structs.replace(job.simulation, walks=128)
    other_room = two_rooms(table(0.31, 0.4, 0.01), 0)
    for scene, config, points, message in (
        (
            small_scene,
            msgspec.structs.replace(job, simulation=walks),
            None,
            r"setting \(simulation\.walks 64, now 128\)",
        ),
        (small_scene, small_job(seed=3), None, r"setting \(dataset\.seed 0, now 3\)"),
        (small_scene, job, [[1.0, 1.0, 1.5], [5.0, 2.0, 1.5]], r"set of points \(8, now 2\)"),
        (other_room, job, None, r"scene \(its triangles or materials differ\)"),
    ):
        with pytest.raises(ss.DatasetError, match=message):
            ss.build_dataset(scene, tmp_path, config, points=points)  # type: ignore[arg-type]
    assert _bytes(folder) == before


def test_a_setting_that_no_shard_hangs_on_is_reported(
    dataset_folder: Path, small_scene: ss.Scene, tmp_path: Path
) -> None:
    shutil.copytree(dataset_folder, tmp_path / dataset_folder.name)
    result = ss.build_dataset(small_scene, tmp_path, small_job(rate=8000))
    assert result.built == 0 and result.changed == ("dataset.rate 16000, now 8000",)
    assert ss.open_dataset(result.folder).rate == 8000
    assert ss.build_dataset(small_scene, tmp_path, small_job(rate=8000)).changed == ()


def test_estimate_of_what_is_to_come(tmp_path: Path, small_scene: ss.Scene) -> None:
    """The size is that of the files within a quarter; a job that is done, or tiny, is not measured."""
    points = np.random.default_rng(0).uniform([0.5, 0.5, 1.0], [7.5, 3.5, 1.6], (30, 3))
    told: list[Estimate] = []
    config = small_job(tile=15)
    result = ss.build_dataset(small_scene, tmp_path / "a", config, points=points, announce=told.append)
    (found,) = told
    assert found.points == 30 and found.pairs == 900 and found.duration == 0.2
    stored = sum(e.bytes for e in result.manifest.shards)
    assert found.bytes == pytest.approx(stored, rel=0.25) and found.seconds > 0.0
    ss.build_dataset(small_scene, tmp_path / "b", small_job(), announce=told.append)
    assert np.isnan(told[1].seconds)


def test_a_dataset_is_built_of_what_load_scene_takes(tmp_path: Path) -> None:
    """As `simulate` takes it: by name; what is no scene is refused in our words."""
    points = np.array([[2.0, 2.0, 1.5], [3.0, 2.0, 1.5]])
    config = ss.JobConfig(
        simulation=plain(walks=16, connections={"subpaths": 2}, duration=0.05, radiance_transfer=False)
    )
    result = ss.build_dataset("demo", tmp_path, config, points=points)
    assert result.folder == tmp_path / "demo" and len(result.manifest.points) == 2
    with pytest.raises(ss.SceneError, match="unknown scene 'nowhere'"):
        ss.build_dataset("nowhere", tmp_path, config)


def test_a_finished_dataset_that_can_only_be_read_is_returned(
    tmp_path: Path, small_scene: ss.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = ss.build_dataset(small_scene, tmp_path, small_job())
    (first.folder / "job.npz").write_bytes(b"left by another command")

    def read_only(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    for name in ("unlink", "mkdir", "touch"):
        monkeypatch.setattr(Path, name, read_only)
    for name in ("replace", "fsync", "utime"):
        monkeypatch.setattr(os, name, read_only)
    again = ss.build_dataset(small_scene, tmp_path, small_job())
    assert again.manifest == first.manifest and again.built == 0
