"""Forecasts that other work on the machine does not move."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build import estimate
from soundspaces_sim.build.prepare import plan_job
from tests.rooms import box, plain, table as walls


def test_a_forecast_is_of_processor_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock on the wall that runs a thousand times too fast, as if others had the machine, does not move it."""
    config = ss.JobConfig(simulation=plain(walks=64, duration=0.2))
    points = np.array([[x, y, 1.5] for x in np.arange(0.5, 5.5, 1.0) for y in np.arange(0.5, 4.5, 1.0)])
    job, _ = plan_job(box((6.0, 5.0, 3.0), walls(0.2, 0.3)), tmp_path, config, points)
    told: list[int] = []
    real = time.perf_counter
    quiet = estimate.estimate(job, told.append).seconds
    assert told[0] == told[1] > 1 and told == sorted(
        told
    )  # who waits is told; the first tile is made twice
    monkeypatch.setattr(time, "perf_counter", lambda: 1000.0 * real())
    assert estimate.estimate(job).seconds < 10.0 * quiet


def test_stages_of_pairs_are_stages_of_a_tile() -> None:
    """A forecast takes what pairs cost from these stages: none of them has another name."""
    config = ss.SimulationConfig(walks=64, duration=0.4)
    points = np.random.default_rng(0).uniform(0.5, 2.5, (4, 3))
    with ss.profiled("tile") as found:
        ss.simulate(box((6.0, 5.0, 3.0), walls(0.2, 0.3)), points, points, config)

    def names(of: ss.Stage) -> set[str]:
        return {of.name}.union(*map(names, of.stages))

    assert set(estimate._OF_PAIRS) <= {*names(found.stage), estimate._ENCODING}
