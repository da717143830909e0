"""The command line as a whole: help, version, options that commands share."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.cli import neighbours
from soundspaces_sim.cli.app import app
from tests.command_line import run_command

SCENE_OPTIONS = (
    "--materials",
    "--labels",
    "--up",
    "--unit",
    "--strict-materials",
    "--no-ceiling",
    "--decimate",
)


def _help(*command: str) -> str:
    result = CliRunner(env={"COLUMNS": "200", "NO_COLOR": "1"}).invoke(app, [*command, "--help"])
    assert result.exit_code == 0, result.output
    return result.output


def test_help_lists_the_commands() -> None:
    text = _help()
    for command in (
        "rirs",
        "plan",
        "status",
        "finish",
        "inspect",
        "verify",
        "table",
        "export",
        "plot",
        "listen",
    ):
        assert f" {command} " in text


@pytest.mark.parametrize("command", ["rirs", "plan", "inspect"])
def test_scene_options_are_those_of_load_scene(command: str) -> None:
    text = _help(command)
    for option in SCENE_OPTIONS:
        assert option in text


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("export", "soundspaces-v1, sofa, huggingface, lhotse, ambisonics, iso3382, wav or webdataset"),
        ("rirs", "Engine that runs the tiles: local, dask, slurm or ray"),
    ],
)
def test_help_lists_what_is_registered(command: str, names: str) -> None:
    assert names in _help(command)


def test_version_and_help_load_nothing_that_computes(tmp_path: Path) -> None:
    script = (
        "import sys; from soundspaces_sim.cli import main\n"
        "try: main()\n"
        "except SystemExit as e: assert not e.code, e.code\n"
        "assert not {'numba', 'scipy', 'embreex', 'matplotlib', 'h5py'} & set(sys.modules)"
    )
    for option in ("--version", "--help"):
        done = subprocess.run(
            [sys.executable, "-c", script, option], cwd=tmp_path, capture_output=True, text=True,
            env={"PYTHONPATH": str(Path(ss.__file__).parents[1])},
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        if option == "--version":
            assert re.fullmatch(rf"soundspaces-sim {ss.__version__}( \(commit \S+\))?\n", done.stdout)


def test_scene_options_reach_the_scene(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text("this is not TOML")
    for arguments in (["inspect", "demo", "--materials", "own.toml"], ["rirs", "demo", "--up", "x"]):
        done = run_command(*arguments, cwd=tmp_path)
        assert done.returncode == 2 and ("own.toml" in done.stderr or "up:" in done.stderr)


def test_a_neighbours_command_is_handed_over_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By an entry point of a distribution of its own, with all that follows the command; else it is said."""
    found: list[EntryPoint] = []  # whatever is installed beside the package
    monkeypatch.setattr("soundspaces_sim.core.registry.entry_points", lambda **_: found)
    with pytest.raises(ss.ConfigError, match="not installed"):
        raise CliRunner().invoke(app, ["explore", "demo"]).exception or AssertionError
    found.append(EntryPoint("explore", "some_explorer:app", neighbours.GROUP))
    (tmp_path / "some_explorer.py").write_text(
        "import typer\napp = typer.Typer()\n@app.command()\n"
        "def explore(scene: str, port: int = 0) -> None:\n    print(scene, port)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    done = CliRunner().invoke(app, ["explore", "demo", "--port", "7"])
    assert done.exit_code == 0 and done.output == "demo 7\n"
    assert "--port" in CliRunner().invoke(app, ["explore", "--help"]).output
