"""The page of settings and the default pipeline are the code's."""

from __future__ import annotations

import tomllib
from pathlib import Path

import soundspaces_sim as ss
from docs.settings_page import settings_tables

ROOT = Path(__file__).resolve().parents[1]
JOB = ss.JobConfig()


def test_the_page_of_settings_has_every_setting() -> None:
    """Its tables are made with the site."""
    assert "<!-- settings -->" in (ROOT / "docs" / "settings.md").read_text("utf-8")
    text = settings_tables()
    for table in ("grid", "graph", "simulation", "simulation.specular", "simulation.low", "dataset"):
        assert f"## `[{table}]`" in text
    rows = [row.split(" | ") for row in text.splitlines() if row.startswith("| `")]
    assert len(rows) > 50 and all(row[3].rstrip(" |") for row in rows)  # what each means
    assert "| `walks` | not set | whole number |" in text and "| `reflection` | not set |" in text


def test_the_default_pipeline_is_the_default() -> None:
    path = ROOT / "pipelines" / "default.toml"
    assert ss.load_config(path) == JOB
    assert tomllib.loads(path.read_text("utf-8"))["simulation"]["walks"] == JOB.simulation.walks
