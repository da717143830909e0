"""Processes that we start import nothing from the current folder: a stranger's file may have a module's name."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import soundspaces_sim
from soundspaces_sim.core.processes import isolated_children
from tests.marks import few

_NAMES = (
    "struct",
    "numpy",
    "json",
    "random",
    "socket",
    "ssl",
    "loky",
    "h5py",
    "soundspaces_sim",
    "submitit",
    "pip",
)
CHILDREN = {
    "compiling ahead": """
from soundspaces_sim.build.warm_up import _child
child = _child(["direct"])
child.stdout.readline()
child.kill()
""",
    "processes of a job, of rooms and of agents": """
from soundspaces_sim.core.processes import worker_pool
with worker_pool(2) as pool:
    assert list(pool.map(len, ["a", "bb", "ccc"])) == [1, 2, 3]
""",
}


@pytest.mark.parametrize("kind", few(CHILDREN, "processes of a job, of rooms and of agents"))
def test_a_stranger_s_module_is_not_run(kind: str, tmp_path: Path) -> None:
    check_isolated(CHILDREN[kind], tmp_path)


def check_isolated(code: str, folder: Path, *sources: Path) -> None:
    """Run code that starts processes beside files with modules' names; `sources`: further places of modules."""
    here, packages = folder / "files", folder / "packages"
    here.mkdir()
    packages.mkdir()
    (packages / "ifcopenshell.py").write_text("raise RuntimeError('this ifcopenshell reads nothing')")
    for name in _NAMES:
        (here / f"{name}.py").write_text(f"open({str(folder / 'was-run')!r}, 'a').write(__name__)")
    script = folder / "script.py"
    script.write_text("from pathlib import Path\n" + code)
    path = [Path(soundspaces_sim.__file__).parents[1], *sources, packages]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path))}
    env.pop("PYTHONSAFEPATH", None)
    done = subprocess.run(
        [sys.executable, script], cwd=here, env=env, capture_output=True, text=True, timeout=120
    )
    ran = folder / "was-run"
    assert not ran.exists(), ran.read_text()
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("before", [None, "", "1"])
def test_the_environment_is_as_before(monkeypatch: pytest.MonkeyPatch, before: str | None) -> None:
    name = "PYTHONSAFEPATH"
    if before is None:
        monkeypatch.delenv(name, raising=False)
    else:
        monkeypatch.setenv(name, before)
    first, second = isolated_children(), isolated_children()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)  # in any order, as generators end
    assert os.environ[name] == "1"
    second.__exit__(None, None, None)
    assert os.environ.get(name) == before
