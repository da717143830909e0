"""What compiling costs on a first run: seconds per kernel, and a job from an empty cache beside one from a full.

Question: How long does a first run compile, and which kernels take most of it?

Method: A small job of the demo in fresh processes, once from an empty cache and three times from a full one, by
the clock and of all processes' processors. Then once in one process with a listener on Numba's events: a
kernel's own seconds are those of the thread that compiles it, without the functions that it calls.

Amortised: Nothing; the job is so small that nearly all of its first run is compilation.

Takes: 2 to 5 minutes.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from threading import get_ident as id_of_thread
from typing import Any

from benchmarks.tools.record import Table, table

MEASURES = ("core", "scene", "layout", "transport", "echogram", "rendering", "dataset", "build")
_JOB = """
import tempfile, soundspaces_sim as ss
config = ss.JobConfig(grid=ss.GridConfig(spacing=2.0, rays=100),
                      simulation=ss.SimulationConfig(walks=16, connections={"subpaths": 8}, duration=0.2))
result = ss.build_dataset(ss.load_scene("demo"), tempfile.mkdtemp(), config)
with ss.open_dataset(result.folder) as ds:
    ds.binaural(0, 1)
"""
_DEAREST = 20


def kernel_seconds() -> dict[str, tuple[float, int]]:
    """Own seconds and number of versions of every function compiled in this process for `_JOB`."""
    from numba.core import event

    spent: dict[str, tuple[float, int]] = {}
    stacks: dict[int, list[list[float]]] = {}

    class Clock(event.Listener):
        def on_start(self, _: Any) -> None:
            stacks.setdefault(id_of_thread(), []).append([time.thread_time(), 0.0])

        def on_end(self, event: Any) -> None:
            stack = stacks[id_of_thread()]
            started, inner = stack.pop()
            seconds = time.thread_time() - started
            if stack:
                stack[-1][1] += seconds
            function = event.data["dispatcher"].py_func
            name = f"{function.__module__}.{function.__qualname__}".removeprefix("soundspaces_sim.")
            before, versions = spent.get(name, (0.0, 0))
            spent[name] = before + seconds - inner, versions + 1

    event.register("numba:compile", Clock())
    from soundspaces_sim.build import warm_up

    warm_up.start = lambda: None  # all in this process
    exec(_JOB, {})
    return spent


def _used() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _seconds(cache: str) -> tuple[float, float]:
    """By the clock and of the processor, of the job in a process of its own."""
    start, used = time.perf_counter(), _used()
    subprocess.run(
        [sys.executable, "-c", _JOB], check=True, env={**os.environ, "NUMBA_CACHE_DIR": cache}
    )
    return time.perf_counter() - start, _used() - used


def run() -> list[Table]:
    """Jobs, and the dearest kernels."""
    with tempfile.TemporaryDirectory() as cache:
        cold = _seconds(cache)
        warm = [min(column) for column in zip(*(_seconds(cache) for _ in range(3)), strict=True)]
    rows = [
        ("a small job from an empty cache", *cold),
        ("from a full one, least of three", *warm),
        ("compiling", cold[0] - warm[0], cold[1] - warm[1]),
    ]
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.speed.compilation"],
            check=True, capture_output=True, text=True, env={**os.environ, "NUMBA_CACHE_DIR": cache},
        )  # fmt: skip
    spent: dict[str, tuple[float, int]] = json.loads(done.stdout.splitlines()[-1])
    ours = {name: value for name, value in spent.items() if not name.startswith("numba.")}
    dearest = sorted(ours.items(), key=lambda item: -item[1][0])[:_DEAREST]
    return [
        table("Jobs", ["", ("clock", "s"), ("processor", "s")], rows),
        table(
            "Kernels that take longest by themselves",
            ["kernel", ("own time", "s"), "versions"],
            [(name, seconds, versions) for name, (seconds, versions) in dearest],
            f"All: {sum(s for s, _ in spent.values()):.1f} s of the processor in {len(spent)} functions, "
            f"{len(ours)} of them of this package.",
        ),
    ]


if __name__ == "__main__":
    print(json.dumps(kernel_seconds()))  # of a process that `run` started
