"""Fixtures of the neighbours' tests: those of the core's, and their sources on the path of what they start."""

import os
import sys
import tomllib
from pathlib import Path

import pytest

from soundspaces_sim.scene import formats
from tests.conftest import (
    dataset_folder as dataset_folder,
    echogram as echogram,
    own_cache as own_cache,
    own_cores as own_cores,
    shared as shared,
    small_scene as small_scene,
)

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session", autouse=True)
def sources_on_the_path(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Tests, and programs that they start, find the neighbours and their entry points, installed or not."""
    installed = tmp_path_factory.mktemp("installed")
    for file in sorted(ROOT.glob("neighbours/*/pyproject.toml")):
        project = tomllib.loads(file.read_text("utf-8"))["project"]
        name = project["name"].replace("-", "_")  # a hyphen ends a name
        info = installed / f"{name}-{project['version']}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n")
        lines = [
            f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in entries.items())
            for group, entries in project.get("entry-points", {}).items()
        ]
        (info / "entry_points.txt").write_text("".join(lines))
    sys.path.insert(0, str(installed))
    formats.neighbours.cache_clear()
    found = [ROOT, installed, *sorted(ROOT.glob("neighbours/*/src"))]
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([*map(str, found), *([before] if before else [])])
