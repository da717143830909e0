"""What counts of reflections cost, and how fast materials change on reading.

Question: What does counting reflections cost in time and bytes, and how many echograms a second can have other
materials?

Method: One tile of the demo with 24 points, with and without counts, in turn, processor time, three times each; the
shard of either, bytes per pair; and echograms with other absorption, from open records and from files, per second
of one core.

Amortised: Compiling and loading kernels, and preparing the scene; transfer subpaths are traced in every run.

Takes: 10 minutes. Arguments: points (24).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.shards import encoded
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.preparation import at_duration, prepare_scene

MEASURES = ("core", "scene", "transport", "echogram", "dataset")
RUNS, LENGTH_S = 3, 0.6


def _seconds(make: Callable[[], Any]) -> tuple[float, Any]:
    start = time.process_time()
    made = make()
    return time.process_time() - start, made


def run(points: str = "24") -> list[Table]:
    """Two tables: cost, and rates of reading."""
    scene = ss.load_scene("demo")
    places = ss.make_grid(scene, 0.5).points
    places = places[np.random.default_rng(0).permutation(len(places))[: int(points)]]
    seconds: dict[bool, list[float]] = {False: [], True: []}
    bytes_, shard = {}, None
    for turn in range(-1, RUNS):  # the first one compiles
        for counted in (False, True):
            config = ss.SimulationConfig(
                duration=LENGTH_S, materials=ss.MaterialsConfig(enabled=counted)
            )
            model = at_duration(prepare_scene(scene, config), LENGTH_S)
            taken, made = _seconds(lambda model=model: simulate_tile(model, places, None)[0])
            if turn >= 0:
                seconds[counted].append(taken)
            if turn == RUNS - 1:
                index = np.arange(len(places))
                shard = encoded(made, index, index)
                bytes_[counted] = len(shard) / len(places) ** 2
    assert shard is not None
    median = {counted: float(np.median(found)) for counted, found in seconds.items()}
    cost = [
        ("without counts", median[False], 1.0, bytes_[False]),
        ("with counts", median[True], median[True] / median[False], bytes_[True]),
    ]
    columns = ("tile", "s of the processor", "ratio", "bytes a pair")
    return [table("Counting reflections", columns, cost), _reading(shard, len(places))]


def _reading(content: bytes, points: int) -> Table:
    shard = EchogramShard(content)
    pairs = [(k % points, (5 * k + 1) % points) for k in range(400)]
    name = shard.counts.groups.names[1]  # type: ignore[union-attr]
    change = {name: 1.2 * shard.counts.groups.absorption[1]}  # type: ignore[union-attr]
    plain, records = _seconds(lambda: [shard.echogram(s, l, counts=True) for s, l in pairs])
    change_alone, _ = _seconds(lambda: [ss.refurnished(e, change, force=True) for e in records])
    rows = [
        ("echograms with counts, from a file", len(pairs) / plain),
        ("other materials, from records", len(pairs) / change_alone),
        ("both", len(pairs) / (plain + change_alone)),
    ]
    shard.close()
    return table("Echograms with other materials", ("what", "per second of one core"), rows)
