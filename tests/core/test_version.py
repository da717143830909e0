"""The version names the commit: of a checkout, of a wheel, or of neither."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.cli.app import app
from soundspaces_sim.core import version
from soundspaces_sim.dataset.format.manifest import read_manifest


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder that stands for core/ of a package without a commit."""
    here = tmp_path / "soundspaces_sim" / "core"
    here.mkdir(parents=True)
    monkeypatch.setattr(version, "_HERE", here)
    version.commit.cache_clear()
    yield here
    version.commit.cache_clear()


def _git(folder: Path, *words: str) -> str:
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    done = subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def test_a_checkout_says_its_commit_and_whether_it_was_changed(place: Path) -> None:
    root = place.parents[1]
    (root / "a").write_text("1")
    _git(root, "init", "--quiet")
    _git(root, "add", "a")
    _git(root, "commit", "--quiet", "-m", "one")
    head = _git(root, "rev-parse", "HEAD")
    assert version.commit() == head[:12]
    (root / "a").write_text("2")
    version.commit.cache_clear()
    assert version.version_text() == f"{ss.__version__} (commit {head[:12]}-dirty)"


def test_a_wheel_has_it_in_a_file_and_without_either_nothing_is_said(place: Path) -> None:
    assert version.commit() == "" and version.version_text() == ss.__version__
    (place / "commit.txt").write_text("0123456789ab\n")
    version.commit.cache_clear()
    assert version.commit() == "0123456789ab"


def test_command_and_manifest_say_the_same(dataset_folder: Path) -> None:
    said = CliRunner().invoke(app, ["--version"]).output
    assert said.startswith(f"soundspaces-sim {ss.__version__}")
    found = re.search(r"\(commit (.*)\)", said)
    manifest = read_manifest(dataset_folder)
    assert manifest.code_commit == (found[1] if found else "")
    assert manifest.code.startswith(ss.__version__) and manifest.code.endswith(manifest.code_commit)
