"""The figures of docs/scenes.md on generated buildings: `python docs/scenes_figures.py [buildings|times]`.

Eyring's reverberation time of the octaves of 500 Hz and 1 kHz, from the mean free path and mean absorption that
diffuse walks find (Kuttruff, Room Acoustics, ch. 5): an estimate for a diffuse field, not a simulation. Published
figures stand beside it; `nav.collection.published` says what each is.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.nav.collection.published import PUBLISHED
from soundspaces_sim.scene.enclosure import closedness
from soundspaces_sim.scene.rays.diffuse_walk import diffuse_walks
from soundspaces_sim.viz.axonometric import write_gallery

_OUT = Path(__file__).parent / "figures" / "generated_reverberation.png"
_BUILDINGS = _OUT.with_name("generated_buildings.png")
_SHOWN = (1, 4)  # numbers of each type
_SPEED, _AIR = 343.0, 0.0008  # m/s; 1/m at 20 °C and 50 %, between 500 Hz and 1 kHz (ISO 9613-1)
_COUNTS = {"home": 20, "room": 50, "office": 30, "classroom": 40, "hall": 20, "church": 20}


def reverberation_time(scene: ss.Scene) -> float:
    """s, of a generated building."""
    rng = np.random.default_rng(0)
    low, high = scene.bounds
    places = low + (high - low) * rng.random((200, 3))
    closed, nearest = closedness(scene, places, 64, 10)
    # Inside a solid the mean free path is short: the places that are freest are in the rooms.
    inside = np.flatnonzero(closed > 0.98)
    places = places[inside[np.argsort(-nearest[inside])[:8]]]
    count = len(scene.materials.names)
    keys = point_keys(places, 0)
    walks = diffuse_walks(scene.geometry, places - scene.center, keys, 400, 20, count)
    hits = walks.hits.sum(axis=0)
    path = float(walks.length.sum() / walks.count.sum())
    table = scene.materials
    octaves = [list(table.frequency_hz).index(f) for f in (500.0, 1000.0)]
    taken = (table.absorption + table.transmission)[:, octaves].mean(axis=1)
    mean = float(hits @ taken + walks.escaped.sum()) / float(hits.sum() + walks.escaped.sum())
    return 6.0 * np.log(10.0) * path / (_SPEED * (-np.log(1.0 - mean) + _AIR * path))


def main() -> None:
    """Write the figures, or the one that is named, and print quantiles."""
    wanted = sys.argv[1:] or ["buildings", "times"]
    if "buildings" in wanted:
        shown = [ss.load_scene(f"{kind}-{k}") for kind in _COUNTS for k in _SHOWN]
        write_gallery(shown, _BUILDINGS, columns=4)
    if "times" in wanted:
        write_times()


def write_times() -> None:
    """Histograms of reverberation times."""
    figure = Figure(figsize=(10.5, 5.4), layout="constrained")
    for axes, (kind, count) in zip(figure.subplots(2, 3).ravel(), _COUNTS.items(), strict=True):
        times = [reverberation_time(ss.load_scene(f"{kind}-{k}")) for k in range(count)]
        low, median, high = np.quantile(times, (0.1, 0.5, 0.9))
        print(f"| `{kind}-<n>` | {count} | {low:.2f} | {median:.2f} | {high:.2f} |", flush=True)
        axes.hist(times, bins=12, color="#7a93ac", label=f"{count} generated")
        top = axes.get_ylim()[1]
        for k, (start, end, text) in enumerate(PUBLISHED.get(kind, ())):
            y = top * (1.06 + 0.1 * k)
            axes.plot([start, end], [y, y], lw=3, color=f"C{1 + k}", label=text)
        axes.set_title(f"{kind}-<n>", fontsize=10)
        axes.set_xlabel("reverberation time, 500 Hz and 1 kHz, s")
        axes.legend(fontsize=7)
    figure.savefig(_OUT, dpi=80)


if __name__ == "__main__":
    main()
