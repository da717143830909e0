"""Time and memory of waves below the first band's edge.

Question: What do waves cost: of a source, all listeners at once, in memory, and of a whole job?

Method: Up to 176 Hz with 12 cells per wavelength, one thread. Rooms: the solver on eight sources and up to 60
listeners, 0.6 s; processor time of the lattice, and of a source: a batch of eight over eight; empty boxes, the
demo apartment and a flat (furnished). The hall, 25 × 15 × 8 m, is run for 0.3 s, of which the time for 2 s
follows: steps cost alike. Peak memory of the process so far. Jobs: `build_dataset` of 60 points of a flat at the
settings of `make rirs`, without waves and with, processor time of all processes; each once, in this order.

Amortised: Loading the scene, compiling and loading kernels. The lattice is a column of its own.

Takes: Four minutes. Arguments: points (60).
"""

from __future__ import annotations

import resource
import tempfile
import time
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import ROOT, Table, table
from benchmarks.tools.scenes import shuffled_points
from soundspaces_sim.core.numerics.kernel import set_thread_count
from soundspaces_sim.transport.waves.row_algebra import LANES
from soundspaces_sim.transport.waves.scheme import make_wave_scene
from soundspaces_sim.transport.waves.solve import solve

MEASURES = ("transport", "build", "dataset")
_EDGE, _CELLS, _DURATION, _C = 176.0, 12.0, 0.6, 343.0
_HALL, _HALL_S, _HALL_RUN_S = (25.0, 15.0, 8.0), 2.0, 0.3
_BOXES = {"box of 36 m³": (4.0, 3.6, 2.5), "box of 105 m³": (7.0, 6.0, 2.5)}
_LISTENERS = 60
_FLAT, _SPACING = "home-0", 0.8


def _row(name: str, scene: ss.Scene, points: np.ndarray, asked: float, run: float) -> tuple[object, ...]:
    start = time.process_time()
    waves = make_wave_scene(scene, _EDGE, _CELLS, _C)
    made = time.process_time()
    solve(waves, points[:LANES], points, _EDGE, run, None)
    of_source = (time.process_time() - made) / LANES * asked / run
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return name, asked, waves.lattice.cells, len(points), made - start, of_source, peak


def _anywhere(size: tuple[float, float, float]) -> np.ndarray:
    return np.asarray(np.random.default_rng(0).uniform(0.1, 0.9, (_LISTENERS, 3)) * size)


def _processor_s() -> float:
    found = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(x.ru_utime + x.ru_stime for x in found)


def _job(points: np.ndarray, method: Literal["rays", "waves"]) -> tuple[float, float]:
    """s of the processor, MB on the disk."""
    config = ss.load_config(ROOT / "pipelines" / "default.toml")
    low = ss.LowConfig(method=method)
    simulation = msgspec.structs.replace(config.simulation, low=low)
    job = msgspec.structs.replace(config, simulation=simulation)
    start = _processor_s()
    with tempfile.TemporaryDirectory() as out:
        folder = ss.build_dataset(_FLAT, Path(out), job, points=points).folder
        size = sum(path.stat().st_size for path in folder.glob("*.h5"))
        return _processor_s() - start, size / 1e6


def run(points: str = "60") -> list[Table]:
    """The tables."""
    set_thread_count(1)
    small = np.array([[1.0, 1.0, 1.0], [2.0, 1.5, 1.2]])
    solve(make_wave_scene(ss.shoebox((3.0, 3.0, 2.5)), _EDGE, 8.0, _C), small, small, _EDGE, 0.1, None)
    demo, flat = ss.load_scene("demo"), ss.load_scene(_FLAT)
    rows = [
        _row(name, ss.shoebox(size, absorption=0.15), _anywhere(size), _DURATION, _DURATION)
        for name, size in _BOXES.items()
    ]
    places = shuffled_points(flat, _SPACING)[: int(points)]
    rows += [
        _row("home-0", flat, places, _DURATION, _DURATION),
        _row("demo", demo, ss.make_grid(demo, 1.0).points[:_LISTENERS], _DURATION, _DURATION),
        _row("hall of 3,000 m³", ss.shoebox(_HALL, absorption=0.2), _anywhere(_HALL), _HALL_S, _HALL_RUN_S),
    ]  # fmt: skip
    columns = [
        "scene", ("response", "s"), "cells", "listeners", ("lattice", "s"), ("a source, all listeners", "s"),
        ("peak memory", "MB"),
    ]  # fmt: skip
    _job(places[:3], "waves")  # loads kernels
    plain, waves = _job(places, "rays"), _job(places, "waves")
    jobs = [
        ("rays alone", len(places), *plain, 1.0),
        ("with waves", len(places), *waves, waves[0] / plain[0]),
    ]
    of_job = ["home-0", "points", ("processor time", "s"), ("size", "MB"), "over rays alone"]
    return [
        table("Waves up to 176 Hz", columns, rows),
        table("A job at the settings of `make rirs`", of_job, jobs),
    ]
