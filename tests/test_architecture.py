"""What the documents name is there, and every folder of tests is run."""

import re
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def test_files_that_the_documents_name_are_there() -> None:
    """Links and paths of the README, CONTRIBUTING, SECURITY and docs/; names in capitals stand for files to
    come."""
    own = [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY")]
    for page in (*own, *(ROOT / "docs").glob("*.md"), *(ROOT / "notes").glob("*.md")):
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
