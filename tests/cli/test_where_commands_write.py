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
        ("export", "sofa", "room", "--out", "room/sofa"),
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
        (("export", "sofa", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*.sofa"),
        (("export", "webdataset", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*.tar"),
        (("export", "lhotse", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*/recordings.jsonl.gz"),
        (("export", "huggingface", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*/README.md"),
        (("export", "iso3382", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*/parameters.tsv"),
        (("export", "ambisonics", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*/format.json"),
        (("export", "soundspaces-v1", "room", "--out", "out", "--pairs", "pairs.txt"), "out/metadata/*/*/points.txt"),
        (("nav", "sounds", "--out", "out"), "out/telephone.wav"),
    ],
)  # fmt: skip
def test_files_in_folders_are_not_replaced_unasked(
    dataset: Path, command: tuple[str, ...], name: str
) -> None:
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


def test_exports_share_a_folder_if_their_files_do_not_meet(dataset: Path) -> None:
    (dataset.parent / "pairs.txt").write_text("1 0\n")
    for layout in ("wav", "sofa", "webdataset", "soundspaces-v1"):
        ended = run_command(
            "export", layout, "room", "--out", "out", "--pairs", "pairs.txt", cwd=dataset.parent
        )
        assert ended.returncode == 0, ended.stderr
