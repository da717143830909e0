"""What one room with few pairs costs, with shared transfer subpaths and with those chosen for its points.

Question: How long does a core work at a room with one source and four listeners, and at ten points of a house?

Method: Processor seconds of `simulate` in one thread, and relative errors of its energies by window between runs
with random numbers of their own (root of the mean square over bands and over pairs whose error is below one), of
the same pairs. At 300 subpaths: with transfer subpaths that all points share, as in datasets, and with
``radiance_transfer.subpaths = "auto"``. And as `simulate` is by default: until early and late energy of all pairs
have errors of 5 % in every band, or 4,096 subpaths a point are spent. All settings take turns in every run. What
is kept on disk of a scene (patches, wedges, scattering by size) is there; transfer subpaths are not, as each run
has other random numbers.

Amortised: Nothing but what a scene's files say and what is kept on disk of it.

Takes: Ten minutes. Arguments: runs (8), and scenes with commas (shoebox,home-4,house).
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.energies import WINDOWS_S
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import BOX, house, shoebox, shuffled_points
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count

_WALKS = 300
_KINDS = "shared", "auto", "5 %"
Case = tuple[ss.Scene, np.ndarray, np.ndarray]


def _box() -> Case:
    points = np.random.default_rng(0).uniform(0.4, np.array(BOX) - 0.4, (5, 3))
    return shoebox(), points[:1], points[1:]


def _flat() -> Case:
    scene = ss.load_scene("home-4")
    points = shuffled_points(scene)[:5]
    return scene, points[:1], points[1:]


def _house() -> Case:
    scene = house()
    points = shuffled_points(scene)[:10]
    return scene, points, points


CASES: dict[str, Callable[[], Case]] = {"shoebox": _box, "home-4": _flat, "house": _house}


def _windows(echoes: ss.Echograms) -> np.ndarray:
    """(pairs, windows, b) energies without direct sound."""
    edges, energy = echoes.time_edges, echoes.energy[:, :, :, 0].astype(float)
    out = []
    for low, high in WINDOWS_S:
        rows = (edges[:-1] >= low - 1e-9) & (edges[:-1] < high - 1e-9)
        out.append(energy[:, :, rows].sum(axis=2).reshape(len(echoes), -1))
    return np.stack(out, axis=1)


def _of_case(name: str, case: Case, runs: int) -> list[tuple[object, ...]]:
    scene, sources, listeners = case
    configs = {
        "shared": ss.SimulationConfig(
            walks=_WALKS, radiance_transfer=ss.RadianceTransferConfig(subpaths="shared")
        ),
        "auto": ss.SimulationConfig(
            walks=_WALKS, radiance_transfer=ss.RadianceTransferConfig(subpaths="auto")
        ),
        "5 %": ss.SimulationConfig(),
    }
    seconds: dict[str, list[float]] = {kind: [] for kind in _KINDS}
    energy: dict[str, list[np.ndarray]] = {kind: [] for kind in _KINDS}
    for seed in range(runs + 1):
        for kind, config in configs.items():
            start = time.process_time()
            echoes = ss.simulate(scene, sources, listeners, config, seed)
            seconds[kind].append(time.process_time() - start)
            energy[kind].append(_windows(echoes))
    rows: list[tuple[object, ...]] = []
    errors = {}
    for kind in _KINDS:
        of_runs = np.array(energy[kind][1:])  # the first one loads kernels
        mean = of_runs.mean(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            errors[kind] = of_runs.var(axis=0, ddof=1) / mean**2
    known = np.all([np.nan_to_num(e, nan=np.inf) < 1.0 for e in errors.values()], axis=0)
    for kind in _KINDS:
        error = [
            float(np.sqrt(errors[kind][:, w][known[:, w]].mean())) if known[:, w].any() else None
            for w in range(len(WINDOWS_S))
        ]
        rows.append((name, kind, float(np.median(seconds[kind][1:])), min(seconds[kind][1:]), *error))
    return rows


def run(runs: str = "8", scenes: str = "shoebox,home-4,house") -> list[Table]:
    """The table."""
    before = thread_count()
    set_thread_count(1)
    try:
        rows = [r for name in scenes.split(",") for r in _of_case(name, CASES[name](), int(runs))]
    finally:
        set_thread_count(before)
    windows = [f"{1e3 * a:.0f}–{1e3 * b:.0f} ms" for a, b in WINDOWS_S]
    heads = ["scene", "setting", ("median", "s"), ("least", "s"), *windows]
    return [
        table(
            f"Processor time and relative error by window, {_WALKS} subpaths or an error of 5 %",
            heads,
            rows,
        )
    ]
