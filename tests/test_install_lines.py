"""What is said of installing works from a clone: the package is on no index."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from soundspaces_sim.core.extras import install_hint

_ROOT = Path(__file__).parents[1]
_KINDS = (".py", ".md", ".ipynb", ".toml", ".yml")


def _texts() -> dict[str, str]:
    folders = ("soundspaces_sim", "neighbours", "docs", "benchmarks", "pipelines")
    files = [f for folder in folders for f in (_ROOT / folder).rglob("*") if f.suffix in _KINDS]
    return {
        str(f.relative_to(_ROOT)): f.read_text("utf-8")
        for f in (*files, *_ROOT.glob("*.md"))
        if "hrtf_data" not in f.parts
    }


def test_no_line_installs_from_an_index() -> None:
    wrong = [
        name
        for name, text in _texts().items()
        if re.search(r"pip install [\"']?soundspaces[-_]sim", text)
    ]
    assert wrong == []


def test_extras_that_are_named_exist() -> None:
    extras = tomllib.loads((_ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = {
        extra
        for text in _texts().values()
        for extra in re.findall(r"install_hint\(['\"](\w+)['\"]\)|-e '\.\[(\w+)\]'", text)
        for extra in extra
        if extra
    }
    assert len(named) > 8 and named <= set(extras)
    assert install_hint("nav") == "`pip install -e '.[nav]'` in a clone of soundspaces_sim"
