"""What is heard between the points of a dataset, against simulation at the very places.

Question: How far is sound between points, as `nav.SoundField` has it, from what a simulation there gives?

Method: Places at random on the floor of a generated flat whose dataset has points 1 m apart; sources at points of
the dataset. At each place the flat is simulated anew, with another seed and as many subpaths as the dataset's
points. Four estimates of it: between points (reverberation by Shepard's weights) with discrete paths simulated at
the place or moved from the points around, the nearest point (the naive alternative), and for scale a second
simulation at the place with a third seed, which differs by noise alone. Per band the root mean square of the
differences over all pairs: level (of all energy), direct-to-reverberant ratio (where the source is seen; direct
sound against all else), EDT and T30 relative, and the interaural level difference of the responses for a head
facing +X. T30 from -5 to -35 dB of the backward integral, EDT from 0 to -10 dB. Discrete arrivals have no noise: in
the last two tables differences are the estimate's own.

Amortised: Nothing.

Takes: 6 minutes. Arguments: a folder of datasets that has home-0 (`make rirs SCENE=home-0 SPACING=1`), places,
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
_SCENE, _BIN, _RATE = "home-0", 0.002, 16000
_LEAST = 1e-3  # of the energy: less counts as this
_ESTIMATES = {
    "simulated": "between points",
    "moved": "between points, moved paths",
    "nearest": "nearest point",
    "again": "noise alone",
}
Heard = dict[str, dict[tuple[int, ...], Echogram]]  # by estimate, source and place
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
    fields = {"simulated": SoundField(ds, scene), "moved": SoundField(ds, scene, paths="moved")}
    rng = np.random.default_rng(0)
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
    heard = _heard(ds, fields, sources, spots)
    found: dict[str, list[np.ndarray]] = {name: [] for name in ("truth", *_ESTIMATES)}
    for pair in np.ndindex(len(sources), len(spots)):
        found["truth"].append(_measures(truth[0][pair]))
        found["again"].append(_measures(truth[1][pair]))
        for name, there in heard.items():
            found[name].append(_measures(there[pair]))
    stacked = {name: np.array(rows) for name, rows in found.items()}
    rows: list[tuple[object, ...]] = []
    for k, measure in enumerate(_NAMES):
        for name, what in _ESTIMATES.items():
            values = _differences(stacked[name], stacked["truth"])[k]
            rows.append((measure, what, *np.round(values, 2).tolist()))
    edges = ds.manifest.config.simulation.bands
    heads = ["measure", "estimate", *(f"{a:g} to {b:g} Hz" for a, b in pairwise(edges))]
    note = f"{len(sources)} sources × {len(spots)} places, points 1 m apart, {walks} subpaths a point."
    return [
        table("Root mean square difference to simulation at the place", heads, rows, note),
        _discrete(heard, truth[0]),
        _direct_sound(heard, truth[0]),
    ]


def _heard(
    ds: RirDataset, fields: dict[str, SoundField], sources: np.ndarray, spots: np.ndarray
) -> Heard:
    """Echograms by estimate, without walks of their own."""
    out: Heard = {name: {} for name in (*fields, "nearest")}
    for i, s in enumerate(sources.tolist()):
        for j, spot in enumerate(spots):
            for name, field in fields.items():
                out[name][i, j] = field.echogram(field.at_point(s), field.place(spot))
            nearest = int(np.linalg.norm(ds.points - spot, axis=1).argmin())
            out["nearest"][i, j] = ds.echogram(s, nearest)
    return out


def _discrete(heard: Heard, truth: Echograms) -> Table:
    """How strong all discrete arrivals of a pair are together, and how much of their energy is in arrivals by the
    same planes and edges."""
    errors: dict[str, list[np.ndarray]] = {name: [] for name in heard}
    common: dict[str, list[np.ndarray]] = {name: [] for name in heard}
    for pair in np.ndindex(*truth.shape):
        own = _by_name(truth[pair])
        if not own:
            continue
        want = np.sum(list(own.values()), axis=0)
        want[want == 0.0] = np.nan  # walls leave nothing of high bands
        for name, there in heard.items():
            other = _by_name(there[pair])
            got = np.sum([*other.values(), np.zeros(len(want))], axis=0)
            errors[name].append(10.0 * np.log10(np.maximum(got, _LEAST * want) / want))
            both = [np.minimum(own[key], other[key]) for key in set(own) & set(other)]
            common[name].append(np.sum(both, axis=0) / want if both else 0.0 * want)
    bands = [f"{a:g} to {b:g} Hz" for a, b in pairwise(truth.bands)]
    rows: list[tuple[object, ...]] = []
    for name in heard:
        what = _ESTIMATES[name]
        level = np.sqrt(np.nanmean(np.square(errors[name]), axis=0))
        rows.append((what, "level, dB", *np.round(level, 2).tolist()))
        rows.append(
            (what, "in common, %", *np.round(100.0 * np.nanmean(common[name], axis=0), 1).tolist())
        )
    note = f"{len(errors['nearest'])} pairs that have any; levels are at most {-10 * np.log10(_LEAST):g} dB off."
    return table(
        "Discrete arrivals of a pair together: root mean square error of their level, mean share of their energy "
        "in common",
        ["estimate", "measure", *bands],
        rows,
        note,
    )


def _by_name(echogram: Echogram) -> dict[tuple[object, ...], np.ndarray]:
    """Energies of discrete arrivals by what they met, planes in either order."""
    out: dict[tuple[object, ...], np.ndarray] = {}
    for arrival in echogram.arrivals:
        key = arrival.kind, tuple(sorted(arrival.planes)), arrival.edges
        out[key] = out.get(key, 0.0) + arrival.energy
    return out


def _direct_sound(heard: Heard, truth: Echograms) -> Table:
    """What has no noise: where and when the direct sound arrives, and how strong."""
    rows: dict[str, list[tuple[float, ...]]] = {_ESTIMATES[name]: [] for name in heard}
    for pair in np.ndindex(*truth.shape):
        own = truth[pair].direct
        if not truth[pair].visible or own is None:
            continue
        for name, there in heard.items():
            found = there[pair].direct
            if found is None:
                continue
            cosine = float(np.clip(own.direction @ found.direction, -1.0, 1.0))
            level = 10.0 * np.log10(np.maximum(found.energy / own.energy, _LEAST))
            late = 1000.0 * (found.delay - own.delay)
            rows[_ESTIMATES[name]].append((np.rad2deg(np.arccos(cosine)), late, *level))
    bands = [(f"level at {a:g} to {b:g} Hz", "dB") for a, b in pairwise(truth.bands)]
    return table(
        "Direct sound where the source is seen: root mean square errors, without noise",
        [
            "estimate",
            "pairs",
            ("direction", "degrees"),
            ("delay", "ms"),
            *bands,
        ],
        [
            (name, len(errors), *np.round(np.sqrt(np.mean(np.square(errors), axis=0)), 3).tolist())
            for name, errors in rows.items()
        ],
    )
