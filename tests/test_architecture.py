"""The picture of the rooms is that of the code, and what the documents name is there."""

import ast
import re
from fnmatch import fnmatch
from itertools import pairwise
from pathlib import Path

import networkx as nx
import pytest

from tests.architecture import importers_of, named, rooms, table

ROOT = Path(__file__).resolve().parents[1]


def _picture() -> nx.DiGraph:
    """The arrows of the diagram: ``a & b --> c & d``."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    (diagram,) = re.findall(r"```mermaid\n(.*?)```", text, re.DOTALL)
    rooms = nx.DiGraph()
    for line in diagram.splitlines():
        stages = [[name.strip() for name in part.split("&")] for part in line.split("-->")]
        for tails, heads in pairwise(stages):
            rooms.add_edges_from((a, b) for a in tails for b in heads)
    return rooms


def test_the_picture_has_the_arrows_of_the_code_and_no_others() -> None:
    """It shows the fewest arrows from which all imports between rooms follow."""
    code = rooms()
    code.remove_nodes_from(("benchmarks", "pipelines"))
    assert set(_picture().edges) == set(nx.transitive_reduction(code).edges)


def test_the_structure_keeps_its_aims() -> None:
    missed = {row.what: row.found for row in table() if not row.value <= row.aim}
    assert not missed


def test_imports_by_name_are_counted() -> None:
    """Under any name of the function; of a name that is put together, all that is known is that there is one."""
    tree = ast.parse(
        "from soundspaces_sim.core.registry import load as get\n"
        "get('soundspaces_sim.rlr.api:Context'), get(f'{ROOM}.api'), load('soundspaces_sim.rlr.api'), get('h5py')\n"
        "importlib.import_module('soundspaces_sim.rlr.api')\n"
    )
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    names = importers_of(tree)
    found = [named(call) for call in calls if ast.unparse(call.func).split(".")[-1] in names]
    assert sorted(target for targets in found for target in targets) == [
        "?", "soundspaces_sim.rlr.api", "soundspaces_sim.rlr.api",
    ]  # fmt: skip


def test_files_that_the_documents_name_are_there() -> None:
    """Links and paths of the README, CONTRIBUTING, SECURITY and docs/; names in capitals stand for files to
    come."""
    own = [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY")]
    for page in (*own, *(ROOT / "docs").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        links = [page.parent / link.split("#")[0] for link in re.findall(r"\]\(([^):]+)\)", text)]
        paths = [
            ROOT / path
            for path in re.findall(
                r"`((?:soundspaces_sim|tests|docs|pipelines|data_schema)/[\w./]+)`", text
            )
            if "NAME" not in path
        ]
        missing = [str(path) for path in (*links, *paths) if not path.exists()]
        assert not missing, (page.name, missing)


def test_no_folder_of_tests_is_left_out(request: pytest.FixtureRequest) -> None:
    """By default pytest enters no folder that is named build."""
    skipped = request.config.getini("norecursedirs")
    folders = {path.parent for path in Path(__file__).parent.rglob("test_*.py")}
    names = {part for folder in folders for part in folder.relative_to(Path(__file__).parent).parts}
    assert "build" in names
    assert [name for name in names for pattern in skipped if fnmatch(name, pattern)] == []
