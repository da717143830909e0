"""Rays through Embree alone, without any acoustics.

Question: How many rays per second does the ray tracer alone follow in the house?

Method: Random walks of at most 100 reflections that do nothing but go on, from 60 points of aws_small_house,
1,000 walks each; rays over seconds, by the clock and of the processor, with one thread and with all; best of
three.

Amortised: Loading the scene, building its tree, compiling and loading kernels.

Takes: A minute. Needs ../shared.
"""

from __future__ import annotations

import time

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import house, shuffled_points
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.scene.rays.diffuse_walk import diffuse_walks

MEASURES = ("scene",)
_POINTS, _WALKS, _LONGEST, _ROUNDS = 60, 1000, 100, 3


def _rates(scene: ss.Scene) -> tuple[float, float]:
    """Million rays per second, by the clock and of the processor."""
    points = shuffled_points(scene)[:_POINTS]
    local, keys = points - scene.center, point_keys(points, 0)
    geometry, materials = scene.geometry, len(scene.materials.names)
    diffuse_walks(geometry, local[:1], keys[:1], 8, 10, materials)
    found = []
    for _ in range(_ROUNDS):
        start, used = time.perf_counter(), time.process_time()
        hits = float(diffuse_walks(geometry, local, keys, _WALKS, _LONGEST, materials).hits.sum()) / 1e6
        found.append((hits / (time.perf_counter() - start), hits / (time.process_time() - used)))
    return max(f[0] for f in found), max(f[1] for f in found)


def run() -> list[Table]:
    """The table."""
    scene = house()
    both = thread_count()
    rows = []
    for threads in sorted({1, both}):
        set_thread_count(threads)
        rows.append((threads, *_rates(scene)))
    set_thread_count(both)
    return [
        table(
            f"{scene.name}, {len(scene.faces):,} triangles",
            ["threads", ("by the clock", "M rays/s"), ("per processor's second", "M rays/s")],
            rows,
        )
    ]
