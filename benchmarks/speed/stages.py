"""What a pair of a furnished house costs, stage by stage, and what a job would do with more cores.

Question: Which stage takes how much of a pair's time, how much of it runs on one core alone, and how busy would 16
cores be?

Method: The stages of `simulate_pairs` for all pairs of a grid's points in the house with one material (absorption
.2, scattering .3), 1,000 subpaths, on all cores, once. Discrete arrivals apart, in one thread: the tables of
points, and their pairs. Then jobs of the demo and of the house: their tiles by `forecast`, handed out to processes
and threads as on a machine with so many cores and 64 GB, and the share of the cores that has work until the last
tile ends; it is a simulation of the schedule, not a measurement on such a machine.

Amortised: Compiling, and what a scene is prepared for: planes, edges, patches and transfer subpaths.

Takes: Ten minutes. Argument: points (150). Needs ../shared.
"""

from __future__ import annotations

import time

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Cell, Table, table
from benchmarks.tools.scenes import house, one_material, shuffled_points
from soundspaces_sim.build.engines.capacity import choose_shape
from soundspaces_sim.build.estimate import load_shared
from soundspaces_sim.build.forecast import ALONE, forecast, wall_time
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count
from soundspaces_sim.core.profile import Stage, profiled
from soundspaces_sim.transport.arrivals.technique import connect, sight_of
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import simulate_pairs
from soundspaces_sim.transport.tile import make_side, make_tile

_WALKS, _SPACING, _FEW = 1000, 0.6, 12
_LEAST = 0.005  # share of the time, of stages that are shown
_CORES = 2, 16, 64, 256
_MEMORY = 64e9


def _rows(stage: Stage, pairs: int, total: float, depth: int = 0) -> list[tuple[Cell, ...]]:
    name = "\u2003" * depth + stage.name
    rows: list[tuple[Cell, ...]] = [
        (name, stage.total, stage.total / total, 1e3 * stage.total / pairs, stage.cores, stage.alone)
    ]
    for inner in stage.stages:
        if inner.total >= _LEAST * total:
            rows += _rows(inner, pairs, total, depth + 1)
    return rows


def _stages(model: Model, points: np.ndarray) -> Table:
    count = len(points)
    simulate_pairs(model, points[:2], None)  # compiles, and reads what is kept
    with profiled(f"{count} points") as found:
        simulate_pairs(model, points, None)
    heads = (("processor", "s"), "share", ("per ordered pair", "ms"), "busy cores", ("alone", "s"))
    rows = _rows(found.stage, count**2, found.stage.total)
    return table(f"The house, one material, {thread_count()} threads: stages", ["stage", *heads], rows)


def _arrivals(model: Model, points: np.ndarray) -> Table:
    rows = []
    for count in (_FEW, len(points)):
        start = time.process_time()
        side = make_side(model, points[:count])
        side.once(sight_of)
        middle = time.process_time()
        connect(make_tile(side, side))
        end = time.process_time()
        pairs = count * (count + 1) // 2
        rows.append((count, middle - start, end - middle, 1e3 * (end - middle) / pairs))
    heads = ("points", ("of points", "s"), ("of pairs", "s"), ("per pair of both directions", "ms"))
    return table("Discrete arrivals of the house, one thread", heads, rows)


def _schedules() -> Table:
    rows = []
    for name, scene, spacing in (("demo", ss.load_scene("demo"), 0.5), ("house", house(), 1.0)):
        job = ss.JobConfig(grid=ss.GridConfig(spacing=spacing))
        found = forecast(scene, job)
        for cores in _CORES:
            shape = choose_shape(cores, _MEMORY, len(found.tiles))
            wall = wall_time(found.tiles, *shape, cores=cores, alone=ALONE)
            busy = sum(found.tiles) / wall
            rows.append((name, found.points, len(found.tiles), cores, str(shape), busy, busy / cores))
    heads = ("scene", "points", "tiles", "cores", "as", "busy cores", "share")
    return table("Schedules, simulated: cores that have work", heads, rows)


def run(points: str = "150") -> list[Table]:
    """The tables."""
    scene, threads = one_material(house()), thread_count()
    places = shuffled_points(scene, _SPACING)[: int(points)]
    model = make_model(scene, places, ss.SimulationConfig(walks=_WALKS))
    load_shared(model)
    tables = [_stages(model, places)]
    set_thread_count(1)
    try:
        tables.append(_arrivals(model, places))
    finally:
        set_thread_count(threads)
    return [*tables, _schedules()]
