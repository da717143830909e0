"""`soundspaces-agents …`."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import soundfile
from soundspaces_agents.__main__ import app
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episodes import write_episodes
from soundspaces_sim.nav.evaluate import load_result
from soundspaces_sim.nav.generate import make_episodes


def run(*arguments: object) -> str:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, (result.output, result.exception)
    return result.output


def refusal(*arguments: object) -> str:
    """The message of an error of ours."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert isinstance(result.exception, ss.SoundSpacesSimError), (result.output, result.exception)
    return str(result.exception)


def measures(text: str) -> list[str]:
    """The lines of means and intervals that `eval` prints."""
    return [line for line in text.splitlines() if line.startswith("  ") and line.endswith("]")]


def test_agents_are_tested_and_replayed(data: NavData, tmp_path: Path) -> None:
    folder = tmp_path / "replica" / "v1" / "test"
    write_episodes(make_episodes(data, "test", 6, 3), folder)
    options = ("--split", "test", "--episodes", folder, "--max-steps", 60)
    text = run("eval", data.root, "--agent", "Oracle", *options, "--out", tmp_path / "oracle.json")
    assert "spl                         1.000 [1.000, 1.000]" in text
    assert (load_result(tmp_path / "oracle.json").rows["spl"] == 1.0).all()
    own, default, direct = (
        measures(run("eval", data.root, *options, *how))
        for how in ((), ("--renderer", "default"), ("--renderer", "direct"))
    )
    assert own == default != direct and len(own) == 10
    pytest.importorskip("matplotlib", reason="the extra `figures` is not installed")
    text = run("replay", data.root, "--agent", "Oracle", *options, "--out", tmp_path / "replays")
    (gif,) = (tmp_path / "replays").glob("*.gif")
    sound, rate = soundfile.read(gif.with_suffix(".wav"))
    assert sound.shape == (len(sound), 2) and len(sound) % rate == 0 and np.abs(sound).max() > 0.5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("eval", "{}", "--agent", "Orakel"), "neither a checkpoint nor one of.*did you mean 'Oracle'"),
        (("eval", "{}", "--split", "tset"), "split 'tset' is not in .*did you mean 'test'"),
        (
            ("eval", "{}", "--renderer", "dircet"),
            "--renderer: expected default, smooth, paper or direct, got 'dircet'",
        ),
        (("run", "--homes", "8,1"), "--homes: expected three numbers with commas between.*got '8,1'"),
        (("eval", "nowhere"), "no dataset in a folder in nowhere; make one with"),
        (("train", "{}", "--agent", "GA"), "agents: 'GA' is not one of"),
        (
            ("run", "--preset", "smal"),
            "PRESET: expected one of quick, small, paper, got 'smal'; did you mean 'small'",
        ),
        (("report", "{}"), "study.json: cannot read this record of a study"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(
    data: NavData, arguments: tuple[str, ...], message: str
) -> None:
    text = refusal(*(a.format(data.root) for a in arguments))
    assert re.search(message, text) and "\n" not in text
