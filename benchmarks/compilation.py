"""What compiling costs on a first run: seconds per kernel, and a job from an empty cache beside one from a full.

    .venv/bin/python -m benchmarks.compilation

A kernel's own seconds are those of the thread that compiles it, without the functions that it calls. The job
is a small grid of the demo, so that nearly all of its first run is compilation.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from threading import get_ident as id_of_thread
from typing import Any

_JOB = """
import tempfile, soundspaces_sim as ss
config = ss.JobConfig(grid=ss.GridConfig(spacing=2.0, rays=100),
                      simulation=ss.SimulationConfig(walks=16, joined_walks=8, duration=0.2))
result = ss.build_dataset(ss.load_scene("demo"), tempfile.mkdtemp(), config)
with ss.open_dataset(result.folder) as ds:
    ds.binaural(0, 1)
"""


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


def _wall(cache: str) -> float:
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", _JOB], check=True, env={**os.environ, "NUMBA_CACHE_DIR": cache}
    )
    return time.perf_counter() - start


def main() -> None:
    if "--kernels" in sys.argv:
        spent = kernel_seconds()
        ours = {k: v for k, v in spent.items() if not k.startswith("numba.")}
        print(
            f"{sum(s for s, _ in spent.values()):.1f} s in {len(spent)} functions, {len(ours)} of them ours"
        )
        for name, (seconds, versions) in sorted(spent.items(), key=lambda kv: -kv[1][0])[:30]:
            print(f"{seconds:7.2f} s  {versions} version(s)  {name}")
        return
    with tempfile.TemporaryDirectory() as cache:
        cold = _wall(cache)
        warm = [_wall(cache) for _ in range(3)]
    print(f"job from an empty cache {cold:.1f} s, from a full one {min(warm):.1f} s")
    print(f"compiling adds {cold - min(warm):.1f} s")
    with tempfile.TemporaryDirectory() as cache:
        env = {**os.environ, "NUMBA_CACHE_DIR": cache}
        subprocess.run(
            [sys.executable, "-m", "benchmarks.compilation", "--kernels"], check=True, env=env
        )


if __name__ == "__main__":
    main()
