"""Workers end with the command that started them, whatever ends it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from tests.marks import CI_SLOW

ROOT = Path(__file__).resolve().parents[2]

_LOCAL = """
import os, sys, time
from pathlib import Path
from soundspaces_sim.build.engines import Task, Watch, local
from soundspaces_sim.build.engines.capacity import Shape

def sleep(folder, number, threads):
    Path(folder, f"{os.getpid()}").touch()
    time.sleep(600)

local.work = sleep
local._run_processes([Task(Path(sys.argv[1]), k) for k in range(2)], Shape(2, 1), Watch())
"""
_STEPS = """
import os, sys, time
from pathlib import Path
from soundspaces_sim.core.processes import worker_pool

def sleep(number):
    Path(sys.argv[1], f"{os.getpid()}").touch()
    time.sleep(600)

with worker_pool(2) as pool:
    list(pool.map(sleep, [0, 1]))
"""
_GRANDCHILD = """
import os, subprocess, sys
code = "import os, sys, time; from pathlib import Path; from soundspaces_sim.core.processes import end_with;"
code += "end_with(int(sys.argv[2])); Path(sys.argv[1], str(os.getpid())).touch(); time.sleep(600)"
relay = "import subprocess, sys; subprocess.run([sys.executable, '-c', *sys.argv[1:]])"
subprocess.run([sys.executable, "-c", relay, code, sys.argv[1], str(os.getpid())])
"""


@pytest.mark.parametrize(
    ("script", "workers"),
    [pytest.param(_LOCAL, 2, marks=CI_SLOW), (_STEPS, 2), (_GRANDCHILD, 1)],
    ids=["local", "pool", "grandchild"],
)
def test_workers_end_when_their_parent_is_killed(script: str, workers: int, tmp_path: Path) -> None:
    parent = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], cwd=ROOT)
    try:
        deadline = time.monotonic() + 120.0
        while len(list(tmp_path.iterdir())) < workers and time.monotonic() < deadline:
            assert parent.poll() is None
            time.sleep(0.05)
        running = [psutil.Process(int(path.name)) for path in tmp_path.iterdir()]
        assert len(running) == workers and all(process.is_running() for process in running)
        os.kill(parent.pid, signal.SIGKILL)  # nobody waits for it: it stays as a zombie
        gone, left = psutil.wait_procs(running, timeout=30.0)
        assert not left and len(gone) == workers
    finally:
        parent.kill()
        parent.wait()
