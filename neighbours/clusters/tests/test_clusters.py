"""Engines of clusters: the same bytes as one process makes, whatever happens to their workers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build.build import build_dataset
from soundspaces_sim.build.engines import ENGINES, Task, Watch, find_engine, read_options
from soundspaces_sim.build.wait import wait_for
from soundspaces_sim.build.worker import Done
from tests.build.test_engines import ROOT, hashes, signal_one, whole as whole
from tests.conftest import small_job
from tests.marks import ci_slow


@pytest.mark.parametrize(
    ("engine", "option", "message"),
    [
        ("dask", "adress=tcp://a:1", r"no option 'adress'; its options are address"),
        ("dask", "address=tcp://127.0.0.1:1", r"no scheduler answers at tcp://127.0.0.1:1"),
        ("slurm", "cluster=pbs", r"option cluster=pbs: invalid enum value 'pbs'"),
        ("slurm", "timeout_min=-1", r"timeout_min=-1: expected more than 0"),
        ("slurm", "partition=cpu", r"no sbatch; run this on a cluster's login node"),
    ],
)
def test_options_are_checked(
    tmp_path: Path, small_scene: ss.Scene, engine: str, option: str, message: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    if engine != "local":
        pytest.importorskip({"dask": "distributed", "slurm": "submitit"}[engine])
    there = None if "sbatch" in message else "/usr/bin/sbatch"
    monkeypatch.setattr("shutil.which", lambda _: there)
    options = (
        [option]
        if "connect" in option
        else [option, *(["connect_s=1"] if "tcp://127" in option else [])]
    )
    with pytest.raises(ss.ConfigError, match=message):
        build_dataset(small_scene, tmp_path, small_job(), engine=engine, options=options)


def test_an_engine_whose_extra_is_missing_says_which(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, module in (("dask", "dask"), ("slurm", "submitit"), ("ray", "ray")):
        with monkeypatch.context() as patch:
            patch.delitem(sys.modules, ENGINES[name].target.partition(":")[0], raising=False)
            patch.setitem(sys.modules, module, None)
            with pytest.raises(ss.ConfigError, match=rf"neighbours/clusters\[{name}\]"):
                find_engine(name)


def test_options_are_read_as_texts_and_as_values() -> None:
    pytest.importorskip("submitit")
    slurm = find_engine("slurm")
    one: Any = read_options("slurm", slurm, ["mem_gb=2.5", "wait=false", "partition=short"])
    assert one == read_options("slurm", slurm, {"mem_gb": 2.5, "wait": False, "partition": "short"})
    assert (one.mem_gb, one.wait, one.partition, one.account) == (2.5, False, "short", None)


@ci_slow
@pytest.mark.filterwarnings("ignore")
def test_dask_with_three_workers_one_of_which_is_killed(
    tmp_path: Path, small_scene: ss.Scene, whole: dict[str, str]
) -> None:
    pytest.importorskip("distributed")
    killer = signal_one("spawn_main", tmp_path / "two_rooms", signal.SIGKILL)
    result = build_dataset(
        small_scene, tmp_path, small_job(tile=2), engine="dask", options={"workers": 3, "threads": 1}
    )
    killer.join()
    assert hashes(result.folder) == whole


begun: list[int] = []


def note(_folder: str, number: int, _threads: int) -> Done:
    begun.append(number)
    return Done(1, 0.0)


@pytest.mark.filterwarnings("ignore")
def test_dask_begins_in_the_order_of_the_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    from soundspaces_clusters import dask as engine

    monkeypatch.setattr(engine, "work", note)
    begun.clear()
    order = [7, 3, 11, 0, 5, 2, 10, 1, 9, 4, 8, 6]
    with distributed.Client(
        processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None
    ) as client:
        engine._Run(client, 1, 60.0, Watch()).do([Task(Path("there"), k) for k in order])
    assert begun == order


@ci_slow
@pytest.mark.filterwarnings("ignore")
def test_slurm_shares_run_as_submitit_runs_them_here(
    tmp_path: Path, small_scene: ss.Scene, whole: dict[str, str]
) -> None:
    pytest.importorskip("submitit")
    options = {"cluster": "local", "elements": 2, "cpus_per_task": 1, "logs": str(tmp_path / "logs")}
    result = build_dataset(
        small_scene, tmp_path / "out", small_job(tile=2), engine="slurm", options=options
    )
    assert hashes(result.folder) == whole
    assert len(list((tmp_path / "logs").glob("*.out"))) == 2  # a log of each


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_ray_here(tmp_path: Path, small_scene: ss.Scene, whole: dict[str, str]) -> None:
    pytest.importorskip("ray")
    result = build_dataset(
        small_scene, tmp_path, small_job(tile=2), engine="ray", options={"threads": 1}
    )
    assert hashes(result.folder) == whole


def _dask(*arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments], cwd=ROOT, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_scheduler_is_lost_and_the_command_run_again(tmp_path: Path, small_scene: ss.Scene) -> None:
    pytest.importorskip("distributed")
    where = tmp_path / "scheduler.json"
    known = ("--scheduler-file", str(where))
    scheduler = _dask("scheduler", "--port", "0", "--no-dashboard", *known)
    worker = _dask("worker", "--nthreads", "1", "--no-dashboard", "--no-nanny", *known)
    options = {"scheduler_file": str(where)}
    try:
        assert wait_for(where.is_file, tmp_path, 60.0)

        def lose() -> None:
            wait_for(lambda: bool(list(tmp_path.glob("out/two_rooms/s*.h5"))), tmp_path, 120.0)
            scheduler.kill()

        thread = threading.Thread(target=lose)
        thread.start()
        with pytest.raises(ss.DatasetError, match=r"(is lost|dropped it).*finished shards are safe"):
            build_dataset(
                small_scene, tmp_path / "out", small_job(tile=1), engine="dask", options=options
            )
        thread.join()
        assert list(tmp_path.glob("out/two_rooms/s*.h5"))
        with pytest.raises(ss.ConfigError, match="no scheduler answers"):
            build_dataset(
                small_scene,
                tmp_path / "out",
                small_job(tile=1),
                engine="dask",
                options={**options, "connect_s": 2},
            )
        result = build_dataset(small_scene, tmp_path / "out", small_job(tile=1))
        alone = build_dataset(small_scene, tmp_path / "alone", small_job(tile=1))
        assert 0 < result.built < result.shards and hashes(result.folder) == hashes(alone.folder)
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_worker_that_hangs_does_not_hold_up_the_job(tmp_path: Path, small_scene: ss.Scene) -> None:
    """Its tiles are given out a second time; it goes on after the job is done, and changes nothing."""
    pytest.importorskip("distributed")
    folder = tmp_path / "two_rooms"
    stopper = signal_one("spawn_main", folder, signal.SIGSTOP)
    alone = build_dataset(small_scene, tmp_path / "alone", small_job(tile=2))

    def wake() -> None:
        wait_for(lambda: len(list(folder.glob("s*.h5"))) == alone.shards, folder, 120.0)
        for child in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):
                if child.status() == psutil.STATUS_STOPPED:
                    os.kill(child.pid, signal.SIGCONT)

    waker = threading.Thread(target=wake)
    waker.start()
    result = build_dataset(
        small_scene, tmp_path, small_job(tile=2), engine="dask",
        options={"workers": 2, "threads": 1, "again_s": 3.0},
    )  # fmt: skip
    stopper.join()
    waker.join()
    assert hashes(result.folder) == hashes(alone.folder)
