"""Other materials on reading, against the same walks with other materials.

Question: How far are echograms with other absorption, made of counts of reflections, from what the same walks carry
with that absorption?

Method: Per scene and change of materials, pairs of four points. A model has the scene's four bands twice, with the
old and with the new absorption, so that one run of the same 8,000 walks gives both, and noise cancels but for what
bins differ by within a window of counts: that is why 50 ms stand beside 10 ms. Without air and diffraction, which
depend on frequency. T20, 10 ms and 50 ms of energy down to -30 dB: of the old bands, changed on reading, against
the new ones; medians over pairs and bands. A change is every absorption times a factor between a half and two,
drawn anew for each material; and that of the most frequent material alone, to .6. Beside it the error that the
closure states, how many of the pairs refuse the change, and z-scores of early and late energy against another
simulation of the changed scene.

Amortised: Compiling and loading kernels.

Takes: 40 minutes. Arguments: scenes (demo, house, studio). Needs ../shared for the last two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from benchmarks.accuracy.ptb_studio import load_studio
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import house
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.measures import room_measures
from soundspaces_sim.echogram.refurnish import MOST_DB, closure_error_db
from soundspaces_sim.transport.reflection_counts.groups import material_groups

MEASURES = ("core", "scene", "transport", "echogram")
CHANGES, LENGTH_S, LEVEL_DB, BANDS, WALKS = 6, 0.5, 30.0, 4, 8000
_OCTAVES = 62.5 * 2.0 ** np.arange(2 * BANDS)  # carry the four bands twice
_EDGES = tuple(62.5 * 2.0 ** (np.arange(2 * BANDS + 1) - 0.5))
_CONFIG = ss.SimulationConfig(
    bands=_EDGES, walks=WALKS, duration=LENGTH_S, air_absorption=False, diffraction={"enabled": False},
    scattering="table", materials={"enabled": True},
)  # fmt: skip
_SCENES: dict[str, Callable[[], ss.Scene]] = {
    "demo": lambda: ss.load_scene("demo"), "house": house, "studio": lambda: load_studio("open")[0],
}  # fmt: skip


def _points(scene: ss.Scene) -> np.ndarray:
    grid = ss.make_grid(scene, 1.0).points
    return grid[np.random.default_rng(0).permutation(len(grid))[:4]]


def _doubled(scene: ss.Scene, old: np.ndarray, new: np.ndarray) -> ss.Scene:
    """The scene with absorption `old` (m, 4) in its first four bands and `new` in the others."""
    materials = scene.materials
    _, scattering, transmission = materials.in_bands(DEFAULT_BANDS)
    twice = (np.concatenate(two, axis=1) for two in ((old, new), (scattering,) * 2, (transmission,) * 2))
    columns = ss.MaterialTable(
        materials.names, _OCTAVES, *twice, reflection=materials.reflection, mounting=materials.mounting
    )
    return replace(scene, materials=columns)


def _changed(
    scene: ss.Scene, names: tuple[str, ...], rng: np.random.Generator | None
) -> tuple[np.ndarray, np.ndarray]:
    """(m, 4) absorption before, and after: every counted one times a factor between a half and two, at most what
    is not transmitted; or without `rng` that of the most frequent material .6."""
    absorption, _, transmission = scene.materials.in_bands(DEFAULT_BANDS)
    if rng is None:
        counted = np.array(scene.materials.names) == names[0]
        other = np.full_like(absorption, 0.6)
    else:
        counted = np.isin(scene.materials.names, names)
        other = absorption * 2.0 ** rng.uniform(-1.0, 1.0, len(absorption))[:, None]
    most = np.maximum(0.98 - transmission, absorption)
    return absorption, np.where(counted[:, None], np.minimum(other, most), absorption)


def _levels(energy: np.ndarray, heard: np.ndarray, width: int) -> np.ndarray:
    """dB of `width` bins together, NaN where not all are `heard`."""
    whole = energy.shape[1] // width * width
    sums, all_heard = (a[:, :whole].reshape(len(a), -1, width) for a in (energy, heard))
    level = 10.0 * np.log10(np.maximum(sums.sum(axis=2), 1e-300))
    return np.where(all_heard.all(axis=2), level, np.nan)


def _split(echogram: ss.Echogram, bands: slice) -> np.ndarray:
    """(2, bands) energy up to 80 ms after the first sound, and later."""
    bins = echogram.histogram(0.01)[bands]
    onset = int((bins.sum(axis=0) > 0.0).argmax()) + 8
    return np.stack([bins[:, :onset].sum(axis=1), bins[:, onset:].sum(axis=1)])


def _compare(pair: ss.Echogram, other: ss.Echogram) -> tuple[list[float], float, np.ndarray]:
    """Errors of T20, %, and of 10 ms and 50 ms, dB; what is stated, dB; z-scores against `other`."""
    assert pair.counts is not None
    target = np.array(pair.counts.groups.absorption)
    target[:, :BANDS] = target[:, BANDS:]
    found, old, new = ss.refurnished(pair, target, force=True), slice(BANDS), slice(BANDS, None)
    t20 = room_measures(found).t20[old] / room_measures(pair).t20[new] - 1.0
    here, there = found.histogram(0.01)[old], pair.histogram(0.01)[new]
    left = there[:, ::-1].cumsum(axis=1)[:, ::-1]
    heard = (left > 10.0 ** (-0.1 * LEVEL_DB) * left[:, :1]) & (there > 0.0)
    errors = [100.0 * float(np.nanmedian(np.abs(t20)))]
    for width in (1, 5):
        off = _levels(here, heard, width) - _levels(there, heard, width)
        errors.append(float(np.nanmedian(np.abs(off))))
    one, two = _split(found, old), _split(other, new)
    z = (one / two - 1.0) / np.hypot(found.relative_error[:, old], other.relative_error[:, new])
    return errors, closure_error_db(pair, target), z


def _row(name: str, scene: ss.Scene, what: str, rng: np.random.Generator | None) -> tuple[object, ...]:
    """One change of materials: of every counted one, or without `rng` of the first."""
    points = _points(scene)
    old, new = _changed(scene, material_groups(scene, _CONFIG).names, rng)
    twin = ss.simulate(_doubled(scene, old, new), points[:2], points[2:], _CONFIG)
    apart = ss.simulate(_doubled(scene, new, new), points[:2], points[2:], _CONFIG, seed=1)
    found = [_compare(twin[s, l], apart[s, l]) for s in range(2) for l in range(2)]
    errors, stated = np.nanmedian([f[0] for f in found], axis=0), [f[1] for f in found]
    z = float(np.sqrt(np.nanmean(np.square([f[2] for f in found]))))
    refused = int((np.array(stated) > MOST_DB).sum())
    return (name, what, *errors, float(np.median(stated)), refused, z)


def _rows(name: str, scene: ss.Scene) -> list[tuple[object, ...]]:
    rng = np.random.default_rng(1)
    first = material_groups(scene, _CONFIG).names[0]
    rows = [_row(name, scene, str(number + 1), rng) for number in range(CHANGES)]
    return [*rows, _row(name, scene, f"{first} .6", None)]


def run(*arguments: str) -> list[Table]:
    """One row per scene and change."""
    rows = [row for name in arguments or tuple(_SCENES) for row in _rows(name, _SCENES[name]())]
    columns = (
        "scene", "change", "T20: error, %", "10 ms: error, dB", "50 ms: error, dB", "stated, dB", "refused, of 4",
        "z-scores, rms",
    )  # fmt: skip
    return [
        table("Materials changed on reading, against the same walks with other materials", columns, rows)
    ]
