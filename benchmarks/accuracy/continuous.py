"""What is heard between the points of a dataset, against simulation at the very places.

Question: How far is sound between points, as `nav.SoundField` has it, from what a simulation there gives?

Method: Places at random on the floor of a generated flat whose dataset has points 1 m apart; sources at points of
the dataset. At each place the flat is simulated anew, with another seed and as many subpaths as the dataset's
points. Three estimates of it: between points (moved paths, reverberation by Shepard's weights), the nearest point
(the naive alternative), and for scale a second simulation at the place with a third seed, which differs by noise
alone. Per band the root mean square of the differences over all pairs: level (of all energy), direct-to-reverberant
ratio (where the source is seen; direct sound against all else), EDT and T30 relative, and the interaural level
difference of the responses for a head facing +X. T30 from -5 to -35 dB of the backward integral, EDT from 0 to -10
dB.

Amortised: Nothing.

Takes: 3 minutes. Arguments: a folder of datasets that has flat-0 (`make rirs SCENE=flat-0 SPACING=1`), places,
walks.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, UnavailableError, table
from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.echogram.echogram import Echogram, Echograms
from soundspaces_sim.nav.continuous.floor import Floor
from soundspaces_sim.nav.continuous.sound_field import SoundField
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.rendering.ambisonics import ambisonic_rir
from soundspaces_sim.rendering.binaural import binaural_rir

MEASURES = ("core", "scene", "transport", "echogram", "rendering", "nav")
_SCENE, _BIN, _RATE = "flat-0", 0.002, 16000
_NAMES = ("level, dB", "DRR, dB", "EDT, %", "T30, %", "ILD, dB")


def _decay(histogram: np.ndarray, high: float, low: float) -> np.ndarray:
    """(bands,) s for 60 dB, by a line through the backward integral between two levels; NaN where it has no
    room."""
    out = np.full(len(histogram), np.nan)
    for b, energy in enumerate(histogram):
        left = np.cumsum(energy[::-1])[::-1]
        level = 10.0 * np.log10(np.maximum(left / left[0], 1e-30))
        use = (level <= high) & (level >= low)
        if use.sum() >= 3:
            slope = np.polyfit(np.flatnonzero(use) * _BIN, level[use], 1)[0]
            out[b] = -60.0 / slope
    return out


def _measures(echogram: Echogram) -> np.ndarray:
    """(5, bands) of one echogram; ratios of energy in dB, times in s."""
    histogram = echogram.histogram(_BIN)
    total = histogram.sum(axis=1)
    drr = np.full(len(total), np.nan)
    if echogram.visible and echogram.direct is not None:
        direct = echogram.direct.energy
        drr = 10.0 * np.log10(direct / np.maximum(total - direct, 1e-30))
    ears = binaural_rir(ambisonic_rir(echogram, _RATE, 0), _RATE)
    power = np.abs(np.fft.rfft(ears, axis=1)) ** 2
    frequency = np.fft.rfftfreq(ears.shape[1], 1.0 / _RATE)
    ild = []
    for low, high in pairwise(echogram.bands):
        inside = (frequency >= max(low, 50.0)) & (frequency < high)
        left, right = power[:, inside].sum(axis=1)
        ild.append(10.0 * np.log10(left / right))
    decays = _decay(histogram, 0.0, -10.0), _decay(histogram, -5.0, -35.0)
    return np.stack([10.0 * np.log10(total), drr, *decays, np.array(ild)])


def _differences(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    out = found - truth
    out[:, 2:4] = 100.0 * out[:, 2:4] / truth[:, 2:4]
    return np.asarray(np.sqrt(np.nanmean(out**2, axis=0)))


def run(folder: str = "out", places: str = "24", walks: str = "200") -> list[Table]:
    """Root mean square differences."""
    if not (Path(folder) / _SCENE).is_dir():
        raise UnavailableError(f"{folder} has no dataset of {_SCENE}")
    ds, scene = NavData(folder).dataset(_SCENE), ss.load_scene(_SCENE)
    field, rng = SoundField(ds, scene), np.random.default_rng(0)
    height = float(ds.manifest.config.grid.height)
    floor = Floor(scene, float(ds.points[0, 2]) - height, ds.manifest.config.graph)
    free = floor.lattice().origin + 0.05 * np.argwhere(floor.lattice().free)
    nodes = np.array(ds.manifest.nodes)
    inside = [
        p for p in free if np.isfinite(floor.distances(*ds.points[nodes[0], :2].tolist()).ahead(*p)[0])
    ]
    chosen = np.array(inside)[rng.choice(len(inside), int(places), replace=False)]
    spots = np.column_stack([chosen, np.full(len(chosen), ds.points[0, 2])])
    sources = rng.choice(nodes, 3, replace=False)
    config = ss.SimulationConfig(walks=int(walks), duration=ds.manifest.duration)
    truth = [ss.simulate(scene, ds.points[sources], spots, config, seed) for seed in (1, 2)]
    found: dict[str, list[np.ndarray]] = {"truth": [], "again": [], "between": [], "nearest": []}
    for i, s in enumerate(sources):
        for j, spot in enumerate(spots):
            nearest = int(np.linalg.norm(ds.points - spot, axis=1).argmin())
            found["truth"].append(_measures(truth[0][i, j]))
            found["again"].append(_measures(truth[1][i, j]))
            found["between"].append(_measures(field.echogram(field.at_point(int(s)), field.place(spot))))
            found["nearest"].append(_measures(ds.echogram(int(s), nearest)))
    stacked = {name: np.array(rows) for name, rows in found.items()}
    rows: list[tuple[object, ...]] = []
    for k, measure in enumerate(_NAMES):
        for name, what in (
            ("between", "between points"),
            ("nearest", "nearest point"),
            ("again", "noise alone"),
        ):
            values = _differences(stacked[name], stacked["truth"])[k]
            rows.append((measure, what, *np.round(values, 2).tolist()))
    edges = ds.manifest.config.simulation.bands
    heads = ["measure", "estimate", *(f"{a:g} to {b:g} Hz" for a, b in pairwise(edges))]
    note = f"{len(sources)} sources × {len(spots)} places, points 1 m apart, {walks} subpaths a point."
    return [
        table("Root mean square difference to simulation at the place", heads, rows, note),
        _direct_sound(ds, field, sources, spots, truth[0]),
    ]


def _direct_sound(
    ds: RirDataset, field: SoundField, sources: np.ndarray, spots: np.ndarray, truth: Echograms
) -> Table:
    """What has no noise: where and when the direct sound arrives, and how strong."""
    rows: dict[str, list[tuple[float, float, float]]] = {"between points": [], "nearest point": []}
    for i, s in enumerate(sources):
        for j, spot in enumerate(spots):
            own = truth[i, j]
            nearest = int(np.linalg.norm(ds.points - spot, axis=1).argmin())
            between = field.echogram(field.at_point(int(s)), field.place(spot))
            for name, found in (
                ("between points", between),
                ("nearest point", ds.echogram(int(s), nearest)),
            ):
                if not own.visible or own.direct is None or found.direct is None:
                    continue
                cosine = float(np.clip(own.direct.direction @ found.direct.direction, -1.0, 1.0))
                ratio = 10.0 * np.log10(found.direct.energy[2] / own.direct.energy[2])
                late = 1000.0 * (found.direct.delay - own.direct.delay)
                rows[name].append((np.rad2deg(np.arccos(cosine)), late, ratio))
    return table(
        "Direct sound where the source is seen: root mean square errors, without noise",
        [
            "estimate",
            "pairs",
            ("direction", "degrees"),
            ("delay", "ms"),
            ("level at 775 to 3409 Hz", "dB"),
        ],
        [
            (name, len(errors), *np.round(np.sqrt(np.mean(np.square(errors), axis=0)), 3).tolist())
            for name, errors in rows.items()
        ],
    )
