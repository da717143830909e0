"""Other materials on reading, against simulations of them.

Question: How far are echograms with other absorption, made of counts of reflections, from simulations with that
absorption?

Method: Per scene and change of materials, T20 and 10 ms bins down to -30 dB of pairs of four points: of echograms
whose materials were changed on reading, against the mean of simulations of the changed scene by other walks;
and one of these against the mean of the others, which is what noise alone makes. Medians over pairs and bands. A
change is every absorption times a factor between a half and two, drawn anew for each material. Beside it the bound
that the closure states, and how many of the pairs refuse the change.

Amortised: Compiling and loading kernels.

Takes: an hour. Arguments: scenes (demo, house). Needs ../shared for the house.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import house
from soundspaces_sim.echogram.measures import room_measures
from soundspaces_sim.echogram.refurnish import MOST_DB, absorption_of, closure_error_db

MEASURES = ("core", "scene", "transport", "echogram")
CHANGES, SEEDS, LENGTH_S, RANGE_DB = 6, 3, 0.8, 30.0
_SCENES = {"demo": lambda: ss.load_scene("demo"), "house": house}


def _points(scene: ss.Scene) -> np.ndarray:
    grid = ss.make_grid(scene, 1.0).points
    return grid[np.random.default_rng(0).permutation(len(grid))[:4]]


def _changed(scene: ss.Scene, names: tuple[str, ...], rng: np.random.Generator) -> ss.MaterialTable:
    """Every absorption times a factor between a half and two, of those materials that are counted."""
    materials = scene.materials
    factor = 2.0 ** rng.uniform(-1.0, 1.0, len(materials.names))
    most = 0.98 - materials.transmission
    other = np.minimum(materials.absorption * factor[:, None], np.maximum(most, materials.absorption))
    counted = np.isin(materials.names, names)[:, None]
    return replace(materials, absorption=np.where(counted, other, materials.absorption))


def _levels(echogram: ss.Echogram) -> np.ndarray:
    """(bands, bins) dB; NaN of bins after the decay has reached -30 dB, and of empty ones."""
    energy = echogram.histogram(0.01)
    left = energy[:, ::-1].cumsum(axis=1)[:, ::-1]
    heard = (left > 10.0 ** (-RANGE_DB / 10.0) * left[:, :1]) & (energy > 0.0)
    return np.where(heard, 10.0 * np.log10(np.where(heard, energy, 1.0)), np.nan)


def _compare(found: ss.Echogram, truth: list[ss.Echogram]) -> tuple[float, float]:
    """Median error of T20, %, and of bins, dB, against the mean of some simulations."""
    mean = np.mean([room_measures(t).t20 for t in truth], axis=0)
    t20 = 100.0 * np.abs(room_measures(found).t20 / mean - 1.0)
    energy = np.mean([t.histogram(0.01) for t in truth], axis=0)
    level = 10.0 * np.log10(np.where(energy > 0.0, energy, np.nan))
    return float(np.nanmedian(t20)), float(np.nanmedian(np.abs(_levels(found) - level)))


def _rows(name: str, scene: ss.Scene) -> list[tuple[object, ...]]:
    points, config = _points(scene), ss.SimulationConfig(duration=LENGTH_S)
    counted = ss.SimulationConfig(duration=LENGTH_S, materials=ss.MaterialsConfig(enabled=True))
    base = ss.simulate(scene, points[:2], points[2:], counted)
    rows: list[tuple[object, ...]] = []
    rng = np.random.default_rng(1)
    for number in range(CHANGES):
        assert base.counts is not None
        materials = _changed(scene, base.counts.groups.names, rng)
        other = replace(scene, materials=materials)
        truth = [
            ss.simulate(other, points[:2], points[2:], config, seed=1 + k) for k in range(SEEDS + 1)
        ]
        errors, noise, bounds = [], [], []
        for s in range(2):
            for l in range(2):
                pair = base[s, l]
                absorption = absorption_of(base.counts.groups, pair.bands, materials)
                changed = ss.refurnished(pair, absorption, force=True)
                errors.append(_compare(changed, [t[s, l] for t in truth[:-1]]))
                noise.append(_compare(truth[-1][s, l], [t[s, l] for t in truth[:-1]]))
                bounds.append(closure_error_db(pair, absorption))
        (t20, bins), (of_t20, of_bins) = np.median(errors, axis=0), np.median(noise, axis=0)
        refused = int((np.array(bounds) > MOST_DB).sum())
        rows.append((name, number + 1, t20, of_t20, bins, of_bins, float(np.median(bounds)), refused))
    return rows


def run(*arguments: str) -> list[Table]:
    """One row per scene and change."""
    rows = [row for name in arguments or tuple(_SCENES) for row in _rows(name, _SCENES[name]())]
    columns = (
        "scene", "change", "T20: error, %", "noise, %", "bins: error, dB", "noise, dB", "bound, dB",
        "refused, of 4",
    )  # fmt: skip
    return [table("Materials changed on reading against simulations of the change", columns, rows)]
