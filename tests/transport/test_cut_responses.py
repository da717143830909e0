"""Responses that end before the sound does: what is said of them, and where."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build.inspect import report_text
from soundspaces_sim.transport.preparation import CUT, make_model
from tests.command_line import run_command
from tests.rooms import box, plain, table

LIVE = box((6.0, 5.0, 3.0), table(0.005, 0.5))  # T60 of 23 s by Sabine, without air
POINTS = np.array([[1.5, 1.5, 1.5], [4.5, 3.5, 1.5]])


def test_what_is_cut_is_said_with_what_to_set(caplog: pytest.LogCaptureFixture) -> None:
    config = plain(walks=64, max_duration=1.0, decay_range_db=60.0, duration=None)
    with caplog.at_level(logging.WARNING):
        model = make_model(LIVE, POINTS, config)
    (note,) = model.notes
    assert note.startswith(CUT) and note in caplog.text
    assert "T20 and T30 are not defined" in note
    wanted = int(note.split("simulation.max_duration to ")[1].split()[0])
    assert 19 <= wanted <= 27  # Sabine's 22.9 s
    dead = box((6.0, 5.0, 3.0), table(0.5, 0.5))
    assert make_model(dead, POINTS, config).notes == ()


def test_verify_says_what_is_cut(tmp_path: Path) -> None:
    simulation = plain(walks=64, max_duration=0.5, duration=None)
    ss.build_dataset(LIVE, tmp_path, ss.JobConfig(simulation=simulation), points=POINTS, jobs=1)
    ended = run_command("verify", "box", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    text = ended.stdout
    assert "cut: responses end after 0.5 s" in text and "max_duration" in text
    assert "T30 of 0–176 Hz is not defined in 2 of 2 pairs" in text
    assert (
        "where the response is cut after" in text
        and "(simulation.max_duration, simulation.duration)" in text
    )


@pytest.mark.slow
def test_inspect_says_why_a_time_is_not_defined() -> None:
    report = ss.inspect_scene(LIVE, ss.GridConfig(spacing=2.0, rays=100))
    lost = np.isnan(report.t30)
    assert lost.any()
    why = [w for w in report.warnings if w.startswith("T30 of ")]
    assert len(why) == lost.sum() and all("cut after" in w and "max_duration" in w for w in why)
    assert "Nothing looks wrong" not in report_text(report)
