"""What breaks when a job runs on many machines: here each is a process, and what breaks is real or injected."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

import soundspaces_sim as ss
from soundspaces_sim.build import job_file
from soundspaces_sim.build.build import build_dataset
from soundspaces_sim.build.engines import ENGINES, Engine, Options, Task, Watch
from soundspaces_sim.build.wait import wait_for
from soundspaces_sim.build.worker import work
from soundspaces_sim.core.registry import Entry
from tests.build.test_engines import hashes
from tests.conftest import small_job
from tests.marks import ci_slow

ROOT = Path(__file__).resolve().parents[2]
SMALL = """
import sys
import soundspaces_sim as ss
from tests.conftest import small_job
from tests.rooms import table, two_rooms
room = two_rooms(table(0.3, 0.4, 0.01), 0)
"""


def _python(script: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", script, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300,
        env={**os.environ, **environment},
    )  # fmt: skip


# A file system that shows a new name some seconds late

_LATE_S = 3.0
_LATE = """
import os, threading
real_replace = os.replace
def late(a, b):
    threading.Timer(SECONDS, lambda: os.path.exists(a) and real_replace(a, b)).start()
os.replace = late
""".replace("SECONDS", str(_LATE_S))
_WORK_LATE = (
    _LATE
    + """
import sys
from soundspaces_sim.build.worker import work
for number in map(int, sys.argv[2:]):
    print(work(sys.argv[1], number, 1, 60.0).made, flush=True)
"""
)
_left_behind: list[subprocess.Popen[str]] = []


def _run_late(tasks: Sequence[Task], _options: Options, _cores: int, watch: Watch) -> None:
    """A worker elsewhere, whose files are seen here after it has said that they are made."""
    numbers = [str(t.number) for t in tasks]
    child = subprocess.Popen(
        [sys.executable, "-c", _WORK_LATE, str(tasks[0].folder), *numbers], cwd=ROOT, text=True,
        stdout=subprocess.PIPE,
    )  # fmt: skip
    assert child.stdout is not None
    for task, line in zip(tasks, child.stdout, strict=False):
        watch.done(task, int(line))
    _left_behind.append(child)


LATE_ENGINE = Engine(Options, _run_late)


@ci_slow
def test_names_that_show_late_are_waited_for(
    tmp_path: Path, dataset_folder: Path, small_scene: ss.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The worker waits for the job file, the client for the last shards; without a timeout it is an error."""
    monkeypatch.setitem(ENGINES, "late", Entry("tests.build.test_cluster_faults:LATE_ENGINE", "late"))
    job_file = tmp_path / "two_rooms" / "job.npz"
    real = os.replace

    def late(a: Path, b: Path) -> None:
        if Path(b) == job_file:
            threading.Timer(_LATE_S, lambda: real(a, b)).start()
        else:
            real(a, b)

    monkeypatch.setattr(os, "replace", late)
    start = time.monotonic()
    result = build_dataset(small_scene, tmp_path, small_job(), engine="late")
    assert time.monotonic() - start > 2 * _LATE_S  # both have waited
    child = _left_behind.pop()
    assert child.stdout is not None
    child.stdout.close()
    assert child.wait(timeout=60) == 0
    assert hashes(result.folder) == hashes(dataset_folder)


def test_patience_ends(tmp_path: Path) -> None:
    start = time.monotonic()
    assert not wait_for(lambda: False, tmp_path / "not there", 0.3)
    assert 0.3 <= time.monotonic() - start < 5.0
    assert wait_for(lambda: True, tmp_path, 0.0)
    seen = iter([False, False, True])
    assert wait_for(lambda: next(seen), tmp_path, 5.0)
    with pytest.raises(ss.DatasetError, match="no job is under way here"):
        work(str(tmp_path), 0, timeout_s=0.2)


# A file system without locks

_NO_LOCKS = """
#include <errno.h>
int flock(int file, int what) { (void)file; (void)what; errno = ENOLCK; return -1; }
"""
_BUILD_AND_READ = (
    SMALL
    + """
import h5py
folder = ss.build_dataset(room, sys.argv[1], small_job()).folder
try:
    h5py.File(next(folder.glob("s*.h5")), "r", locking=True)
except OSError as error:
    print(error)  # so there are none
with ss.open_dataset(folder) as ds:
    print(ds.binaural(0, 1).shape)
assert ss.verify_dataset(folder, full=True)[1] == []
(folder / "manifest.json").unlink()
print(ss.build_dataset(room, sys.argv[1], small_job()).built)
"""
)


@ci_slow
@pytest.mark.skipif(
    not sys.platform.startswith("linux") or shutil.which("cc") is None,
    reason="needs Linux and a C compiler",
)
def test_a_file_system_without_locks(tmp_path: Path) -> None:
    """Written, read, verified, taken up again: nothing needs a lock."""
    (tmp_path / "none.c").write_text(_NO_LOCKS)
    library = tmp_path / "none.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, tmp_path / "none.c"], check=True)
    done = _python(_BUILD_AND_READ, str(tmp_path / "out"), LD_PRELOAD=str(library))
    assert done.returncode == 0, done.stderr
    assert "No locks available" in done.stdout and done.stdout.endswith("\n0\n")


# Workers that must not take part


def test_workers_of_another_version_or_cpu_are_refused(
    tmp_path: Path, small_scene: ss.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    build_dataset(small_scene, tmp_path, small_job(), share=(3, 3))
    folder = tmp_path / "two_rooms"
    before = hashes(folder)
    here = rf"\(on {re.escape(socket.gethostname())}\)"
    for name, other, said in (
        ("code_target", lambda: "x86_64 generic", "planned on another machine.*generic.*same kind"),
        ("__version__", "99.0", r"this is version 99\.0; .*need the same"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(job_file, name, other)
            with pytest.raises(ss.DatasetError, match=f"{said} {here}"):
                work(str(folder), 0, 1, 0.0)
    assert hashes(folder) == before


# A disk that is full

_FULL = (
    SMALL
    + """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000))  # its children have it too
try:
    ss.build_dataset(room, sys.argv[1], small_job(tile=7), options={"processes": 2})
except ss.DatasetError as error:
    print(error)
    sys.exit(2)
"""
)


@ci_slow
def test_a_worker_whose_disk_is_full(tmp_path: Path, small_scene: ss.Scene) -> None:
    """One clear error that names the machine; what is there is whole; with space the job goes on."""
    done = _python(_FULL, str(tmp_path))
    assert done.returncode == 2, done.stderr
    assert re.search(
        r"cannot write this file .*File too large.*run the same command again \(on ", done.stdout
    )
    folder = tmp_path / "two_rooms"
    assert not [p for p in folder.iterdir() if p.name.endswith(".partial")]
    whole = {p.name: p.read_bytes() for p in folder.glob("s*.h5")}
    result = build_dataset(small_scene, tmp_path, small_job(tile=7))
    assert result.built == result.shards - len(whole) > 0
    assert all((folder / name).read_bytes() == data for name, data in whole.items())


# Two builders

_OTHER = (
    SMALL
    + """
ss.build_dataset(room, sys.argv[1], small_job(), options={"processes": 2})
"""
)


@ci_slow
def test_a_builder_with_processes_beside_another(
    tmp_path: Path, dataset_folder: Path, small_scene: ss.Scene
) -> None:
    """Whoever finishes first takes the job file away; the other's processes see that all is done."""
    other = subprocess.Popen([sys.executable, "-c", _OTHER, str(tmp_path)], cwd=ROOT)
    try:
        result = build_dataset(small_scene, tmp_path, small_job())
        assert other.wait(timeout=300) == 0
    finally:
        other.kill()
    assert hashes(result.folder) == hashes(dataset_folder)


def test_a_tile_of_a_job_that_somebody_finished(dataset_folder: Path) -> None:
    assert work(str(dataset_folder), 0, timeout_s=60.0).made == 0


# Dask: its scheduler, and a worker that hangs
