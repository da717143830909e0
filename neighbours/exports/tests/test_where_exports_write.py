"""Where exports write, and that nothing is written over unasked."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.test_where_commands_write import check_files_are_kept, dataset as dataset
from tests.command_line import run_command


def test_nothing_is_written_into_a_dataset(dataset: Path) -> None:
    before = {p.name for p in dataset.rglob("*")}
    ended = run_command("export", "sofa", "room", "--out", "room/sofa", cwd=dataset.parent)
    assert ended.returncode == 2 and "room is a dataset" in ended.stderr
    assert {p.name for p in dataset.rglob("*")} == before


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("export", "sofa", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*.sofa"),
        (("export", "webdataset", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*.tar"),
        (("export", "lhotse", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*/recordings.jsonl.gz"),
        (("export", "huggingface", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*/README.md"),
        (("export", "iso3382", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*/parameters.tsv"),
        (("export", "ambisonics", "room", "--out", "out", "--pairs", "pairs.txt"), "out/*/format.json"),
        (("export", "soundspaces-v1", "room", "--out", "out", "--pairs", "pairs.txt"), "out/metadata/*/*/points.txt"),
    ],
)  # fmt: skip
def test_files_in_folders_are_not_replaced_unasked(
    dataset: Path, command: tuple[str, ...], name: str
) -> None:
    check_files_are_kept(dataset, command, name)


def test_exports_share_a_folder_if_their_files_do_not_meet(dataset: Path) -> None:
    (dataset.parent / "pairs.txt").write_text("1 0\n")
    for layout in ("wav", "sofa", "webdataset", "soundspaces-v1"):
        ended = run_command(
            "export", layout, "room", "--out", "out", "--pairs", "pairs.txt", cwd=dataset.parent
        )
        assert ended.returncode == 0, ended.stderr
