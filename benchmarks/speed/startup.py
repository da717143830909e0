"""How long a fresh process takes to import the package, to read a first echogram and a first response.

Question: How long does a fresh process take to its first echogram and its first response?

Method: Seven fresh processes on a small dataset of the demo; the clock starts at the first line of the script,
so that Python's own start does not count. Median and range, by the clock and of the processor.

Amortised: Nothing: files are in the page cache, and kernels are compiled, after a first process that is not
counted.

Takes: A minute.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table

_ROUNDS = 7
_SCRIPT = """
import sys, time
start, used = time.perf_counter(), time.process_time()
def note():
    print(time.perf_counter() - start, time.process_time() - used)
import soundspaces_sim as ss
note()
ds = ss.open_dataset(sys.argv[1])
ds.echogram(0, 1)
note()
ds.binaural(0, 1)
note()
"""
_STEPS = (
    "`import soundspaces_sim`",
    "… `open_dataset`, first echogram",
    "… first binaural response (loads SciPy, Numba, the HRTF set)",
)


def _startup(folder: Path) -> Table:
    rounds = []
    for _ in range(_ROUNDS + 1):
        done = subprocess.run(
            [sys.executable, "-c", _SCRIPT, str(folder)], capture_output=True, text=True, check=True
        )
        rounds.append([tuple(map(float, line.split())) for line in done.stdout.splitlines()])
    rows = []
    for k, step in enumerate(_STEPS):
        row: list[object] = [step]
        for which in range(2):
            times = [each[k][which] for each in rounds[1:]]
            row += [statistics.median(times), min(times), max(times)]
        rows.append(row)
    heads = [(name, "s") for kind in ("clock", "processor") for name in (kind, "least", "most")]
    return table(f"Since the first line of a script, medians of {_ROUNDS} processes", ["", *heads], rows)


def run() -> list[Table]:
    """The table."""
    job = ss.JobConfig(
        grid=ss.GridConfig(spacing=3.0, rays=200),
        simulation=ss.SimulationConfig(walks=64, duration=0.5),
    )
    with tempfile.TemporaryDirectory() as temporary:
        return [_startup(ss.build_dataset(ss.load_scene("demo"), temporary, job).folder)]
