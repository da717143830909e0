"""How long a fresh process takes to import the package, and to read a first echogram and a first response.

    .venv/bin/python -m benchmarks.startup

Each figure is the median of several fresh processes, without that of starting Python itself.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import soundspaces_sim as ss

_ROUNDS = 7
_SCRIPT = """
import sys, time
start = time.perf_counter()
import soundspaces_sim as ss
times = [time.perf_counter() - start]
ds = ss.open_dataset(sys.argv[1])
ds.echogram(0, 1)
times.append(time.perf_counter() - start)
ds.binaural(0, 1)
times.append(time.perf_counter() - start)
print(*times)
"""


def startup(folder: Path) -> None:
    """Print medians of seconds since the first line of a script."""
    rounds = []
    for _ in range(_ROUNDS + 1):
        done = subprocess.run(
            [sys.executable, "-c", _SCRIPT, str(folder)], capture_output=True, text=True, check=True
        )
        rounds.append([float(t) for t in done.stdout.split()])
    print(f"seconds in a fresh process, median (and range) of {_ROUNDS}")
    for name, times in zip(
        ("import soundspaces_sim", "… open_dataset, first echogram", "… first binaural response"),
        zip(*rounds[1:], strict=True),  # the first one warms the file cache
        strict=True,
    ):
        print(f"  {name:<32s}{statistics.median(times):6.2f}  ({min(times):.2f} to {max(times):.2f})")


def main() -> None:
    job = ss.JobConfig(
        grid=ss.GridConfig(spacing=3.0, rays=200),
        simulation=ss.SimulationConfig(walks=64, duration=0.5),
    )
    with tempfile.TemporaryDirectory() as temporary:
        startup(ss.build_dataset(ss.load_scene("demo"), temporary, job).folder)


if __name__ == "__main__":
    main()
