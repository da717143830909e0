"""The report on a dataset: what it says, that it loads and runs nothing, and damaged or odd datasets."""

from __future__ import annotations

import base64
import io
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest
import soundfile
from PIL import Image
from soundspaces_pictures.report import write_report
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.cli.app import app
from soundspaces_sim.dataset.format.manifest import read_manifest, write_manifest
from tests.conftest import small_job
from tests.marks import ci_slow
from tests.rooms import plain
from tests.transport.test_cut_responses import LIVE, POINTS


class _Page(HTMLParser):
    """Tags, texts, and what the page would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.loads: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.loads += [v for k, v in attrs if k in ("src", "href") and v is not None]

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def page(dataset_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> _Page:
    out = tmp_path_factory.mktemp("report") / "report.html"
    assert write_report(dataset_folder, out) == []
    return _Page(out.read_text("utf-8"))


def test_it_says_what_the_dataset_is(page: _Page, dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        m, table = ds.manifest, ds.table()
        for fact in (
            m.scene_digest,
            m.key,
            m.target,
            f"{len(ds):,} room impulse responses",
            f"{ds.rate} Hz",
        ):
            assert fact in page.text
        usable = (table["status"] == 0) & (table["source"] != table["listener"])
        for b in range(4):
            middle = np.nanmedian(table[f"t30_{b}"][usable].astype(float))
            assert f"{middle:.2f} (" in page.text
        late = np.stack([table[f"late_error_{b}"] for b in range(4)]).max(axis=0)
        one_way = (table["status"] == 0) & (table["source"] < table["listener"])
        one_way &= np.isfinite(late)  # an error that is not known is infinite
        worst = np.flatnonzero(one_way)[np.argmax(late[one_way])]
        assert f"{100 * late[worst]:.1f} %" in page.text
    assert "MIT" in page.text and "chen2020soundspaces" in page.text


def test_it_loads_and_runs_nothing(page: _Page) -> None:
    """Pictures and sounds lie in the page; all can be read."""
    assert "script" not in page.tags and "iframe" not in page.tags and "link" not in page.tags
    assert page.loads and all(x.startswith("data:") for x in page.loads)
    pictures = [x for x in page.loads if x.startswith("data:image/png;base64,")]
    sounds = [x for x in page.loads if x.startswith("data:audio/flac;base64,")]
    assert len(pictures) == 5 and len(sounds) == 3
    for data in pictures:
        image = Image.open(io.BytesIO(base64.b64decode(data.split(",")[1])))
        assert min(image.size) > 200
    peaks = []
    for data in sounds:
        signal, rate = soundfile.read(io.BytesIO(base64.b64decode(data.split(",")[1])))
        assert signal.shape[1] == 2 and rate > 0
        peaks.append(np.abs(signal).max())
    assert max(peaks) == pytest.approx(0.7, abs=0.01)


def test_names_are_text(dataset_folder: Path, tmp_path: Path) -> None:
    """A scene may be called anything; nothing of it becomes part of the page."""
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    name = "<img src=x onerror=alert(1)>&amp;"
    write_manifest(folder, msgspec.structs.replace(read_manifest(folder), scene=name))
    write_report(folder, tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text("utf-8")
    assert "<img src=x" not in text and name in _Page(text).text


def test_damage_is_told(dataset_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    (folder / "floorplan.hdf5").write_bytes((folder / "floorplan.hdf5").read_bytes()[:-1] + b"x")
    result = CliRunner().invoke(
        app, ["report", str(folder), "--full", "--out", str(tmp_path / "r.html")]
    )
    assert result.exit_code == 1, result.output
    assert re.search(r"floorplan\.hdf5.*SHA-256", (tmp_path / "r.html").read_text("utf-8"))


@ci_slow
def test_waveforms_alone(small_scene: ss.Scene, tmp_path: Path) -> None:
    folder = ss.build_dataset(small_scene, tmp_path, small_job(store="waveform", rate=16000)).folder
    write_report(folder, tmp_path / "r.html")
    assert "waveforms" in _Page((tmp_path / "r.html").read_text("utf-8")).text


def test_it_says_what_is_cut(tmp_path: Path) -> None:
    simulation = plain(walks=64, max_duration=0.5, duration=None)
    made = ss.build_dataset(LIVE, tmp_path, ss.JobConfig(simulation=simulation), points=POINTS, jobs=1)
    write_report(made.folder, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text("utf-8")
    assert "T30 of 0–176 Hz is not defined in 2 of 2 pairs" in text
    assert "where the response is cut after" in text and "simulation.max_duration" in text
