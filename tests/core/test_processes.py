"""Processes that have ended, zombies included."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from soundspaces_sim.core.io.files import remove_stale
from soundspaces_sim.core.platforms import process_runs


@pytest.mark.skipif(sys.platform != "linux", reason="the state of a process is read from /proc")
def test_files_of_a_zombie_are_stale(tmp_path: Path) -> None:
    """A child that was killed, and that this process has not waited for, still answers to signal 0."""
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    left = tmp_path / f".shard.h5.{socket.gethostname()}.{child.pid}.00ff.partial"
    left.touch()
    remove_stale(tmp_path)
    assert left.exists() and process_runs(child.pid) and process_runs(os.getpid())
    child.kill()
    while psutil.Process(child.pid).status() != psutil.STATUS_ZOMBIE:
        pass
    os.kill(child.pid, 0)
    assert not process_runs(child.pid)
    remove_stale(tmp_path)
    assert not left.exists()
    assert child.stdin is not None
    child.stdin.close()
    child.wait()
    assert not process_runs(child.pid)
