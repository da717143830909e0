"""The profile: whose time is whose, what is counted, and that nothing depends on it."""

from __future__ import annotations

import pickle
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.build.worker import work
from soundspaces_sim.cli.app import app
from soundspaces_sim.core.numerics.kernel import at_once, over_rows, set_thread_count, thread_count
from soundspaces_sim.core.profile import adopt, count, here, profiled, stage, working_in
from soundspaces_sim.transport.preparation import make_model
from tests.build.test_jobs import started  # noqa: F401 - a fixture

SIZE = (2.0, 1.8, 1.6)  # m: two segments are shorter than the 6 m after which subpaths are resampled
POINTS = np.array([[0.5, 0.6, 0.7], [1.4, 1.2, 0.9], [0.9, 0.4, 1.2]])


class _Clock(threading.local):
    now = 0.0


@pytest.fixture
def work_for(monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    """A processor that works as many seconds as it is told, and each thread's clock of it."""
    clock = _Clock()
    monkeypatch.setattr(time, "thread_time", lambda: clock.now)

    def seconds(number: float) -> None:
        clock.now += number

    return seconds


@pytest.fixture
def two_threads():  # type: ignore[no-untyped-def]
    before = thread_count()
    set_thread_count(2)
    yield
    set_thread_count(before)


@pytest.mark.usefixtures("two_threads")
def test_time_is_that_of_the_stage_in_whichever_thread(work_for) -> None:  # type: ignore[no-untyped-def]
    def rows(first: int, last: int) -> None:
        work_for(1.0 * (last - first))
        with stage("inner"):
            work_for(0.25)

    def task() -> None:
        with stage("task"):
            over_rows(rows, 4, chunk=1)

    work_for(100.0)  # nobody's
    with profiled("all") as found:
        work_for(2.0)
        with stage("rows"):
            work_for(0.5)
            over_rows(rows, 8, chunk=2)
        at_once(task, task)
    work_for(100.0)
    root = found.stage
    assert root.seconds == 2.0
    of_rows, of_task = root.find("rows"), root.find("task")
    assert of_rows is not None and of_task is not None
    assert of_rows.seconds == 0.5 + 8.0 and of_rows.total == 0.5 + 8.0 + 4 * 0.25
    assert of_task.calls == 2 and of_task.total == 2 * (4.0 + 4 * 0.25)
    assert root.total == 2.0 + of_rows.total + of_task.total
    assert root.find("rows", "inner", "none") is None
    assert root.alone == 2.0 + 0.5  # threads did all else


def test_cores_are_processor_time_over_time_by_the_clock(  # type: ignore[no-untyped-def]
    work_for, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two threads are in a stage from 0 to 3 s and from 1 to 4 s, and work 2 s each: 4 s in 4 s."""
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    meet, part = threading.Event(), threading.Event()

    def second(node: Any) -> None:
        with working_in(node), stage("inner"):
            work_for(2.0)
            meet.set()
            part.wait()

    with profiled("all") as found:
        with stage("inner"):
            now[0] = 1.0
            thread = threading.Thread(target=second, args=(found,))
            thread.start()
            meet.wait()
            work_for(2.0)
            now[0] = 3.0
        now[0] = 4.0
        part.set()
        thread.join()
        work_for(1.0)
        now[0] = 9.0
    inner = found.stage.find("inner")
    assert inner is not None
    assert (inner.wall, inner.total, inner.cores, inner.alone) == (4.0, 4.0, 1.0, 2.0)
    assert (found.stage.wall, found.stage.total, found.stage.alone) == (9.0, 5.0, 3.0)
    assert inner.as_dict()["wall_s"] == 4.0


def test_nothing_is_collected_where_nobody_asked() -> None:
    with stage("lost"):
        count(rays=3)
        assert here() is None
    with profiled("all") as found:
        count(rays=2)
    assert here() is None
    assert found.stage.stages == () and found.stage.counted("rays") == 2


def test_a_stage_ends_with_an_error() -> None:
    with profiled("all") as found:
        with pytest.raises(ZeroDivisionError), stage("broken"):
            raise ZeroDivisionError
        count(rays=1)
    assert found.stage.counts == {"rays": 1}
    assert [s.name for s in found.stage.stages] == ["broken"]


def test_profiles_of_processes_add_up() -> None:
    found = []
    for _ in range(2):
        with profiled("tiles") as part:
            with stage("specular"):
                count(rays=5)
            count(pairs=2)
        found.append(pickle.loads(pickle.dumps(part.stage)))
    with profiled("all") as whole:
        for one in found:
            adopt(one)
        adopt(None)
    tiles = whole.stage.find("tiles")
    assert tiles is not None and tiles.calls == 2 and tiles.counted("rays") == 10
    assert whole.stage.counted("pairs") == 4
    np.testing.assert_allclose(tiles.total, sum(one.total for one in found))
    text = str(whole.stage)
    assert "specular" in text and text.splitlines()[-1].endswith(", 2.5 rays, 0 deposits, 0 products")


def _simulated(threads: int) -> tuple[ss.Echograms, ss.Stage]:
    before = thread_count()
    set_thread_count(threads)
    try:
        room = ss.shoebox(SIZE, absorption=0.3, scattering=0.5)
        config = ss.SimulationConfig(
            walks=64,
            duration=0.1,
            max_bounces=1,
            connections=ss.ConnectionsConfig(window=0.0),
            radiance_transfer=ss.RadianceTransferConfig(enabled=False),
        )
        with profiled("all") as found:
            echoes = ss.simulate(room, POINTS[:1], POINTS[1:], config)
        settings = make_model(room, POINTS, config).world.settings
    finally:
        set_thread_count(before)
    simulate = found.stage.find("simulate")
    assert simulate is not None
    specular, scattered = simulate.find("specular"), simulate.find("receiver_volumes")
    assert specular is not None and scattered is not None
    # In a closed room a subpath of one bounce has two segments; guide and decay trace none in these stages.
    assert specular.counts["rays"] == 2 * settings.specular * len(POINTS)
    assert scattered.counts["rays"] == 2 * settings.subpaths * len(POINTS)
    assert 0 < scattered.counts["deposits"] < 2 * scattered.counts["rays"]
    assert simulate.counted("pairs") == 2
    return echoes, found.stage


def _counts(of: ss.Stage) -> dict[str, object]:
    inner = sorted(of.stages, key=lambda stage: stage.name)  # of those side by side either begins first
    return {"name": of.name, **of.counts, "stages": [_counts(s) for s in inner]}


def test_rays_are_counted_and_threads_change_no_count() -> None:
    (one, of_one), (two, of_two) = _simulated(1), _simulated(2)
    np.testing.assert_array_equal(one.energy, two.energy)
    assert _counts(of_one) == _counts(of_two)


def test_a_worker_tells_where_its_time_went(started: Path) -> None:  # noqa: F811
    """A process that collects nothing itself reports to the one that asked."""
    done = work(str(started), 0)
    assert done.profile is not None and done.profile.name == "tiles"
    assert done.profile.counted("pairs") > 0 and done.profile.find("encoding") is not None
    with profiled("all") as found:
        assert work(str(started), 1).profile is None
    assert found.stage.find("tiles", "encoding") is not None


def test_the_command_prints_it(tmp_path: Path) -> None:
    mesh, points = tmp_path / "room.obj", tmp_path / "points.txt"
    trimesh.creation.box((2.0, 1.8, 1.6)).export(mesh)
    points.write_text("0 0.5 0.4 0.2\n1 -0.4 0.1 -0.3\n")
    command = ["rirs", str(mesh), "--points", str(points), "--walks", "16", "--jobs", "1", "--out"]
    said = CliRunner().invoke(app, [*command, str(tmp_path / "told"), "--profile"])
    assert said.exit_code == 0, said.output
    heads = next(line for line in said.output.splitlines() if line.startswith("stage"))
    assert heads.split() == [
        "stage",
        "calls",
        "processor",
        "s",
        "share",
        "wall",
        "s",
        "cores",
        "alone",
        "s",
        "rays",
        "deposits",
        "products",
        "memory",
        "MB",
    ]
    # Of two points the pair is computed once for both ways, and each of a point with itself.
    assert "specular" in said.output and "\n3 pairs; each " in said.output
    assert "specular" not in CliRunner().invoke(app, [*command, str(tmp_path / "plain")]).output
