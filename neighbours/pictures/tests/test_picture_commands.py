"""`plot`, `listen` and `report` at the command line: what they refuse, and where they write."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

from soundspaces_sim.cli.app import app
from tests.command_line import run_command


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("plot", "demo", "--what", "map", "--animate", "--out", "p.png"), "--animate: only --what field"),
        (("plot", "demo", "--animate", "--out", "p.png"), r"--out p\.png: expected a name that ends in \.gif"),
        (("plot", "demo", "--animate", "--source", "3"), "--animate moves the source"),
        (("plot", "demo", "--print", "poster"), "--print: expected column or page, got 'poster'"),
        (("plot", "demo", "--out", "p.xyz"), r"ends in \.png, \.svg, \.pdf"),
        (("plot", "demo", "--out", "nowhere/p.png"), "there is no folder nowhere"),
        (("plot", "demo", "--what", "portrait"), "--what: expected map, field, overview, lobes, decay, rir, parameter, modes or error"),
        (("listen", ".", "--renderer", "x"), "--renderer: expected default, smooth, paper or direct, got 'x'"),
        (("report", "gone", "--out", "nowhere/t.html"), "--out nowhere/t.html: there is no folder nowhere"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_at_once(
    tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    ended = run_command(*arguments, cwd=tmp_path)
    assert ended.returncode == 2 and re.search(message, ended.stderr)


def test_help_lists_the_pages() -> None:
    text = CliRunner(env={"COLUMNS": "200", "NO_COLOR": "1"}).invoke(app, ["plot", "--help"]).output
    assert "map, field, overview, lobes, decay, rir, parameter, modes or error" in text


def test_pictures_go_beside_a_dataset_and_are_not_replaced_unasked(
    dataset_folder: Path, tmp_path: Path
) -> None:
    run = partial(run_command, cwd=tmp_path)
    plot = ["plot", str(dataset_folder), "--what", "map", "--out", "map.png"]
    assert run(*plot).returncode == 0
    again = run(*plot)
    assert again.returncode == 2 and "is there already" in again.stderr
    assert run(*plot, "--replace").returncode == 0
    assert "is a dataset" in run("listen", str(dataset_folder), "--out", str(dataset_folder)).stderr
