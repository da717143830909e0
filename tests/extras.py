"""`make test-extras`: the tests that `make test` skips for want of extras, in an environment of their own.

    python3 -m tests.extras [--environment .venv-extras] [--torch-index URL] [GROUP …]

Each group of tests is installed on its own: a group whose packages no index has, or whose program is not on the
path, is skipped with a line that gives the reason. A group that was installed fails if any of its tests is
still skipped because something is not installed. Of PyTorch only the CPU build is taken (torch …+cpu; on macOS
the plain one), from `--torch-index` where that can be reached, and from the indexes that pip is configured
with.

Each group's seconds are printed. Measured on 2026-11-22 on two cores under a load of 18: IFC's tests 33 s, Ray's
installation and start 76 s, the browser's with kernels compiled anew 27 minutes; on a quiet machine not yet.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from pipelines import torch_cpu

ROOT = Path(__file__).resolve().parents[1]
#: What a skipped test says when a package is absent that a group should have installed.
_ABSENT = re.compile(r"not installed|could not import|needs ifcopenshell", re.IGNORECASE)


class SkippedError(Exception):
    """A group that cannot run here, and why."""


@dataclass(frozen=True)
class Group:
    """Extras of pyproject.toml, `packages` that are no extra, the tests that need them, and what must be there before
    anything is installed; `slow`: those of them that are marked so run as well."""

    extras: str
    tests: tuple[str, ...]
    select: str = ""
    check: Callable[[], None] = lambda: None
    torch: bool = False
    slow: bool = False
    packages: tuple[str, ...] = ()


def check_browser() -> None:
    """Raises `SkippedError` where there is no Chromium."""
    if not (os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")):
        raise SkippedError("no Chromium on the path (CHROMIUM names another)")


GROUPS = {
    "ifc": Group("ifc", ("neighbours/scene_formats/tests/test_building_files.py",), "ifc"),
    "browser": Group(
        "browser",
        ("neighbours/explorer/tests/test_page.py", "neighbours/explorer/tests/test_firefox.py"),
        check=check_browser,
    ),
    "ray": Group(
        "",
        ("neighbours/clusters/tests/test_clusters.py::test_ray_here",),
        packages=("ray>=2.45",),
        slow=True,
    ),
    "learning": Group(
        "torch",
        (
            "neighbours/agents/tests/test_learn.py",
            "neighbours/agents/tests/test_study.py",
            "neighbours/agents/tests/test_continuous_learning.py",
            "neighbours/tasks/tests/test_tasks.py",
            "neighbours/torch/tests/test_torch.py",
            "neighbours/torch/tests/test_random_materials.py",
            "neighbours/torch/tests/test_renderer.py",
            "neighbours/torch/tests/test_reverberate.py",
            "neighbours/rooms/tests/test_torch_rooms.py",
            "tests/test_readme.py::test_documentation_runs",
            "tests/test_readme.py::test_python_of_a_row_runs",
            "tests/nav/test_env.py",
        ),
        torch=True,
        packages=("stable-baselines3>=2.7",),
    ),
    "ptx": Group("", ("tests/scene/test_ptx.py",), packages=("numba-cuda[cu13]",)),
}


def _pip(python: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [str(python), "-m", "pip", "--disable-pip-version-check", *arguments]
    return subprocess.run(command, cwd=ROOT, text=True, capture_output=True)


def _install(python: Path, *what: str) -> None:
    """Raises `SkippedError` with pip's own words where something cannot be had."""
    done = _pip(python, "install", "--quiet", *what)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
        raise SkippedError((lines or done.stderr.strip().splitlines() or ["pip failed"])[-1])


def install(python: Path, group: Group, torch_index: str) -> None:
    """Install what a group needs; raises `SkippedError` where that cannot be done."""
    group.check()
    if group.torch:
        try:
            _install(python, *torch_cpu.arguments(str(python), torch_index))
        except LookupError as why:
            raise SkippedError(str(why)) from None
    _install(python, *group.packages, "-e", f".[{group.extras}]" if group.extras else ".")


def absent(results: Path) -> list[str]:
    """Tests in a JUnit file that were skipped because something is not installed, with their messages."""
    found = []
    for case in ElementTree.parse(results).iter("testcase"):
        messages = [str(child.get("message")) for child in case if child.tag == "skipped"]
        found += [f"{case.get('name')}: {m}" for m in messages if _ABSENT.search(m)]
    return found


def run(python: Path, group: Group) -> bool:
    """Whether a group's tests pass, with none left out for want of a package."""
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / "results.xml"
        select = [*(("-k", group.select) if group.select else ()), *(("-m", "") if group.slow else ())]
        command = [str(python), "-m", "pytest", f"--junitxml={results}", *select, *group.tests]
        done = subprocess.run(command, cwd=ROOT)
        missing = absent(results) if results.is_file() else ["pytest wrote no results"]
    for line in missing:
        print(f"skipped although its group is installed: {line}", flush=True)
    return done.returncode == 0 and not missing


def main() -> int:
    """Run the groups; 1 where one failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--environment", type=Path, default=ROOT / ".venv-extras")
    parser.add_argument("--torch-index", default=torch_cpu.INDEX)
    parser.add_argument("groups", nargs="*", default=list(GROUPS), metavar="GROUP")
    given = parser.parse_args()
    unknown = sorted(set(given.groups) - set(GROUPS))
    if unknown:
        parser.error(f"groups are {', '.join(GROUPS)}, got {', '.join(unknown)}")
    python = given.environment.resolve() / "bin" / "python"
    if not python.exists():
        venv.create(given.environment, with_pip=True)
    _install(python, "-e", ".[test]")
    ends: dict[str, str] = {}
    for name in given.groups:
        start = time.monotonic()
        try:
            install(python, GROUPS[name], given.torch_index)
        except SkippedError as why:
            ends[name] = f"skipped: {why}"
            continue
        passed = run(python, GROUPS[name])
        ends[name] = f"{'passed' if passed else 'FAILED'} in {time.monotonic() - start:.0f} s"
    print("\n".join(f"{name}: {end}" for name, end in ends.items()))
    return int(any(end.startswith("FAILED") for end in ends.values()))


if __name__ == "__main__":
    sys.exit(main())
