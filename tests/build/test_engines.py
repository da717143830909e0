"""Engines: the same bytes whoever runs the tiles; what happens to their workers."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build.build import build_dataset
from soundspaces_sim.build.engines import BuildProgress, Task, Watch
from soundspaces_sim.build.engines.capacity import PROCESS_BYTES, choose_shape
from soundspaces_sim.core.memory import free_memory
from tests.conftest import small_job
from tests.marks import ci_slow

ROOT = Path(__file__).resolve().parents[2]
MANY = 1e12  # bytes


def hashes(folder: Path) -> dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def whole(small_scene: ss.Scene, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Files of the small dataset in tiles of 2 points, made in one process."""
    out = tmp_path_factory.mktemp("whole")
    return hashes(ss.build_dataset(small_scene, out, small_job(tile=2)).folder)


def signal_one(command: str, folder: Path, how: signal.Signals) -> threading.Thread:
    """A thread that sends a signal to one of our child processes of this command, when the folder has a shard."""

    def look() -> None:
        deadline = time.monotonic() + 120.0
        while not list(folder.glob("s*.h5")) and time.monotonic() < deadline:
            time.sleep(0.005)
        for child in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):
                if command in " ".join(child.cmdline()):
                    os.kill(child.pid, how)
                    return

    thread = threading.Thread(target=look)
    thread.start()
    return thread


@pytest.mark.parametrize(
    ("cores", "gigabytes", "tasks", "given", "expected"),
    [
        (1, 99, 50, {}, (1, 1)),
        (2, 99, 50, {}, (1, 2)),
        (7, 99, 50, {}, (1, 7)),
        (8, 99, 50, {}, (1, 8)),
        (16, 99, 50, {}, (2, 16)),  # two threads for each core
        (16, 99, 6, {}, (1, 16)),  # too few tiles to trace their points anew
        (64, 999, 5000, {}, (8, 16)),
        (256, 999, 5000, {}, (32, 16)),
        (64, 999, 5, {}, (2, 64)),
        (256, 999, 5, {}, (5, 102)),  # no more processes than tiles
        (64, 9, 5000, {}, (2, 64)),  # nor than fit into memory
        (64, 1, 5000, {}, (1, 64)),
        (64, 999, 5000, {"threads": 1}, (64, 1)),
        (64, 999, 5000, {"processes": 3}, (3, 21)),
        (2, 1, 1, {"processes": 3, "threads": 2}, (3, 2)),  # whoever says both is obeyed
    ],
)
def test_processes_and_threads_follow_cores_and_memory(
    cores: int, gigabytes: float, tasks: int, given: dict[str, int], expected: tuple[int, int]
) -> None:
    shape = choose_shape(cores, gigabytes * 1e9, tasks, **given)
    assert shape == expected
    if not given:
        assert cores // 2 <= shape.processes * shape.threads <= 2 * cores
        assert shape.threads <= cores
        assert shape.processes == 1 or shape.processes * PROCESS_BYTES <= gigabytes * 1e9


def test_memory_is_that_of_the_control_group(tmp_path: Path) -> None:
    of_machine = free_memory(tmp_path)
    assert of_machine == pytest.approx(psutil.virtual_memory().available, rel=0.2)
    (tmp_path / "memory.max").write_text("max\n")
    assert free_memory(tmp_path) == pytest.approx(of_machine, rel=0.2)
    (tmp_path / "memory.max").write_text("1234567\n")
    assert free_memory(tmp_path) == 1234567.0


@pytest.mark.parametrize(
    ("limit", "use", "statistics", "name"),
    [
        ("memory.max", "memory.current", "memory.stat", "inactive_file"),
        (
            "memory/memory.limit_in_bytes",
            "memory/memory.usage_in_bytes",
            "memory/memory.stat",
            "total_inactive_file",
        ),
    ],
    ids=["version 2", "version 1"],
)
def test_memory_that_a_control_group_uses_is_not_free(
    tmp_path: Path, limit: str, use: str, statistics: str, name: str
) -> None:
    """But for files that nobody has read for long; in the first version those of groups within count, too."""
    (tmp_path / "memory").mkdir()
    (tmp_path / limit).write_text("1000000\n")
    (tmp_path / use).write_text("700000\n")
    assert free_memory(tmp_path) == 300_000.0
    (tmp_path / statistics).write_text(f"anon 5\nactive_file 7\nslab_{name} 9\n{name} 200000\nshmem 8\n")
    assert free_memory(tmp_path) == 500_000.0
    (tmp_path / use).write_text("100000\n")
    assert free_memory(tmp_path) == 1_000_000.0
    (tmp_path / use).write_text("1300000\n")
    assert free_memory(tmp_path) == 0.0


@pytest.mark.parametrize(
    ("engine", "option", "message"),
    [
        ("local", "cores=3", r"engine local: no option 'cores'; its options are processes, threads"),
        (
            "local",
            "processes=two",
            r"engine local: option processes=two: expected `int \| null`, got `str`",
        ),
        ("local", "processes", r"--engine-option processes: expected key=value"),
        ("local", "processes=0", r"processes: expected at least 1, got 0"),
    ],
)
def test_options_are_checked(
    tmp_path: Path, small_scene: ss.Scene, engine: str, option: str, message: str
) -> None:
    with pytest.raises(ss.ConfigError, match=message):
        build_dataset(small_scene, tmp_path, small_job(), engine=engine, options=[option])


@ci_slow
def test_local_processes_one_of_which_is_killed(
    tmp_path: Path, small_scene: ss.Scene, whole: dict[str, str], caplog: pytest.LogCaptureFixture
) -> None:
    """SIGKILL in mid-work: the tiles of the lost processes begin again, and the bytes are the same."""
    seen: list[BuildProgress] = []
    caplog.set_level("INFO", "soundspaces_sim")
    killer = signal_one("popen_loky", tmp_path / "two_rooms", signal.SIGKILL)
    result = build_dataset(
        small_scene, tmp_path, small_job(tile=2), progress=seen.append, options={"processes": 2}
    )
    killer.join()
    assert "2 processes × 1 thread (" in caplog.text and "a process was killed" in caplog.text
    assert hashes(result.folder) == whole
    assert seen[-1].done == seen[-1].total and result.manifest.complete


@pytest.mark.parametrize(("worth", "expected"), [(0.0, "processes"), (1e9, "here")])
def test_processes_start_where_they_are_worth_it(
    worth: float, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a large machine; the last tile, which is made in this process, tells."""
    from soundspaces_sim.build.engines import local

    done: list[tuple[str, list[int]]] = []
    monkeypatch.setattr(local, "free_memory", lambda: MANY)
    monkeypatch.setattr(local, "thread_count", lambda: 64)
    monkeypatch.setattr(local, "_WORTH_S", worth)
    monkeypatch.setattr(local, "_run_here", lambda t, _: done.append(("here", [x.number for x in t])))
    monkeypatch.setattr(
        local, "_run_processes", lambda t, _s, _w: done.append(("processes", [x.number for x in t]))
    )
    tasks = [Task(Path("there"), k) for k in range(5)]
    local.run(tasks, local.LocalOptions(), 64, Watch())
    assert done == [("here", [4]), (expected, [0, 1, 2, 3])]


_KILLS = """
import os, signal, sys
from pathlib import Path
from soundspaces_sim.build.engines import Task, Watch, find_engine, read_options
import soundspaces_sim.build.engines.local as local

def work(folder, number, threads):
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return local.Done(1, 0.0)

local.work = work
local.work.__module__ = "__main__"
engine = find_engine("local")
tasks = [Task(Path("there"), k) for k in range(4)]
try:
    engine.run(tasks, read_options("local", engine, ["processes=2"]), 2, Watch())
except Exception as error:
    print(type(error).__name__, error)
"""


@pytest.mark.slow
def test_a_tile_that_kills_every_process_ends_the_job() -> None:
    done = subprocess.run([sys.executable, "-c", _KILLS], cwd=ROOT, capture_output=True, text=True)
    assert "DatasetError" in done.stdout and "killed 3 times (out of memory?)" in done.stdout, (
        done.stderr
    )
