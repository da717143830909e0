"""Other materials on reading, against the same walks with other materials.

Question: How far are echograms with other absorption, made of counts of reflections, from what the same walks carry
with that absorption?

Method: Per scene, pairs of four points. A model has the scene's four bands with the old absorption and again with
that of every change, so that one run of the same walks gives all. Without air and diffraction, which depend on
frequency. T20, 10 ms and 50 ms of energy down to -30 dB: of the old bands, changed on reading, against those of the
change; medians over pairs and bands. A change is every absorption times a factor between a half and two, drawn anew
for each material; and that of the most frequent material alone, to .6. Counts are those that a file holds, a byte
each. Beside the errors what 10 ms are off by in the root mean square (in the worst band of a pair, median over
pairs), what the closure states of that, how many of the pairs refuse the change, and z-scores of early and late
energy against another simulation of the changed scene.

What a few walks of one bin have met is not their mean, so that bins differ by noise that falls with the root of the
walks, and by the closure's error, that does not. So the same is given for runs of different numbers of walks.

Amortised: Compiling and loading kernels.

Takes: 40 minutes. Arguments: scenes (demo, house, studio). Needs ../shared for the last two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np

import soundspaces_sim as ss
from benchmarks.accuracy.ptb_studio import load_studio
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import house, in_own_bands
from benchmarks.tools.shards import encoded
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.echogram.measures import room_measures
from soundspaces_sim.echogram.refurnish import MOST_DB, closure_error_db
from soundspaces_sim.transport.reflection_counts.groups import material_groups

MEASURES = ("core", "scene", "transport", "echogram", "dataset")
CHANGES, LENGTH_S, LEVEL_DB, BANDS, WALKS = 6, 0.8, 30.0, 4, (8000, 32000)
_SETS = CHANGES + 2  # of four bands: the old one, every change, one material alone
_EDGES = tuple(50.0 * 1.3 ** np.arange(_SETS * BANDS + 1))  # Hz, of bands that carry them all
_CONFIG = ss.SimulationConfig(
    bands=_EDGES, duration=LENGTH_S, air_absorption=False, diffraction=ss.DiffractionConfig(enabled=False),
    scattering="table", materials=ss.MaterialsConfig(enabled=True),
)  # fmt: skip
_SCENES: dict[str, Callable[[], ss.Scene]] = {
    "demo": lambda: ss.load_scene("demo"), "house": house, "studio": lambda: load_studio("open")[0],
}  # fmt: skip


def _with_stored_counts(run: ss.Echograms) -> list[ss.Echogram]:
    """The pairs of a run with counts as a file has them."""
    shard = EchogramShard(encoded(run, np.arange(2), np.arange(2, 4)))
    pairs = [(s, l) for s in range(2) for l in range(2)]
    stored = [replace(run[p], counts=shard.echogram(*p, counts=True).counts) for p in pairs]
    shard.close()
    return stored


def _points(scene: ss.Scene) -> np.ndarray:
    grid = ss.make_grid(scene, 1.0).points
    return grid[np.random.default_rng(0).permutation(len(grid))[:4]]


def _with_sets(scene: ss.Scene, sets: list[np.ndarray]) -> ss.Scene:
    """The scene with absorption (m, 4) of every set in four bands of their own."""
    _, scattering, transmission = scene.materials.in_bands(DEFAULT_BANDS)
    values = np.concatenate(sets, axis=1), np.tile(scattering, _SETS), np.tile(transmission, _SETS)
    return in_own_bands(scene, np.array(_EDGES), *values)


def _sets(scene: ss.Scene, names: tuple[str, ...]) -> list[np.ndarray]:
    """(m, 4) absorption before, and after each change: every counted one times a factor between a half and two, at
    most what is not transmitted; last that of the most frequent material .6."""
    absorption, _, transmission = scene.materials.in_bands(DEFAULT_BANDS)
    rng = np.random.default_rng(1)
    counted = np.isin(scene.materials.names, names)[:, None]
    first = (np.array(scene.materials.names) == names[0])[:, None]
    most = np.maximum(0.98 - transmission, absorption)
    changed = [
        np.where(counted, absorption * 2.0 ** rng.uniform(-1.0, 1.0, (len(absorption), 1)), absorption)
        for _ in range(CHANGES)
    ]
    return [absorption, *(np.minimum(a, most) for a in [*changed, np.where(first, 0.6, absorption)])]


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


def _compare(
    pair: ss.Echogram, other: ss.Echogram, number: int
) -> tuple[list[float], float, np.ndarray]:
    """Errors of T20, %, of 10 ms and 50 ms, dB, and of 10 ms in the root mean square of the worst band; what is
    stated of that, dB; z-scores against `other`."""
    assert pair.counts is not None
    old, new = slice(BANDS), slice(number * BANDS, (number + 1) * BANDS)
    target = np.array(pair.counts.groups.absorption)
    target[:, old] = target[:, new]
    found = ss.refurnished(pair, target, force=True)
    t20 = room_measures(found).t20[old] / room_measures(pair).t20[new] - 1.0
    here, there = found.histogram(0.01)[old], pair.histogram(0.01)[new]
    left = there[:, ::-1].cumsum(axis=1)[:, ::-1]
    heard = (left > 10.0 ** (-0.1 * LEVEL_DB) * left[:, :1]) & (there > 0.0)
    errors = [100.0 * float(np.nanmedian(np.abs(t20)))]
    tens, fifties = (_levels(here, heard, width) - _levels(there, heard, width) for width in (1, 5))
    errors += [float(np.nanmedian(np.abs(off))) for off in (tens, fifties)]
    errors.append(float(np.sqrt(np.nanmean(np.square(tens), axis=1)).max()))
    one, two = _split(found, old), _split(other, new)
    z = (one / two - 1.0) / np.hypot(found.relative_error[:, old], other.relative_error[:, new])
    return errors, closure_error_db(pair, target), z


def _rows(name: str, scene: ss.Scene) -> list[tuple[object, ...]]:
    names = material_groups(scene, msgspec.structs.replace(_CONFIG, bands=DEFAULT_BANDS)).names
    many, points = _with_sets(scene, _sets(scene, names)), _points(scene)
    runs = [
        ss.simulate(
            many, points[:2], points[2:], msgspec.structs.replace(_CONFIG, walks=walks), seed=seed
        )
        for seed, walks in enumerate(WALKS)
    ]
    stored = [_with_stored_counts(run) for run in runs]
    rows: list[tuple[object, ...]] = []
    for number in range(1, _SETS):
        what = str(number) if number <= CHANGES else f"{names[0]} .6"
        for walks, run, other in zip(WALKS, stored, stored[::-1], strict=True):
            found = [_compare(pair, again, number) for pair, again in zip(run, other, strict=True)]
            errors, stated = np.nanmedian([f[0] for f in found], axis=0), [f[1] for f in found]
            z = float(np.sqrt(np.nanmean(np.square([f[2] for f in found]))))
            refused = int((np.array(stated) > MOST_DB).sum())
            rows.append((name, what, walks, *errors, float(np.median(stated)), refused, z))
            print(rows[-1], flush=True)
    return rows


def run(*arguments: str) -> list[Table]:
    """One row per scene, change and number of walks."""
    rows = [row for name in arguments or tuple(_SCENES) for row in _rows(name, _SCENES[name]())]
    columns = (
        "scene", "change", "walks", "T20: error, %", "10 ms: error, dB", "50 ms: error, dB",
        "10 ms: rms, dB", "stated, dB", "refused, of 4", "z-scores, rms",
    )  # fmt: skip
    return [
        table("Materials changed on reading, against the same walks with other materials", columns, rows)
    ]
