"""The figures of the page on generated buildings: `python neighbours/buildings/figures.py [buildings|times]`.

Times are simulated: T30, mean of the bands about 500 Hz and 1 kHz, of pairs in one room with all doors as they are,
one source and two listeners a room, of `_WALKS` subpaths a point; the median of a room's pairs. Published figures
stand beside them; `soundspaces_collections.rooms.PUBLISHED` says what each is.
"""

from __future__ import annotations

import sys
import warnings
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from soundspaces_buildings.registry import building_rooms
from soundspaces_buildings.shell import Room
from soundspaces_buildings.walkway import inside
from soundspaces_collections.axonometric import write_gallery
from soundspaces_collections.rooms import histogram, middle

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.measures import echograms_measures
from soundspaces_sim.scene.enclosure import closedness

_OUT = Path(__file__).parent / "figures" / "generated_reverberation.png"
_BUILDINGS = _OUT.with_name("generated_buildings.png")
_SHOWN = (1, 4)  # numbers of each type
_COUNTS = {"home": 20, "room": 30, "office": 12, "classroom": 16, "hall": 8}  # a church takes minutes
_WALKS = {
    "home": 120,
    "room": 120,
    "office": 400,
    "classroom": 120,
    "hall": 800,
}  # else many times are not known
_HEIGHTS = (1.0, 1.7)  # m above the floor
_CLEAR, _APART = 0.25, 0.7  # m from surfaces, and from each other
_TRIES = 400


def places(scene: ss.Scene, room: Room, rng: np.random.Generator) -> np.ndarray:
    """(3, 3) places in the air of a room, m; fewer where nothing that was drawn is free."""
    low, high = room.inner.min(axis=0), room.inner.max(axis=0)
    found: list[np.ndarray] = []
    some = np.column_stack(
        [rng.uniform(low, high, (_TRIES, 2)), room.floor + rng.uniform(*_HEIGHTS, _TRIES)]
    )
    some = some[inside(some[:, :2], room.inner)]
    closed, nearest = closedness(scene, some, 64, 8)
    for place in some[(closed > 0.99) & (nearest > _CLEAR)]:
        if len(found) < 3 and all(np.linalg.norm(place - other) > _APART for other in found):
            found.append(place)
    return np.array(found).reshape(-1, 3)


def reverberation_times(name: str) -> Iterator[tuple[str, np.ndarray]]:
    """Use of each room of a generated building and its T30 (bands,), s; rooms without space are left out."""
    kind, number = name.rsplit("-", 1)
    scene, rng = ss.load_scene(name), np.random.default_rng(0)
    rooms = [(room, places(scene, room, rng)) for room in building_rooms(kind, int(number))]
    rooms = [(room, found) for room, found in rooms if len(found) == 3]
    config = ss.SimulationConfig(
        walks=_WALKS[kind], radiance_transfer=ss.RadianceTransferConfig(subpaths="auto")
    )
    sources = np.array([found[0] for _, found in rooms])
    listeners = np.concatenate([found[1:] for _, found in rooms])
    times = echograms_measures(ss.simulate(scene, sources, listeners, config))["t30"]
    for k, (room, _) in enumerate(rooms):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # where no pair has a time
            yield room.kind, np.nanmedian(times[k, 2 * k : 2 * k + 2], axis=0)


def main() -> None:
    """Write the figures, or the one that is named, and print quantiles."""
    wanted = sys.argv[1:] or ["buildings", "times"]
    if "buildings" in wanted:
        shown = [ss.load_scene(f"{kind}-{k}") for kind in (*_COUNTS, "church") for k in _SHOWN]
        write_gallery(shown, _BUILDINGS, columns=4)
    if "times" in wanted:
        write_times()


def write_times() -> None:
    """Histograms of reverberation times, and a table of their quantiles."""
    found = {kind: times_of(kind, count) for kind, count in _COUNTS.items()}
    draw(found)
    for kind, uses in found.items():
        for use, times in sorted(uses.items(), key=lambda row: -len(row[1])):
            cells = [f"{np.nanmedian(band):.2f}" for band in times.T]
            low, half, high = np.nanquantile(_middle(times), (0.1, 0.5, 0.9))
            cells += [f"{low:.2f}", f"**{half:.2f}**", f"{high:.2f}"]
            known = np.isfinite(_middle(times)).sum()
            count = f"{known}" if known == len(times) else f"{known} of {len(times)}"
            print(f"| `{kind}-<n>` | {use} | {count} | " + " | ".join(cells) + " |", flush=True)


def times_of(kind: str, count: int) -> dict[str, np.ndarray]:
    """T30 (rooms, bands) by use of the room, of the first `count` buildings of a type."""
    found: dict[str, list[np.ndarray]] = defaultdict(list)
    for k in range(count):
        for use, times in reverberation_times(f"{kind}-{k}"):
            found[use].append(times)
    return {use: np.array(times) for use, times in found.items()}


def _middle(times: np.ndarray) -> np.ndarray:
    return np.asarray(times[:, middle(DEFAULT_BANDS)].mean(axis=1))


def draw(found: dict[str, dict[str, np.ndarray]]) -> None:
    """Write the histograms."""
    figure = Figure(figsize=(10.5, 5.6), layout="constrained")
    grid = figure.subplots(2, (len(found) + 1) // 2).ravel()
    for axes, (kind, uses) in zip(grid, found.items(), strict=False):
        times = {use: _middle(of_use) for use, of_use in uses.items()}
        histogram(axes, kind, {use: known[np.isfinite(known)] for use, known in times.items()})
        axes.set_title(f"{kind}-<n>", fontsize=10)
    for axes in grid[len(found) :]:
        axes.axis("off")
    figure.savefig(_OUT, dpi=80)


if __name__ == "__main__":
    main()
