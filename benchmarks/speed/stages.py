"""What a simulation costs by its stages, and how that grows with the number of points.

Question: Where does the time of a simulation go, and what do a scene, a point and a pair cost?

Method: All pairs of N points of four scenes at 300 subpaths, one thread, with transfer subpaths that all points
share, under `profiled`. Of each size the run of least processor time is taken. The cost model is c0 + c1 N + c2 N²,
whose coefficients, none negative, make the sum of squared relative deviations least.

Amortised: What is kept on disk of a scene (patches, wedges, scattering by size). Transfer subpaths are traced in
every run: they are part of c0.

Takes: Ten minutes. Arguments: scenes with commas (shoebox,home-4,demo,house), points (5,10,20,40) and runs (2).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls

import soundspaces_sim as ss
from benchmarks.tools.record import Cell, Table, table
from benchmarks.tools.scenes import BOX, house, shoebox, shuffled_points
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count

MEASURES = ("core", "scene", "transport", "echogram")
_CONFIG = ss.SimulationConfig(walks=300)
_LEAST_SHARE = 0.01  # of a scene's time, for which a stage has a row


def _of_box() -> tuple[ss.Scene, np.ndarray]:
    return shoebox(), np.random.default_rng(0).uniform(0.4, np.array(BOX) - 0.4, (100, 3))


def _of_grid(scene: ss.Scene) -> tuple[ss.Scene, np.ndarray]:
    return scene, shuffled_points(scene, 0.7)


SCENES: dict[str, Callable[[], tuple[ss.Scene, np.ndarray]]] = {
    "shoebox": _of_box,
    "home-4": lambda: _of_grid(ss.load_scene("home-4")),
    "demo": lambda: _of_grid(ss.load_scene("demo")),
    "house": lambda: _of_grid(house()),
}


def _profiles(name: str, sizes: list[int], runs: int) -> list[ss.Stage]:
    """Of each size, the run that took least; the first simulation loads kernels, and what is kept on disk."""
    scene, points = SCENES[name]()
    if len(points) < max(sizes):
        raise ValueError(f"{name}: expected at least {max(sizes)} points, got {len(points)}")
    ss.simulate(scene, points[:2], points[:2], _CONFIG)
    found = []
    for size in sizes:
        of_size = []
        for run_number in range(runs):
            seed = 1 + size * runs + run_number  # so that no transfer subpaths are found on disk
            with ss.profiled("run") as profile:
                ss.simulate(scene, points[:size], points[:size], _CONFIG, seed)
            of_size.append(profile.stage.stages[0])
        found.append(min(of_size, key=lambda stage: stage.total))
    return found


def cost_model(sizes: list[int], seconds: list[float]) -> np.ndarray:
    """(3,) c0, c1, c2."""
    n, s = np.array(sizes, float), np.array(seconds)
    return np.asarray(nnls(np.stack([n**0, n, n**2], axis=1) / s[:, None], np.ones(len(n)))[0])


def _rows(stage: ss.Stage, whole: float, depth: int = 0) -> list[tuple[str, float, ss.Stage]]:
    found = []
    for inner in sorted(stage.stages, key=lambda s: -s.total):
        if inner.total >= _LEAST_SHARE * whole:
            found.append(("– " * depth + inner.name, inner.total, inner))
            found += _rows(inner, whole, depth + 1)
    return found


def run(
    scenes: str = "shoebox,home-4,demo,house", points: str = "5,10,20,40", runs: str = "2"
) -> list[Table]:
    """The tables."""
    sizes, names, before = [int(n) for n in points.split(",")], scenes.split(","), thread_count()
    set_thread_count(1)
    try:
        found = {name: _profiles(name, sizes, int(runs)) for name in names}
    finally:
        set_thread_count(before)
    model: list[tuple[Cell, ...]] = []
    for name, stages in found.items():
        seconds = [stage.total for stage in stages]
        c0, c1, c2 = cost_model(sizes, seconds)
        model.append((name, *seconds, c0, c1, 1e3 * c2))
    heads = ["scene", *((f"{n} points", "s") for n in sizes), ("c0", "s"), ("c1", "s"), ("c2", "ms")]
    tables = [table("All pairs of N points at 300 subpaths, and c0 + c1 N + c2 N²", heads, model)]
    for name, stages in found.items():
        stage, most = stages[-1], sizes[-1]
        rows: list[tuple[Cell, ...]] = []
        for what, total, inner in _rows(stage, stage.total):
            numbers = [
                inner.counted(kind) / most**2 or None for kind in ("rays", "deposits", "products")
            ]
            rows.append((what, total, total / stage.total, *numbers))
        columns = ["stage", ("processor", "s"), "share", "rays", "deposits", "products"]
        note = "Rays, deposits and products per ordered pair. Stages under a hundredth are left out."
        tables.append(table(f"{name}, {most} points, {stage.total:.3g} s", columns, rows, note))
    return tables
