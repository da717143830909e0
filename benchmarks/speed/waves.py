"""Time and memory of waves below the first band's edge.

Question: How long does the solver of waves take for a source, all listeners at once, and how much memory?

Method: `simulate_low` of eight sources and up to 60 listeners, 0.6 s, up to 176 Hz with 12 cells per
wavelength, one thread; an empty box of 180 m³ and the demo apartment (furnished, 1 m grid). Processor time of
the lattice and of a source: a batch of eight over eight. Peak memory of the process so far.

Amortised: Loading the scene, compiling and loading kernels. The lattice is a column of its own.

Takes: A minute.
"""

from __future__ import annotations

import resource
import time

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from soundspaces_sim.core.numerics.kernel import set_thread_count
from soundspaces_sim.transport.waves.row_algebra import LANES
from soundspaces_sim.transport.waves.scheme import make_wave_scene
from soundspaces_sim.transport.waves.solve import solve

MEASURES = ("transport/waves",)
_EDGE, _CELLS, _DURATION, _C = 176.0, 12.0, 0.6, 343.0
_BOX = (9.0, 8.0, 2.5)
_LISTENERS = 60


def _row(name: str, scene: ss.Scene, points: np.ndarray) -> tuple[object, ...]:
    start = time.process_time()
    waves = make_wave_scene(scene, _EDGE, _CELLS, _C)
    made = time.process_time()
    solve(waves, points[:LANES], points, _EDGE, _DURATION, None)
    of_source = (time.process_time() - made) / LANES
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return name, waves.lattice.cells, len(points), made - start, of_source, peak


def run() -> list[Table]:
    """The table."""
    set_thread_count(1)
    small = np.array([[1.0, 1.0, 1.0], [2.0, 1.5, 1.2]])
    solve(make_wave_scene(ss.shoebox((3.0, 3.0, 2.5)), _EDGE, 8.0, _C), small, small, _EDGE, 0.1, None)
    demo = ss.load_scene("demo")
    anywhere = np.random.default_rng(0).uniform(0.1, 0.9, (_LISTENERS, 3)) * _BOX
    rows = [
        _row("box of 180 m³", ss.shoebox(_BOX, absorption=0.15), anywhere),
        _row("demo", demo, ss.make_grid(demo, 1.0).points[:_LISTENERS]),
    ]
    columns = [
        "scene", "cells", "listeners", ("lattice", "s"), ("a source, all listeners", "s"), ("peak memory", "MB"),
    ]  # fmt: skip
    return [table("Waves up to 176 Hz, 0.6 s", columns, rows)]
