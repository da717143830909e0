"""`soundspaces-sim nav …`, and the episodes that an export writes beside responses."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.cli.app import app
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episodes import read_episodes
from tests.marks import ci_slow


def run(*arguments: object) -> str:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, (result.output, result.exception)
    return result.output


def refusal(*arguments: object) -> str:
    """The message of an error of ours."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert isinstance(result.exception, ss.SoundSpacesSimError), (result.output, result.exception)
    return str(result.exception)


def test_episodes_are_made(data: NavData, tmp_path: Path) -> None:
    text = run(
        "nav", "episodes", data.root, "--count", 6, "--split", "test", "--seed", 3, "--out", tmp_path
    )
    folder = tmp_path / "replica" / "v1" / "test"
    assert "6 episodes in 1 scenes" in text and len(read_episodes(folder, data)) == 6


@ci_slow
def test_an_export_holds_episodes_too(data: NavData, tmp_path: Path) -> None:
    """`datasets`, `metadata` and `binaural_rirs` side by side, as SoundSpaces' configuration looks for them."""
    run(
        "export",
        "soundspaces-v1",
        data.root,
        "--out",
        tmp_path,
        "--heading",
        0,
        "--no-ambisonics",
        "--episodes",
        4,
    )
    assert {p.name for p in tmp_path.iterdir()} == {"binaural_rirs", "datasets", "metadata"}
    for split, scene in (("train", "ladder"), ("test", "tee")):
        folder = tmp_path / "datasets" / "audionav" / "replica" / "v1" / split
        assert (folder / f"{split}.json.gz").is_file()
        assert {e.scene for e in read_episodes(folder, data)} == {scene}
    assert "belongs to soundspaces-v1" in refusal("export", "wav", data.root, "--episodes", 4)


def test_the_bank_of_sounds_can_be_heard(tmp_path: Path) -> None:
    text = run("nav", "sounds", "--out", tmp_path)
    assert "train (73): telephone" in text and "val (11)" in text and "test (18)" in text
    assert len(list(tmp_path.glob("*.wav"))) == 102


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("episodes", "nowhere"), "no dataset in a folder in nowhere; make one with"),
        (("episodes", "{}", "--split", "tset"), "split 'tset' is not in .*did you mean 'test'"),
        (("episodes", "{}", "--layout", "hm3d"), "--layout: expected replica or mp3d, got 'hm3d'"),
        (
            ("episodes", "{}", "--sounds", "phone"),
            "sound 'phone' is not in the bank.*did you mean 'telephone'",
        ),
    ],
)
def test_what_is_wrong_is_said_in_a_line(
    data: NavData, arguments: tuple[str, ...], message: str
) -> None:
    text = refusal("nav", *(a.format(data.root) for a in arguments))
    assert re.search(message, text) and "\n" not in text
