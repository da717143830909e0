"""Figures that the documentation quotes have a benchmark or a test that makes them (benchmarks/quoted.toml)."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from benchmarks.tools.catalogue import names
from benchmarks.tools.record import path_of

ROOT = Path(__file__).resolve().parents[1]
ROWS = tomllib.loads((ROOT / "benchmarks" / "quoted.toml").read_text("utf-8"))["quoted"]


def plain(text: str) -> str:
    """Words without the ends of lines between them."""
    return " ".join(text.split())


def test_there_are_figures() -> None:
    assert len(ROWS) > 15


@pytest.mark.parametrize("row", ROWS, ids=[f"{row['page']}: {row['words']}" for row in ROWS])
def test_a_quoted_figure_has_its_source(row: dict[str, str]) -> None:
    page = (ROOT / "docs" / row["page"]).read_text("utf-8")
    assert row["words"] in plain(page), "the page says something else now"
    if row["by"].startswith("tests/"):
        assert (ROOT / row["by"]).is_file()
    else:
        assert row["by"] in names()
        assert path_of(row["by"]).is_file(), "its results are stored"
