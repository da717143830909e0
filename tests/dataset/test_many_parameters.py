"""Parameters of many pairs: in processes as in this one, with progress; forecasts that other work does not move."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build import estimate
from soundspaces_sim.build.prepare import plan_job
from soundspaces_sim.dataset.room_parameters import table
from tests.command_line import run_command
from tests.rooms import box, plain, table as walls


def test_processes_give_what_threads_give(dataset_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        count = len(ds.points)
        pairs = [(s, l) for s in range(count) for l in range(count) if s != l][:40]
        alone = ds.parameters(pairs=pairs)
        told: list[tuple[int, int]] = []
        monkeypatch.setattr(table, "_MANY", 1)
        together = ds.parameters(pairs=pairs, progress=lambda done, of: told.append((done, of)))
    for name, values in alone.values.items():
        np.testing.assert_array_equal(values, together.values[name], err_msg=name)
    assert told[-1] == (len(pairs), len(pairs)) and told == sorted(told)


def test_the_command_says_what_it_is_at(
    dataset_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = run_command("table", str(dataset_folder), "--octaves", "--source", "0", cwd=tmp_path)
    assert ended.returncode == 0
    assert "Parameters of" in ended.stderr + capsys.readouterr().err


def test_a_forecast_is_of_processor_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock on the wall that runs a thousand times too fast, as if others had the machine, does not move it."""
    config = ss.JobConfig(simulation=plain(walks=64, duration=0.2))
    points = np.array([[x, y, 1.5] for x in np.arange(0.5, 5.5, 1.0) for y in np.arange(0.5, 4.5, 1.0)])
    job, _ = plan_job(box((6.0, 5.0, 3.0), walls(0.2, 0.3)), tmp_path, config, points)
    real = time.perf_counter
    quiet = estimate.estimate(job).seconds
    monkeypatch.setattr(time, "perf_counter", lambda: 1000.0 * real())
    assert estimate.estimate(job).seconds < 10.0 * quiet
