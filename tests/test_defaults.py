"""The page of settings and the default pipeline are the code's."""

from __future__ import annotations

import tomllib
from pathlib import Path

import soundspaces_sim as ss
from docs.settings_page import settings_page

ROOT = Path(__file__).resolve().parents[1]
JOB = ss.JobConfig()


def test_the_page_of_settings_is_that_of_the_code() -> None:
    text = (ROOT / "docs" / "settings.md").read_text("utf-8")
    assert text == settings_page(), "run `python -m docs.settings_page > docs/settings.md`"
    assert "| `walks` | not set | whole number |" in text and '| `reflection` | `"random"` |' in text


def test_the_default_pipeline_is_the_default() -> None:
    path = ROOT / "pipelines" / "default.toml"
    assert ss.load_config(path) == JOB
    assert tomllib.loads(path.read_text("utf-8"))["simulation"]["walks"] == JOB.simulation.walks
