"""Scripts with the calls of genuine clients run as they are."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.clients.data import write_tree
from tests.clients.table import CLIENTS, FOLDER, run_script

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_lists_the_scripts_that_are_run() -> None:
    files = {p.stem for p in FOLDER.glob("*.py")} - {"__init__"}
    assert files == set(CLIENTS)
    page = (ROOT / "docs" / "rlr.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)\.py` \| .* \| (yes|no)\b", page, re.MULTILINE))
    assert rows == {name: "yes" if client.genuine else "no" for name, client in CLIENTS.items()}


def test_a_client_runs_from_the_command_line(tmp_path: Path) -> None:
    write_tree(tmp_path)
    assert run_script([sys.executable], "minimal_example", tmp_path, {"PYTHONPATH": str(ROOT)}) == ""
    for arguments, said in (([], "no script given"), (["nowhere.py"], "nowhere.py")):
        command = [sys.executable, "-m", "soundspaces_sim.rlr", *arguments]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 2
        assert said in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", CLIENTS)
def test_scripts_with_the_calls_of_clients_run(name: str, tmp_path: Path) -> None:
    write_tree(tmp_path)
    assert run_script([sys.executable], name, tmp_path, {"PYTHONPATH": str(ROOT)}) == ""
