"""Scripts with the calls of genuine clients run as they are."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from neighbours.rlr_audio_propagation.tests.clients import checkouts, run
from neighbours.rlr_audio_propagation.tests.clients.data import (
    write_tree,
)
from neighbours.rlr_audio_propagation.tests.clients.table import (
    CLIENTS,
    FOLDER,
    run_script,
)
from tests.marks import ci_slow

HERE = Path(__file__).resolve().parents[1]
ROOT = HERE.parents[1]
PATH = os.pathsep.join(map(str, (ROOT, HERE / "src")))


def test_the_page_lists_the_scripts_that_are_run() -> None:
    files = {p.stem for p in FOLDER.glob("*.py")} - {"__init__"}
    assert files == set(CLIENTS)
    page = (HERE / "README.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)\.py` \| .* \| (yes|no)\b", page, re.MULTILINE))
    assert rows == {name: "yes" if client.genuine else "no" for name, client in CLIENTS.items()}
    own = {p.stem for p in checkouts.FOLDER.glob("*.py")} - {"__init__"}
    assert own == set(checkouts.CLIENTS)
    for source in checkouts.SOURCES.values():
        assert source.commit[:10] in page


@ci_slow
def test_a_client_runs_from_the_command_line(tmp_path: Path) -> None:
    write_tree(tmp_path)
    assert run_script([sys.executable], "minimal_example", tmp_path, {"PYTHONPATH": PATH}) == ""
    for arguments, said in (([], "no script given"), (["nowhere.py"], "nowhere.py")):
        command = [sys.executable, "-m", "soundspaces_rlr", *arguments]
        done = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": PATH}
        )
        assert done.returncode == 2
        assert said in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", CLIENTS)
def test_scripts_with_the_calls_of_clients_run(name: str, tmp_path: Path) -> None:
    write_tree(tmp_path)
    assert run_script([sys.executable], name, tmp_path, {"PYTHONPATH": PATH}) == ""


def test_what_cannot_be_had_is_left_out_with_a_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without AudibleLight's repository, or without a CPU build of PyTorch, the scripts alone decide."""

    def no_build(*_: object) -> list[str]:
        raise LookupError("no CPU build of PyTorch on any index")

    monkeypatch.setattr(run, "ROOT", tmp_path)
    monkeypatch.setattr(run, "_wheels", list)
    monkeypatch.setattr(run, "_environment", lambda *_: Path(sys.executable))
    monkeypatch.setattr(sys, "argv", ["run"])
    nowhere = checkouts.Source(str(tmp_path / "nowhere"), "0" * 40)
    monkeypatch.setattr(checkouts, "SOURCES", dict.fromkeys(checkouts.SOURCES, nowhere))
    for failed in (0, 2):
        monkeypatch.setattr(run, "run_scripts", lambda *_, failed=failed: failed)
        monkeypatch.setattr(run, "REPOSITORY", str(tmp_path / "nowhere"))
        assert run.main() == min(failed, 1)
        said = capsys.readouterr().out
        assert "AudibleLight's tests are left out: cannot clone" in said
        assert (
            said.count("left out  ") == len(checkouts.CLIENTS) and said.count("nowhere; SOURCES=") == 3
        )
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / run.FILES[0]).touch()
    monkeypatch.setattr(sys, "argv", ["run", "--checkout", str(tmp_path)])
    monkeypatch.setattr("pipelines.torch_cpu.arguments", no_build)
    assert run.main() == 1
    assert "left out: no CPU build of PyTorch" in capsys.readouterr().out
