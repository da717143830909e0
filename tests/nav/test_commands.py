"""`soundspaces-sim nav …`, and the episodes that an export writes beside responses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.cli.app import app
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episodes import read_episodes
from soundspaces_sim.nav.evaluate import load_result
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


def measures(text: str) -> list[str]:
    """The lines of means and intervals that `nav eval` prints."""
    return [line for line in text.splitlines() if line.startswith("  ") and line.endswith("]")]


def test_episodes_are_made_and_walked(data: NavData, tmp_path: Path) -> None:
    text = run(
        "nav", "episodes", data.root, "--count", 6, "--split", "test", "--seed", 3, "--out", tmp_path
    )
    folder = tmp_path / "replica" / "v1" / "test"
    assert "6 episodes in 1 scenes" in text and len(read_episodes(folder, data)) == 6
    options = ("--split", "test", "--episodes", folder, "--max-steps", 60)
    text = run(
        "nav", "eval", data.root, "--agent", "Oracle", *options, "--out", tmp_path / "oracle.json"
    )
    assert "spl                         1.000 [1.000, 1.000]" in text
    assert (load_result(tmp_path / "oracle.json").rows["spl"] == 1.0).all()
    own, default, direct = (
        measures(run("nav", "eval", data.root, *options, *how))
        for how in ((), ("--renderer", "default"), ("--renderer", "direct"))
    )
    assert own == default != direct and len(own) == 10
    pytest.importorskip("matplotlib", reason="the extra `figures` is not installed")
    text = run("nav", "replay", data.root, "--agent", "Oracle", *options, "--out", tmp_path / "replays")
    (gif,) = (tmp_path / "replays").glob("*.gif")
    sound, rate = soundfile.read(gif.with_suffix(".wav"))
    assert sound.shape == (len(sound), 2) and len(sound) % rate == 0 and np.abs(sound).max() > 0.5


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


def test_flats_are_drawn(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image", reason="the extra `figures` is not installed")
    run("nav", "flats", "--count", 2, "--first", 5, "--out", tmp_path / "page.png")
    picture = image.open(tmp_path / "page.png")
    assert picture.size[0] > 6 * 200 and len(picture.getcolors(256)) > 50


def test_the_bank_of_sounds_can_be_heard(tmp_path: Path) -> None:
    text = run("nav", "sounds", "--out", tmp_path)
    assert "train (73): telephone" in text and "val (11)" in text and "test (18)" in text
    assert len(list(tmp_path.glob("*.wav"))) == 102


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("eval", "{}", "--agent", "Orakel"), "neither a checkpoint nor one of.*did you mean 'Oracle'"),
        (("eval", "{}", "--split", "tset"), "split 'tset' is not in .*did you mean 'test'"),
        (
            ("eval", "{}", "--renderer", "dircet"),
            "--renderer: expected default, smooth, paper or direct, got 'dircet'",
        ),
        (("run", "--flats", "8,1"), "--flats: expected three numbers with commas between.*got '8,1'"),
        (("eval", "nowhere"), "no dataset in a folder in nowhere; make one with"),
        (("episodes", "{}", "--layout", "hm3d"), "--layout: expected replica or mp3d, got 'hm3d'"),
        (
            ("episodes", "{}", "--sounds", "phone"),
            "sound 'phone' is not in the bank.*did you mean 'telephone'",
        ),
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
    import re

    text = refusal("nav", *(a.format(data.root) for a in arguments))
    assert re.search(message, text) and "\n" not in text
