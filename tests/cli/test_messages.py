"""What the command line refuses, and whom it blames."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.cli.app import app


def _fails(*arguments: str) -> str:
    """The message of an error of ours."""
    result = CliRunner().invoke(app, [*arguments])
    assert isinstance(result.exception, ss.SoundSpacesSimError), (result.output, result.exception)
    return str(result.exception)


@pytest.mark.parametrize(
    ("flag", "value", "message"),
    [
        ("--spacing", "-1", "--spacing -1.0: grid.spacing: expected 0.001 to 1000 m, got -1.0"),
        ("--rate", "7", "--rate 7: dataset.rate: expected 8000 to 192000 Hz, a whole number, got 7"),
        ("--seed", "99999999999999999999999", "--seed 99999999999999999999999: dataset.seed: expected 0 to 2^63 - 1"),
        ("--seed", "-1", "--seed -1: dataset.seed"),
        ("--walks", "0", "--walks 0: simulation.walks: expected 1 to 1,000,000, got 0"),
        ("--bands", "octave", "--bands octave: bands: expected paper, octaves, thirds, or edges in Hz"),
        ("--bands", "200,100", "--bands 200,100: bands: expected two or more increasing edges"),
        ("--store", "tape", "--store tape: dataset.store: expected echogram, waveform or both, got 'tape'"),
        ("--engine", "steam", "engine: expected local, dask, slurm or ray, got 'steam'"),
    ],
)  # fmt: skip
def test_a_flag_is_blamed_for_a_flag(tmp_path: Path, flag: str, value: str, message: str) -> None:
    config = tmp_path / "own.toml"
    config.write_text("[simulation]\nwalks = 16\n")
    text = _fails("rirs", "demo", "--config", str(config), "--out", str(tmp_path), flag, value)
    assert text.startswith(message) and "own.toml" not in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[grid]\nspacing = -1\n", "grid.spacing: expected 0.001 to 1000 m"),
        (
            "[dataset]\nstore = 'tape'\n",
            "dataset.store: expected echogram, waveform or both, got 'tape'",
        ),
        ("[simulation]\nwalk = 3\n", "simulation.walk: there is no such setting; did you mean walks?"),
        ("[simulaton]\nwalks = 3\n", "simulaton: there is no such setting; did you mean simulation?"),
        ("[simulation]\nwalks = 'many'\n", "simulation.walks: expected `int`, got `str` ('many')"),
    ],
)
def test_a_file_is_blamed_for_a_file(tmp_path: Path, text: str, message: str) -> None:
    config = tmp_path / "own.toml"
    config.write_text(text)
    found = _fails("rirs", "demo", "--config", str(config), "--spacing", "4", "--out", str(tmp_path))
    assert found.startswith(f"{config}: {message}")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("export", "mp3", "."),
            "layout: expected soundspaces-v1, sofa, huggingface, lhotse, ambisonics, iso3382, wav or webdataset, got 'mp3'",
        ),
        (("export", "wav", ".", "--name", "mp3d"), "name: layout wav has no such option"),
        (("export", "wav", ".", "--renderer", "x"), "--renderer: expected default, smooth, paper or direct, got 'x'"),
        (("export", "wav", ".", "--hrtf", "missing.sofa"), "missing.sofa: cannot open this SOFA file"),
        (("export", "sofa", ".", "--heading", "0"), "--heading: layout sofa has no such option; it has: .*pairs"),
        (("export", "wav", ".", "--heading", "nan"), "--heading: expected different degrees from 0 to below 360, got"),
        (("rirs", "demo", "--out", "/dev/null/x"), "--out /dev/null/x: expected a folder, but /dev/null is none"),
        (("export", "wav", "gone", "--out", "/dev/null/x"), "--out /dev/null/x: expected a folder"),
        (("table", "gone", "--out", "t.xls"), r"--out t\.xls: expected a name that ends in \.csv, \.parquet"),
        (("table", "gone", "--out", "nowhere/t.csv"), "--out nowhere/t.csv: there is no folder nowhere"),
        (("export", "wav", ".", "--rate", "0"), "--rate: expected 8000 to 192000 Hz, a whole number, got 0"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_at_once(arguments: tuple[str, ...], message: str) -> None:
    assert re.search(message, _fails(*arguments))


def test_lines_of_progress_off_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """A line at every tenth, whatever the number of steps, each with what is left."""
    from soundspaces_sim.cli.console import Meter

    with Meter("Writing") as meter:
        for done in range(1, 1001):
            meter.update(done, 1000, "so much")
    lines = capsys.readouterr().err.splitlines()
    assert [line.split("%")[0] for line in lines] == [f"Writing: {k} " for k in range(10, 101, 10)]
    assert "so much, about 1 s left" in lines[3] and "left" not in lines[-1]
    with Meter("Reading") as meter:
        meter.stage("Placing points")
        meter.update(0, 0)
    assert capsys.readouterr().err == "Placing points …\n"


def test_inspect_of_a_scene_without_a_place_to_stand(tmp_path: Path) -> None:
    """A floor without walls: the report is printed, and the exit code is not that of success."""
    (tmp_path / "floor.obj").write_text("v 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nf 1 2 3\nf 1 3 4\n")
    result = CliRunner().invoke(
        app, ["inspect", str(tmp_path / "floor.obj"), "--up", "z", "--unit", "m", "--no-ceiling"]
    )
    assert result.exit_code == 1 and "0 storey(s)" in result.stdout
    assert "floor: `rirs` has nothing to do here: no grid point survives" in result.stderr
