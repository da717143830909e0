"""What a first simulation compiles, by the part of the package that its kernels are in.

Question: How long is compiling all that `simulate` needs, and how much of it is for discrete arrivals?

Method: Fresh processes with empty caches, of kernels and of what is kept of scenes, simulate three points of the
house in one thread. Processor seconds of the kernels that are compiled, each with the functions that it consists
of, by module. Median and range.

Amortised: Nothing. An installation compiles once; a job does it in as many processes as there are kernels to share
out.

Takes: Five minutes. Arguments: processes (3).
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile

from benchmarks.tools.record import Table, table

_ROOMS = {  # a kernel is of the first that it fits
    "arrivals": "transport.arrivals",
    "transfer": "transport.radiance_transfer",
    "other transport": "transport",
    "scene": "scene",
}
_SCRIPT = """
import json, time
from collections import Counter
from numba.core import event

class Compiled(event.Listener):
    def __init__(self):
        self.open, self.seconds = [], Counter()
    def on_start(self, event):
        self.open.append(time.process_time())
    def on_end(self, event):
        start, function = self.open.pop(), event.data["dispatcher"].py_func
        if not self.open:
            self.seconds[f"{function.__module__}.{function.__qualname__}"] += time.process_time() - start

compiled = Compiled()
event.register("numba:compile", compiled)
import soundspaces_sim as ss
from benchmarks.tools.scenes import house, shuffled_points
from soundspaces_sim.core.numerics.kernel import set_thread_count
set_thread_count(1)
scene = house()
points = shuffled_points(scene)[:3]
ss.simulate(scene, points, points, ss.SimulationConfig(walks=64))
print(json.dumps(compiled.seconds))
"""


def _compiled() -> dict[str, float]:
    """Processor seconds by kernel."""
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(
            [sys.executable, "-c", _SCRIPT],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "NUMBA_CACHE_DIR": cache, "SOUNDSPACES_SIM_CACHE": cache},
        )
    seconds: dict[str, float] = json.loads(done.stdout)
    return seconds


def _room_of(kernel: str) -> str:
    for room, module in _ROOMS.items():
        if kernel.startswith(f"soundspaces_sim.{module}."):
            return room
    return "other"


def run(processes: str = "3") -> list[Table]:
    """The table."""
    rounds = [_compiled() for _ in range(int(processes))]
    rows = []
    for room in ("all", *_ROOMS, "other"):
        seconds = [
            sum(s for kernel, s in each.items() if room in ("all", _room_of(kernel))) for each in rounds
        ]
        kernels = sum(room in ("all", _room_of(kernel)) for kernel in rounds[0])
        rows.append([room, kernels, statistics.median(seconds), min(seconds), max(seconds)])
    heads = [("processor", "s"), ("least", "s"), ("most", "s")]
    return [
        table(f"Compiling, medians of {processes} processes", ["kernels of", "kernels", *heads], rows)
    ]
