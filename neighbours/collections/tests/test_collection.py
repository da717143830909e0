"""`make collection`: many buildings as one, resumable, checked, described."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from soundspaces_collections import make, report
from soundspaces_collections.make import Collection, forecast_collection, split_of
from soundspaces_collections.pipeline import build_collection
from soundspaces_collections.records import (
    Distribution,
    Record,
    add_record,
    describe,
    edges_of,
    floor_area,
    read_records,
)
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.cli.app import app
from soundspaces_sim.dataset.format.collection_manifest import read_collection, verify_collection
from tests.conftest import small_job
from tests.rooms import table, two_rooms

pytest.importorskip("matplotlib", reason="the extra `figures` is not installed")


def _config() -> ss.JobConfig:
    small = small_job(licence="CC BY 4.0")
    return msgspec.structs.replace(small, grid=ss.GridConfig(spacing=1.5, rays=64, standing=True))


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Three buildings, of which the second fails, and what was said."""
    out, said = tmp_path_factory.mktemp("collection"), list[str]()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "load_scene", _small)
        patch.setattr(report, "_MOST", 1)
        patch.setattr(make, "load_scene", _second_fails)
        build_collection(
            out, 3, _config(), 1, kind="room", episodes_each=2, say=said.append, report_to=out / "docs" / "page.md"
        )  # fmt: skip
    return out, said


def _small(name: str) -> ss.Scene:
    """Two rooms in place of what code would make."""
    scene = two_rooms(table(0.2 + 0.1 * int(name[-1]), 0.4, 0.01), 0)
    return ss.Scene.from_arrays(
        scene.vertices, scene.faces, absorption=0.2 + 0.1 * int(name[-1]), name=name
    )


def _second_fails(name: str) -> ss.Scene:
    if name == "room-1":
        raise ss.SceneError("it fell down")
    return _small(name)


def test_one_that_fails_is_recorded_and_stops_no_other(built: tuple[Path, list[str]]) -> None:
    out, said = built
    made = read_collection(out)
    assert [s.scene for s in made.scenes] == ["room-0", "room-2"]
    assert [(f.scene, f.error) for f in made.failures] == [("room-1", "SceneError: it fell down")]
    assert any("room-1: SceneError" in line for line in said)
    assert any(line.startswith("forecast, from 2 measured buildings: 3 to make") for line in said)
    assert "room-1: SceneError" in (out / "log.txt").read_text()
    with ss.open_datasets(out) as opened:
        assert list(opened) == ["room-0", "room-2"] and opened.pairs == made.pairs
        assert opened.manifest == made
    with ss.open_datasets(out, split="train") as opened:
        assert list(opened) == ["room-0", "room-2"]
    with pytest.raises(ss.ConfigError, match="did you mean 'train'"):
        ss.open_datasets(out, split="tran")


def test_a_second_run_makes_what_is_left_and_nothing_else(
    built: tuple[Path, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whole rooms keep their bytes and their time; the one that failed is made now; the manifest is in order."""
    out, said = built
    before = {p: p.read_bytes() for p in out.glob("room-*/*")}
    times = {name: r.processor_s for name, r in read_records(out).items()}
    said.clear()
    monkeypatch.setattr(report, "load_scene", _small)
    monkeypatch.setattr(report, "_MOST", 1)
    monkeypatch.setattr(make, "load_scene", _small)
    made = build_collection(out, 3, _config(), 1, kind="room", episodes_each=2, say=said.append)
    assert [s.scene for s in made.scenes] == ["room-0", "room-1", "room-2"] and not made.failures
    assert [line.split(":")[0] for line in said if line.startswith("room-")] == ["room-1"]
    assert all(p.read_bytes() == content for p, content in before.items())
    after = read_records(out)
    assert all(after[n].processor_s == times[n] for n in ("room-0", "room-2"))
    assert verify_collection(out, full=True)[1] == []
    text = (out / "report.md").read_text()
    assert f"{made.pairs:,} in" in text and "Forecast of 1,000" in text and "0 buildings failed" in text
    assert "nan" not in text


def test_verify_names_what_was_changed(built: tuple[Path, list[str]], tmp_path: Path) -> None:
    out, _ = built
    run = CliRunner().invoke(app, ["verify", str(out), "--full"])
    assert run.exit_code == 0, run.output
    assert "Not compared" in run.output and "log.txt" in run.output and "homes.jsonl" not in run.output
    shard = next((out / "room-0").glob("s*.h5"))
    whole, readme = shard.read_bytes(), (out / "README.md").read_bytes()
    lines = (out / "homes.jsonl").read_bytes()
    try:
        shard.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
        (out / "README.md").write_text("other")
        (out / "homes.jsonl").write_bytes(lines.replace(b"1", b"2"))
        problems = {p.file for p in verify_collection(out, full=True)[1]}
        assert problems == {f"room-0/{shard.name}", "README.md", "homes.jsonl"}
        run = CliRunner().invoke(app, ["verify", str(out), "--full"])
        assert run.exit_code == 1 and "room-0" in run.output
    finally:
        shard.write_bytes(whole)
        (out / "README.md").write_bytes(readme)
        (out / "homes.jsonl").write_bytes(lines)
    (tmp_path / "collection.json").write_text('{"format": "other"}')
    with pytest.raises(ss.DatasetError, match=r"collection.json: expected soundspaces_sim/collection"):
        read_collection(tmp_path)


@pytest.mark.parametrize("bad", ["../elsewhere", "a/b", "/etc"])
def test_a_manifest_leads_nowhere_else(built: tuple[Path, list[str]], tmp_path: Path, bad: str) -> None:
    raw = json.loads((built[0] / "collection.json").read_text())
    raw["scenes"][0]["scene"] = bad
    (tmp_path / "collection.json").write_text(json.dumps(raw))
    with pytest.raises(ss.DatasetError, match="regex"):
        ss.open_datasets(tmp_path)


def test_statistics_are_those_of_the_table(built: tuple[Path, list[str]]) -> None:
    out, _ = built
    scene = _small("room-0")
    with ss.open_dataset(out / "room-0") as ds:
        record, rows = describe(ds, scene), ds.table()
    assert record.points**2 - record.points == len(rows)
    known = rows["c50_2"][np.isfinite(rows["c50_2"])]
    assert record.measures["c50"].median[2] == pytest.approx(np.median(known), abs=1e-5)
    assert sum(record.measures["c50"].counts[2]) == len(known)
    expected, _ = np.histogram(np.clip(known, -30, 49.999), edges_of("c50"))
    assert record.measures["c50"].counts[2] == expected.tolist()
    assert record.bytes == sum(p.stat().st_size for p in (out / "room-0").iterdir())


def test_floor_area_is_that_of_a_shoebox() -> None:
    assert floor_area(ss.shoebox((4.0, 3.0, 2.5))) == pytest.approx(12.0)


def test_splits_go_by_number() -> None:
    """Eight, one and one of ten, and none changes its split when more are made."""
    found = [split_of(f"home-{k}") for k in range(20)]
    assert found == (["train"] * 8 + ["val", "test"]) * 2


def test_a_line_that_was_cut_off_is_ended_and_left_out(tmp_path: Path) -> None:
    add_record(tmp_path, Record(scene="home-0", processor_s=3.0, points=2))
    with open(tmp_path / "homes.jsonl", "ab") as file:
        file.write(b'{"scene": "home-1", "poi')
    assert list(read_records(tmp_path)) == ["home-0"]
    add_record(tmp_path, Record(scene="home-2"))
    with pytest.raises(ss.DatasetError, match="line 2"):
        read_records(tmp_path)


def test_a_forecast_of_finished_buildings_is_their_mean(tmp_path: Path) -> None:
    """Of 2, 4 and 6 s, seven more take 28 s ± 7 * 2 / sqrt(3) s."""
    measure = {"t30": Distribution(counts=[], median=[], error=[])}
    for k, seconds in enumerate((2.0, 4.0, 6.0)):
        add_record(tmp_path, Record(scene=f"home-{k}", processor_s=seconds, bytes=100, measures=measure))
    found = forecast_collection(Collection(tmp_path, 7, _config()), print)
    assert (found.left, found.basis, found.finished) == (7, 3, True)
    assert found.core_s == pytest.approx(28.0) and found.bytes == pytest.approx(700.0)
    assert found.core_s_error == pytest.approx(7 * 2.0 / np.sqrt(3.0))


def test_settings_that_cannot_be(tmp_path: Path) -> None:
    for count in (0, 10**7):
        with pytest.raises(ss.ConfigError, match="homes: expected 1 to"):
            build_collection(tmp_path, count, _config())
    with pytest.raises(ss.DatasetError, match="no dataset is finished"):
        build_collection(tmp_path, 1, _config(), finish=True)
