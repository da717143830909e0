"""Defaults that pages, the Makefile and pipelines state are those of the code."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.settings_page import settings_page

ROOT = Path(__file__).resolve().parents[1]
JOB = ss.JobConfig()
PAGES = [ROOT / "README.md", ROOT / "Makefile", *sorted((ROOT / "docs").glob("*.md"))]
#: ``[KEY=value]`` in a usage line: the default of that variable of the Makefile.
USAGE = {
    "OUT": "out", "SPACING": f"{JOB.grid.spacing:g}", "RATE": str(JOB.dataset.rate), "WALKS": str(JOB.simulation.walks),
    "STORE": JOB.dataset.store, "CONFIG": "pipelines/default.toml", "ENGINE": "local",
}  # fmt: skip
#: Words of a page and the default that they state.
STATED = {
    r"default settings \(([\d,]+) subpaths": JOB.simulation.walks,
    r"connected subpaths \(the default is (\d+)\)": JOB.simulation.connections.subpaths,
    r"own default is ([\d,]+)\)": JOB.simulation.walks,
    r"by default ([\d, ]+ and [\d ]+)\.": JOB.simulation.bands,
    r"grid spacing is ([\d.]+) m": JOB.grid.spacing,
}


def test_the_page_of_settings_is_that_of_the_code() -> None:
    text = (ROOT / "docs" / "settings.md").read_text("utf-8")
    assert text == settings_page(), (
        "run `python -m soundspaces_sim.core.settings_page > docs/settings.md`"
    )
    assert "| `walks` | `3000` | whole number |" in text and '| `reflection` | `"random"` |' in text


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_usage_lines_show_the_defaults(page: Path) -> None:
    found = re.findall(r"\[([A-Z]+)=([^\]|]+)[^\]]*\]", page.read_text("utf-8"))
    for key, value in found:
        if key in USAGE and not value.startswith("$("):  # make puts those in
            assert value.strip('"') == USAGE[key], f"{page.name} shows {key}={value}"
    assert {key for key, _ in found} >= set(USAGE) or page.name not in ("scenes.md", "Makefile")


def _numbers(text: str) -> tuple[float, ...]:
    parts = re.split(r", | and ", text.strip())
    return tuple(float(re.sub(r"[, ]", "", part)) for part in parts)


@pytest.mark.parametrize("words", STATED)
def test_what_pages_call_a_default_is_one(words: str) -> None:
    found = [m for page in PAGES for m in re.findall(words, " ".join(page.read_text("utf-8").split()))]
    assert found, "no page says this any more: leave it out here, too"
    default = STATED[words]
    for text in found:
        wanted = default if isinstance(default, tuple) else (default,)
        assert _numbers(text) == wanted, f"a page says {text}, the default is {default}"


def test_the_default_pipeline_is_the_default() -> None:
    path = ROOT / "pipelines" / "default.toml"
    assert ss.load_config(path) == JOB
    assert tomllib.loads(path.read_text("utf-8"))["simulation"]["walks"] == JOB.simulation.walks
