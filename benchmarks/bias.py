"""What the middle adds to late energy, or takes: against hits alone, which are unbiased, in seven scenes.

    .venv/bin/python -m benchmarks.bias [seeds]

Energies in windows, summed over all pairs of eight points, with and without `merging`: ten times the logarithm of
their ratio in the four bands, and its standard error over seeds. Scenes of ../shared are left out without it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from benchmarks.alternatives import one_material
from benchmarks.engine import HOUSE
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import simulate_pairs
from tests.rooms import box, table, two_rooms

WINDOWS_S = ((0.05, 0.1), (0.1, 0.2), (0.2, 0.35))
POINTS = 8


def scenes() -> dict[str, Callable[[], ss.Scene]]:
    """Scenes by name."""
    mixed = table([0.1, 0.6, 0.25], [0.1, 0.7, 0.4])
    found: dict[str, Callable[[], ss.Scene]] = {
        "demo": lambda: ss.load_scene("demo"),
        "flat-1": lambda: ss.load_scene("flat-1"),
        "seminar room": lambda: box((9.0, 7.0, 3.0), mixed, [0, 0, 0, 2, 2, 1]),
        "corridor": lambda: box((20.0, 2.0, 2.6), mixed, [2, 2, 0, 0, 0, 1]),
        "two rooms": lambda: two_rooms(table(0.3, 0.5), 0),
    }
    if HOUSE.exists():
        found["house, as labelled"] = lambda: ss.load_scene(HOUSE)
        found["house, one material"] = lambda: one_material(ss.load_scene(HOUSE))
    return found


def energies(scene: ss.Scene, points: np.ndarray, merging: bool, seeds: int) -> np.ndarray:
    """(seeds, windows, bands): sums over pairs of two different points."""
    config = ss.SimulationConfig(duration=0.4, merging=merging)
    model = make_model(scene, points, config)
    out = []
    for seed in range(seeds):
        echoes = simulate_pairs(replace(model, seed=1 + seed + seeds * merging), points, None)[0]
        starts = echoes.time_edges[:-1]
        late = np.stack([(starts > a - 1e-9) & (starts < b - 1e-9) for a, b in WINDOWS_S])
        apart = ~np.eye(len(points), dtype=bool)
        out.append(late.astype(float) @ echoes.energy[apart][:, :, 0].astype(float).sum(axis=0))
    return np.array(out)


def main(seeds: int = 24) -> None:
    print("| dB, s.e. | " + " | ".join(f"{1e3 * a:.0f}–{1e3 * b:.0f} ms" for a, b in WINDOWS_S) + " |")
    print("|---" * (1 + len(WINDOWS_S)) + "|")
    for name, load in scenes().items():
        scene = load()
        grid = ss.make_grid(scene, 1.0).points
        points = grid[np.linspace(0, len(grid) - 1, POINTS).astype(int)]
        found = [energies(scene, points, merging, seeds) for merging in (True, False)]
        middle, hits = (of.mean(axis=0) for of in found)
        error = np.hypot(*(of.std(axis=0, ddof=1) / of.mean(axis=0) for of in found)) / np.sqrt(seeds)
        decibels = 10.0 * np.log10(middle / hits)
        cells = [
            "/".join(f"{x:+.2f}" for x in row) + " ± " + "/".join(f"{x:.2f}" for x in 4.34 * e)
            for row, e in zip(decibels, error, strict=True)
        ]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:2]))
