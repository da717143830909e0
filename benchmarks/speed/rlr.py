"""The genuine rlr_audio_propagation beside `soundspaces_sim.rlr`: seconds per `simulate`.

Question: How long do both take for a simulation at equal error, and after an object has moved?

Method: aws_small_house, one thread, the processor's seconds in `simulate`, medians of three. The error compared
at is that of the energy in windows of time after the direct sound's, in the band from 775 to 3,409 Hz, over 8
runs with fresh noise, less what the noise of a waveform alone makes of it, 1 / (bandwidth × window) in relative
variance; ours is interpolated in logarithms. Sources × listeners; 4 × 32 are the capsules of an array 8 cm
wide, which ours simulates as one. Moves: one pair, a box of .6 m in the house, medians of three contexts; ours
must give the bits of a context made afresh.

Amortised: What is prepared once is not in the seconds per `simulate`; it is in the first one of the table of
moves.

Takes: 20 minutes. Needs ../shared and rlr-audio-propagation 0.0.1 (licensed for non-commercial use).
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.rlr import RATE, SPEED, context, genuine, populate, responses
from benchmarks.tools.scenes import house, shuffled_points
from soundspaces_sim.echogram.filters import band_windows
from soundspaces_sim.rlr import api, propagation

MEASURES = ("core", "scene", "transport", "echogram", "rendering", "rlr")
WINDOWS_S = (0.0, 0.05, 0.1, 0.2, 0.35)
LOW, HIGH = 775.0, 3409.0
OUR_RAYS, THEIR_RAYS = (312, 1250, 5000, 20000), (250, 1000, 5000)  # ascending

Case = tuple[str, np.ndarray, np.ndarray]


def _window_energies(irs: np.ndarray, onset: np.ndarray) -> np.ndarray:
    """(k, windows) energy of the band in windows of time after the direct sound's time (k,) in s."""
    n = 2 * irs.shape[1]
    frequency = np.fft.rfftfreq(n, 1.0 / RATE)
    gain = np.sqrt(band_windows((0.0, LOW, HIGH, 20000.0), frequency, RATE)[1])
    band = np.fft.irfft(np.fft.rfft(irs, n, axis=1) * gain, n, axis=1)[:, : irs.shape[1]] ** 2
    total = np.concatenate([np.zeros((len(irs), 1)), band.cumsum(axis=1)], axis=1)
    cuts = np.rint((onset[:, None] + np.array(WINDOWS_S)) * RATE).astype(int)
    return np.asarray(np.diff(np.take_along_axis(total, cuts, axis=1), axis=1))


def _errors(
    module: ModuleType, made: Any, sources: np.ndarray, listeners: np.ndarray, runs: int
) -> np.ndarray:
    """(windows,) relative error of energies over runs with fresh noise."""
    populate(module, made, sources, listeners)
    offsets = (sources[:, None] - listeners[None]).reshape(-1, 3)
    onset = np.linalg.norm(offsets, axis=1) / SPEED
    energies = []
    for run in range(runs):
        with patch.object(propagation, "SEED", 1 + run):
            made.simulate()
        energies.append(_window_energies(responses(made, len(sources), len(listeners)), onset))
    values = np.array(energies)
    spread = (values.var(axis=0, ddof=1) / values.mean(axis=0) ** 2).mean(axis=0)
    noise = 1.0 / ((HIGH - LOW) * np.diff(WINDOWS_S))
    return np.sqrt(np.maximum(spread - noise, 1e-6))


def _seconds(
    module: ModuleType,
    made: Any,
    sources: np.ndarray,
    listeners: np.ndarray,
    runs: int,
    enough: float = 60.0,
) -> float:
    """Median of the processor's seconds in `simulate`, of `runs`, or fewer if they take longer than `enough` s
    together; what is prepared once has been."""
    populate(module, made, sources, listeners)
    found: list[float] = []
    while len(found) < runs and sum(found) < enough:
        start = time.process_time()
        made.simulate()
        found.append(time.process_time() - start)
    return float(np.median(found))


def _at_equal_error(
    module: ModuleType, scene: ss.Scene, cases: Sequence[Case], runs: int
) -> list[Table]:
    """Errors (of the second case: a pair's does not depend on the number of pairs), seconds, their ratios."""
    windows = [f"{round(a * 1e3)}–{round(b * 1e3)} ms" for a, b in itertools.pairwise(WINDOWS_S)]
    names = [name for name, _, _ in cases]
    found: dict[str, list[tuple[int, np.ndarray, np.ndarray]]] = {"ours": [], "theirs": []}
    rows = []
    for who, each, rays in [("ours", api, n) for n in OUR_RAYS] + [
        ("theirs", module, n) for n in THEIR_RAYS
    ]:
        made = context(each, scene, rays)
        error = _errors(each, made, cases[1][1], cases[1][2], runs)
        times = np.array([_seconds(each, made, a, b, 3) for _, a, b in cases])
        found[who].append((rays, error, times))
        rows.append((who, rays, *error, *times))
    heads = ["engine", "rays", *windows, *((name, "s") for name in names)]
    first = table(
        "Relative error of energies by window, processor's seconds by sources × listeners", heads, rows
    )
    ratios = []
    for rays, error, times in found["theirs"]:
        for k, name in enumerate(names):
            cells: list[object] = []
            for w in range(len(windows)):
                known = np.log([(e[w], t[k]) for _, e, t in found["ours"]][::-1])
                inside = known[0, 0] <= np.log(error[w]) <= known[-1, 0]
                own = np.exp(np.interp(np.log(error[w]), known[:, 0], known[:, 1]))
                cells.append(times[k] / own if inside else None)
            ratios.append((rays, name, *cells))
    title = "Seconds, theirs over ours at the error of theirs; empty beyond the settings of ours that were measured"
    return [first, table(title, ["their rays", "sources × listeners", *windows], ratios)]


def _furnished(each: ModuleType, scene: ss.Scene, place: np.ndarray, points: np.ndarray) -> Any:
    """A context with a box at a place in the scene, and one pair."""
    made = context(each, scene)
    made.add_object()
    made.set_object_box(1, [-0.3] * 3, [0.3] * 3, each.BoxMaterialCategories())
    made.set_object_position(1, place.tolist())
    populate(each, made, points[:1], points[1:2])
    return made


def _timed(made: Any) -> float:
    start = time.process_time()
    made.simulate()
    return time.process_time() - start


def _moves(module: ModuleType, scene: ss.Scene, points: np.ndarray, runs: int) -> Table:
    table_rows = []
    for who, each in (("ours", api), ("theirs", module)):
        rows = []
        for k in range(runs):
            places = points[2 + 2 * k : 4 + 2 * k]
            made = _furnished(each, scene, places[0], points)
            row = [_timed(made), _timed(made)]
            made.set_object_position(1, places[1].tolist())
            rows.append([*row, _timed(made)])
            if each is api:
                fresh = _furnished(each, scene, places[1], points)
                fresh.simulate()
                if not np.array_equal(responses(made, 1, 1), responses(fresh, 1, 1)):
                    raise AssertionError("a moved object left something behind")
        table_rows.append((who, *np.median(rows, axis=0)))
    heads = ["engine", ("first", "s"), ("again", "s"), ("after a move", "s")]
    return table("Processor's seconds of `simulate`, one pair, a box that moves", heads, table_rows)


def run() -> list[Table]:
    """Speed at equal error, and moves."""
    module, scene = genuine(), house()
    points = shuffled_points(scene)
    cases = [
        ("1 × 1", points[:1], points[6:7]),
        ("6 × 6", points[:6], points[6:12]),
        ("4 × 32", points[:4], points[6] + 0.042 * _sphere(32)),
    ]
    return [*_at_equal_error(module, scene, cases, 8), _moves(module, scene, points, 3)]


def _sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors spread over the sphere."""
    i = np.arange(count) + 0.5
    z, phi = 1.0 - 2.0 * i / count, i * np.pi * (3.0 - np.sqrt(5.0))
    return np.column_stack([np.sqrt(1.0 - z * z) * np.cos(phi), np.sqrt(1.0 - z * z) * np.sin(phi), z])
