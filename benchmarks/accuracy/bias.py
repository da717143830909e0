"""What radiance transfer adds to late energy, or takes: against receiver volumes alone, which are unbiased.

Question: How large is the bias of late energy by radiance transfer?

Method: Seven scenes. Energies in windows, summed over all pairs of eight points, with and without radiance
transfer: ten times the logarithm of their ratio in the four bands, and its standard error over seeds. Wanted:
within .1 dB.

Amortised: Nothing is timed.

Takes: Hours. Argument: the number of seeds (24). Needs ../shared.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import house, one_material
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import simulate_pairs
from tests.rooms import box, table as materials, two_rooms

WINDOWS_S = ((0.05, 0.1), (0.1, 0.2), (0.2, 0.35))
POINTS = 8


def scenes() -> dict[str, Callable[[], ss.Scene]]:
    """Scenes by name."""
    mixed = materials([0.1, 0.6, 0.25], [0.1, 0.7, 0.4])
    return {
        "demo": lambda: ss.load_scene("demo"),
        "home-1": lambda: ss.load_scene("home-1"),
        "seminar room": lambda: box((9.0, 7.0, 3.0), mixed, [0, 0, 0, 2, 2, 1]),
        "corridor": lambda: box((20.0, 2.0, 2.6), mixed, [2, 2, 0, 0, 0, 1]),
        "two rooms": lambda: two_rooms(materials(0.3, 0.5), 0),
        "house, as labelled": house,
        "house, one material": lambda: one_material(house()),
    }


def energies(scene: ss.Scene, points: np.ndarray, transfer: bool, seeds: int) -> np.ndarray:
    """(seeds, windows, bands): sums over pairs of two different points."""
    config = ss.SimulationConfig(
        duration=0.4, radiance_transfer=ss.RadianceTransferConfig(enabled=transfer)
    )
    model = make_model(scene, points, config)
    out = []
    for seed in range(seeds):
        echoes = simulate_pairs(replace(model, seed=1 + seed + seeds * transfer), points, None)[0]
        starts = echoes.time_edges[:-1]
        late = np.stack([(starts > a - 1e-9) & (starts < b - 1e-9) for a, b in WINDOWS_S])
        apart = ~np.eye(len(points), dtype=bool)
        out.append(late.astype(float) @ echoes.energy[apart][:, :, 0].astype(float).sum(axis=0))
    return np.array(out)


def run(count: str = "24") -> list[Table]:
    """dB with standard errors, by scene and window."""
    house()  # fail before the hours
    seeds, rows = int(count), []
    for name, load in scenes().items():
        scene = load()
        grid = ss.make_grid(scene, 1.0).points
        points = grid[np.linspace(0, len(grid) - 1, POINTS).astype(int)]
        found = [energies(scene, points, transfer, seeds) for transfer in (True, False)]
        transfer, volumes = (of.mean(axis=0) for of in found)
        error = np.hypot(*(of.std(axis=0, ddof=1) / of.mean(axis=0) for of in found)) / np.sqrt(seeds)
        cells = [
            "/".join(f"{x:+.2f}" for x in row) + " ± " + "/".join(f"{x:.2f}" for x in 4.34 * e)
            for row, e in zip(10.0 * np.log10(transfer / volumes), error, strict=True)
        ]
        rows.append((name, *cells))
    windows = [f"{1e3 * a:.0f}–{1e3 * b:.0f} ms" for a, b in WINDOWS_S]
    note = f"Bands to 176, 775, 3,409 Hz and 20 kHz; {seeds} seeds of each."
    return [table("dB with standard errors, four bands", ["scene", *windows], rows, note)]
