"""Figures that the documentation quotes have a command that makes them (the table at the end of RESULTS.md)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
RESULTS = (ROOT / "benchmarks" / "RESULTS.md").read_text("utf-8")
TABLE = RESULTS.partition("## Where the figures in README and docs come from")[2]
ROWS = re.findall(r"^\| ([\w-]+\.md) \| (.+?) \| (\S+) \|$", TABLE, re.MULTILINE)


def plain(text: str) -> str:
    """Words without the ends of lines between them."""
    return " ".join(text.split())


def test_there_are_figures() -> None:
    assert len(ROWS) > 15


@pytest.mark.parametrize(("page", "words", "command"), ROWS, ids=[f"{p}: {w}" for p, w, _ in ROWS])
def test_a_quoted_figure_has_its_command(page: str, words: str, command: str) -> None:
    assert words in plain((ROOT / "docs" / page).read_text("utf-8")), "the page says something else now"
    if command.startswith("benchmarks."):
        assert (ROOT / "benchmarks" / f"{command.partition('.')[2]}.py").is_file()
        assert command in RESULTS.replace(TABLE, ""), "its results are in RESULTS.md"
    else:
        assert (ROOT / command).is_file()
