"""Exports of WAV are read as their clients read them; files of points."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.io import wavfile

import soundspaces_sim as ss
from soundspaces_sim.core.errors import PointError
from soundspaces_sim.dataset.exporters.plan import carry_out
from soundspaces_sim.dataset.exporters.points import read_points
from soundspaces_sim.dataset.exporters.wav import plan_wav
from soundspaces_sim.dataset.format.manifest import read_manifest, write_manifest
from tests.command_line import run_command


def test_wav_export(dataset_folder: Path, tmp_path: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        count = carry_out(plan_wav(ds, tmp_path, (0.0, 45.0), ambisonics=True))
        assert count == 3 * len(ds) == len(list((tmp_path / "two_rooms").iterdir()))
        _, ears = wavfile.read(tmp_path / "two_rooms" / "1_2_45.wav")
        np.testing.assert_array_equal(ears.T, ds.binaural(1, 2, 45.0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "at least one"),
        ("0 1 2 x\n", "numbers"),
        ("0 1 2 3\n2 1 2 3\n", "indices 0 to 1"),
        ("0 1 2 nan\n", "finite"),
    ],
)
def test_bad_points(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "points.txt"
    path.write_text(text)
    with pytest.raises(PointError, match=message):
        read_points(path)


def test_a_dataset_without_a_graph_exports_all(dataset_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    manifest = read_manifest(folder)
    without = (-1,) * len(manifest.points)
    write_manifest(folder, replace(manifest, nodes=(), edges=(), components=without))
    with ss.open_dataset(folder) as ds:
        assert plan_wav(ds, tmp_path, (0.0,), False, "nodes").files == len(ds)


def test_export_that_does_not_fit_writes_nothing(
    dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        plan = plan_wav(ds, tmp_path / "deep" / "out")
        free = shutil.disk_usage(tmp_path)._replace(free=plan.bytes - 1)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: free)
        with pytest.raises(ss.DatasetError, match=r"needs about .* GB, .* GB are free"):
            carry_out(plan)
        assert not (tmp_path / "deep").exists()


def test_rirs_at_published_points(tmp_path: Path) -> None:
    """`make rirs POINTS=...`: those points, in their order."""
    (tmp_path / "points.txt").write_text("1\t4.0\t3.0\t1.5\n0\t1.0\t2.5\t1.5\n2\t8.0\t7.0\t1.5\n")
    (tmp_path / "quick.toml").write_text(
        "[simulation]\nwalks = 16\nconnections.subpaths = 2\nduration = 0.1\nradiance_transfer = false\ndiffraction = false\n"
        "[dataset]\nrate = 8000\n"
    )
    command = ["rirs", "demo", "--points", "points.txt", "--config", "quick.toml", "--store", "both"]
    result = run_command(*command, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    with ss.open_dataset(tmp_path / "out" / "demo") as ds:
        np.testing.assert_array_equal(ds.points, [[1, 2.5, 1.5], [4, 3, 1.5], [8, 7, 1.5]])
        assert "--points points.txt" in ds.manifest.command
        assert np.isfinite(ds.table()["geodesic"]).all()
    (tmp_path / "points.txt").write_text("0 100 100 100\n")
    result = run_command(*command, "--out", "o2", cwd=tmp_path)
    assert result.returncode == 2 and "outside the scene" in result.stderr
