"""Reverberation times of the single rooms of buildings, by use: what surveys measure.

A building's pairs say little of them: most lie in its largest and emptiest rooms, or in two rooms.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import msgspec
import numpy as np
from matplotlib.axes import Axes
from soundspaces_buildings.registry import BUILDINGS, building_of, building_rooms
from soundspaces_buildings.walkway import inside as inside

from soundspaces_sim import RirDataset

_HOMES = (
    (0.40, 0.69, "50 living rooms, means\n8 kHz to 125 Hz [1]"),
    (0.35, 0.45, "16 living rooms [2]"),
)
PUBLISHED: Mapping[str, Sequence[tuple[float, float, str]]] = {
    "home": _HOMES,
    "room": _HOMES,
    "classroom": ((0.4, 0.6, "recommended [3]"),),
    "hall": ((1.25, 1.75, "recommended, gyms [4]"),),
    "church": ((1.5, 2.5, "recommended [5]"),),
}


#: Rooms of dwellings that surveys tell of.
LIVED_IN = ("living", "bedroom")
_STANDING = 2.3  # m above a floor: points there are of its storey
_BLUE, _PALE = "#46647f", "#b9c7d5"


class RoomTimes(msgspec.Struct, frozen=True, kw_only=True):
    """Of one room: its use; medians of T30 (bands,), s, over its `pairs` in sight of each other."""

    use: str
    area: float  # m², of the floor
    pairs: int
    t30: list[float | None]


def rooms_of(ds: RirDataset) -> list[RoomTimes]:
    """The rooms of a generated building in which two points see each other; none of other scenes."""
    found = building_of(ds.manifest.scene)
    if found is None or found[0] not in BUILDINGS:
        return []
    table, points = ds.table(), np.array(ds.manifest.points)
    source, listener = table["source"], table["listener"]
    out = []
    for room in building_rooms(*found):
        within = inside(points[:, :2], room.inner)
        within &= (points[:, 2] > room.floor) & (points[:, 2] < room.floor + _STANDING)
        pairs = within[source] & within[listener] & (source != listener) & table["visible"]
        if pairs.any():
            bands = range(len(ds.manifest.config.simulation.bands) - 1)
            times = [median_of(table[f"t30_{b}"][pairs]) for b in bands]
            out.append(
                RoomTimes(use=room.kind, area=round(room.area, 2), pairs=int(pairs.sum()), t30=times)
            )
    return out


def median_of(values: np.ndarray) -> float | None:
    """Of finite values, rounded; None of none."""
    known = values[np.isfinite(values)]
    return float(np.round(np.median(known), 6)) if len(known) else None


def middle(bands: Sequence[float]) -> list[int]:
    """Bands that have a part of 354 Hz to 1414 Hz, the octaves of 500 Hz and 1 kHz."""
    return [b for b, (low, high) in enumerate(pairwise(bands)) if low < 1414.0 and high > 354.0]


def times_by_use(rooms: Iterable[RoomTimes], bands: Sequence[float]) -> dict[str, np.ndarray]:
    """(rooms,) s by use, mean of the middle bands, of rooms of which these are known; most rooms first."""
    found: dict[str, list[float]] = defaultdict(list)
    for room in rooms:
        values = [room.t30[b] for b in middle(bands)]
        known = [v for v in values if v is not None]
        if len(known) == len(values):
            found[room.use].append(float(np.mean(known)))
    return {use: np.array(found[use]) for use in sorted(found, key=lambda use: -len(found[use]))}


def surveyed(kind: str, times: Mapping[str, np.ndarray]) -> np.ndarray:
    """Times of those rooms that published figures are of."""
    uses = [use for use in times if kind not in ("home", "room") or use in LIVED_IN]
    return np.concatenate([times[use] for use in uses] or [np.empty(0)])


def histogram(axes: Axes, kind: str, times: Mapping[str, np.ndarray]) -> None:
    """Rooms that surveys tell of, the others on top of them, and what was published."""
    some = surveyed(kind, times)
    every = np.concatenate([*times.values(), np.empty(0)])
    rest = len(every) - len(some)
    label = "living rooms and bedrooms" if rest else "rooms"
    edges = np.linspace(0.0, 1.02 * every.max(initial=0.5), 24).tolist()
    axes.hist(
        every, bins=edges, color=_PALE if rest else _BLUE, label=f"{rest} other rooms" if rest else None
    )
    axes.hist(some, bins=edges, color=_BLUE, label=f"{len(some)} {label}")
    top = axes.get_ylim()[1]
    for k, (start, end, text) in enumerate(PUBLISHED.get(kind, ())):
        y = top * (1.06 + 0.1 * k)
        axes.plot([start, end], [y, y], lw=3, color=f"C{1 + k}", label=text)
    axes.set(xlabel="T30 in a room, 500 Hz and 1 kHz, s", ylabel="rooms", ylim=(0.0, 2.2 * top))
    axes.legend(fontsize=7, loc="upper right")


def compared(kind: str, times: Mapping[str, np.ndarray]) -> str:
    """How times lie to what was published, in words; nothing where no room's is known."""
    some, ranges = surveyed(kind, times), PUBLISHED.get(kind, ())
    if not len(some):
        return ""
    low, half, high = np.quantile(some, (0.1, 0.5, 0.9))
    what = "living rooms and bedrooms" if kind in ("home", "room") else "rooms"
    text = (
        f"Of the {len(some)} {what} 10 % are below {low:.2f} s, half below {half:.2f} s, "
        f"90 % below {high:.2f} s. "
    )
    if not ranges:
        return text + "For such rooms no published figure was at hand."
    least, most = min(r[0] for r in ranges), max(r[1] for r in ranges)
    within = 100.0 * np.mean((some >= least) & (some <= most))
    return text + (
        f"Published ([sources](../buildings/README.md)): {least:g} to {most:g} s; "
        f"{within:.0f} % of them are within that, {100.0 * np.mean(some > most):.0f} % above."
    )
