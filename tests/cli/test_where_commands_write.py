"""Where commands write, and that nothing is written over unasked."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.command_line import run_command


@pytest.fixture
def dataset(dataset_folder: Path, tmp_path: Path) -> Path:
    """A copy in the folder `tmp_path`."""
    return Path(shutil.copytree(dataset_folder, tmp_path / "room"))


@pytest.mark.parametrize(
    "command",
    [
        ("export", "wav", "room", "--out", "room"),
        ("rirs", "demo", "--out", "room"),
    ],
)
def test_nothing_is_written_into_a_dataset(dataset: Path, command: tuple[str, ...]) -> None:
    before = {p.name for p in dataset.rglob("*")}
    ended = run_command(*command, cwd=dataset.parent)
    assert ended.returncode == 2 and "room is a dataset" in ended.stderr
    assert {p.name for p in dataset.rglob("*")} == before


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("table", "room"), "pairs.csv"),
    ],
)
def test_a_datasets_files_go_beside_it_and_are_not_replaced_unasked(
    dataset: Path, command: tuple[str, ...], name: str
) -> None:
    assert run_command(*command, cwd=dataset.parent).returncode == 0
    (made,) = dataset.glob(name)
    assert not list(dataset.parent.glob("*.*"))
    made.write_text("mine")
    again = run_command(*command, cwd=dataset.parent)
    assert again.returncode == 2 and "is there already" in again.stderr and "--replace" in again.stderr
    assert made.read_text() == "mine"
    assert run_command(*command, "--replace", cwd=dataset.parent).returncode == 0
    assert made.read_bytes() != b"mine"
    verified = run_command("verify", "room", "--full", cwd=dataset.parent)
    assert verified.returncode == 0


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("export", "wav", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*/*_0.wav"),
        (("nav", "sounds", "--out", "out"), "out/telephone.wav"),
    ],
)  # fmt: skip
def test_files_in_folders_are_not_replaced_unasked(
    dataset: Path, command: tuple[str, ...], name: str
) -> None:
    check_files_are_kept(dataset, command, name)


def check_files_are_kept(dataset: Path, command: tuple[str, ...], name: str) -> None:
    """What a command on a dataset writes is there, and is written over with `--replace` alone."""
    (dataset.parent / "pairs.txt").write_text("1 0\n")
    first = run_command(*command, cwd=dataset.parent)
    assert first.returncode == 0, first.stderr
    made = next(dataset.parent.glob(name))
    made.write_text("mine")
    again = run_command(*command, cwd=dataset.parent)
    assert again.returncode == 2 and "is there already" in again.stderr and "--replace" in again.stderr
    assert made.read_text() == "mine"
    assert run_command(*command, "--replace", cwd=dataset.parent).returncode == 0
    assert made.read_bytes() != b"mine"
