"""What cutting a job into tiles costs, with and without keeping what was traced for tiles to come.

Question: How much more than one simulation of all pairs does a job cost that is cut into tiles?

Method: Processor seconds of all pairs of some points of the demo, in this process: as one table; as the tiles of so
many blocks, each made alone; as the same tiles one after the other, each keeping for the others what it traces; in
squares of some tiles, simulated as one and cut apart, which keep traces for each other (as a job in one process
where memory is short); and as one square (where it is not). Nothing is written. They take turns; medians.

Amortised: The scene's preparation and the transfer subpaths that all points share are made before.

Takes: Ten minutes. Arguments: points (60), blocks (4), subpaths (1000), runs (2), blocks on a side of a square (2),
the points' grid in metres (0.7).
"""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from tempfile import gettempdir

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import shuffled_points
from soundspaces_sim.build.estimate import load_shared
from soundspaces_sim.echogram.assembly import cut
from soundspaces_sim.transport.kept_traces import KeptTraces
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import simulate_pairs


def _tiles(model: Model, blocks: list[np.ndarray], kept: KeptTraces | None) -> None:
    tiles = [
        (blocks[i], None if i == j else blocks[j])
        for i, j in itertools.combinations_with_replacement(range(len(blocks)), 2)
    ]
    for number, tile in enumerate(tiles):
        if kept is not None:
            kept.expect(tiles[number:])
        simulate_pairs(model, *tile, kept=kept)


def _squares(model: Model, blocks: list[np.ndarray], across: int) -> None:
    """Tiles in squares of so many blocks, cut apart."""
    groups = [blocks[k : k + across] for k in range(0, len(blocks), across)]
    kept = KeptTraces(model, Path(gettempdir())) if len(groups) > 1 else None
    pairs = [*itertools.combinations_with_replacement([np.concatenate(g) for g in groups], 2)]
    todo = [(a, None if a is b else b) for a, b in pairs]
    for number, square in enumerate(todo):
        if kept is not None:
            kept.expect(todo[number:])
        for echoes in filter(None, simulate_pairs(model, *square, kept=kept)):
            parts = [np.array_split(np.arange(points), across) for points in echoes.shape]
            for rows, columns in itertools.product(*parts):
                cut(echoes, slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))


def run(
    points: str = "60",
    blocks: str = "4",
    subpaths: str = "1000",
    runs: str = "2",
    across: str = "2",
    spacing: str = "0.7",
) -> list[Table]:
    """The table."""
    scene = ss.load_scene("demo")
    places = shuffled_points(scene, float(spacing))[: int(points)]
    model = make_model(scene, places, ss.SimulationConfig(walks=int(subpaths)))
    load_shared(model)
    simulate_pairs(model, places[:2], None)  # loads kernels
    pieces = np.array_split(places, int(blocks))
    ways = {
        "one table": lambda: simulate_pairs(model, places, None),
        "tiles, each alone": lambda: _tiles(model, pieces, None),
        "tiles, one after the other": lambda: _tiles(
            model, pieces, KeptTraces(model, Path(gettempdir()))
        ),
        f"squares of {across} × {across} blocks": lambda: _squares(model, pieces, int(across)),
        "one square": lambda: _squares(model, pieces, int(blocks)),
    }
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(int(runs)):
        for name, make in ways.items():
            start = time.process_time()
            make()
            seconds[name].append(time.process_time() - start)
    one = float(np.median(seconds["one table"]))
    rows = [(name, float(np.median(s)), float(np.median(s)) / one) for name, s in seconds.items()]
    heads = ["made as", ("processor", "s"), "over one table"]
    return [table(f"{len(places)} points in {blocks} blocks, {subpaths} subpaths", heads, rows)]
