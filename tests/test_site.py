"""The documentation as a site: every page is in its menu, once, and shows what it should without the network."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
CONFIG = yaml.safe_load((ROOT / "mkdocs.yml").read_text("utf-8"))


def _pages(menu: Any) -> list[str]:
    """Files that a part of the menu leads to."""
    if isinstance(menu, str):
        return [menu]
    parts = menu.values() if isinstance(menu, dict) else menu
    return [page for part in parts for page in _pages(part)]


def test_every_page_is_in_the_menu_once() -> None:
    there = {p.relative_to(DOCS).as_posix() for kind in ("md", "ipynb") for p in DOCS.rglob(f"*.{kind}")}
    assert sorted(_pages(CONFIG["nav"])) == sorted(there)


def test_extras_that_the_page_on_installing_names_are_those_there_are() -> None:
    import tomllib

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"][
        "optional-dependencies"
    ]
    rows = re.findall(r"^\| (`.+?) \|", (DOCS / "install.md").read_text("utf-8"), re.MULTILINE)
    named = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert sorted(named) == sorted(extras)


def test_the_diagram_of_rooms_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    import site_hooks  # type: ignore[import-not-found]

    page = SimpleNamespace(file=SimpleNamespace(abs_src_path=str(DOCS / "architecture.md")))
    text = (DOCS / "architecture.md").read_text("utf-8")
    made = site_hooks.on_page_markdown(text, page)
    assert "```mermaid" in text and "mermaid" not in made and "flowchart" not in made
    assert made.count("<svg") == 1 and "\n\n" not in made[made.index("<svg") : made.index("</svg>")]
    assert "[clusters.md](clusters.md)" in made  # links within the site stay
    assert "](../" not in made and "data_schema/" in made  # those out of it are text


def test_the_site_builds(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the extra 'docs' is not installed")
    pytest.importorskip("mkdocs_jupyter", reason="the extra 'docs' is not installed")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    notebook = (tmp_path / "site" / "notebooks" / "1_first_rir" / "index.html").read_text("utf-8")
    assert "Out[1]" in notebook and "data:image/png;base64," in notebook  # with what it printed and drew
    api = (tmp_path / "site" / "api" / "index.html").read_text("utf-8")
    signatures = [
        re.sub(r"<[^>]+>", "", found)
        for found in re.findall(r'<div class="doc-signature highlight">(.*?)</div>', api, re.DOTALL)
    ]
    assert len(signatures) > 30
    assert max(len(line) for text in signatures for line in text.splitlines()) < 100  # none is cut off
    assert any(text.startswith("load_scene(\n    source: ") for text in signatures)
    for html in (tmp_path / "site").rglob("*.html"):
        text = html.read_text("utf-8")
        assert not re.findall(r'<(?:script|img)[^>]+src="(?:https?:)?//', text), html
        assert not re.findall(r'<link[^>]+rel="stylesheet"[^>]+href="(?:https?:)?//', text), html
