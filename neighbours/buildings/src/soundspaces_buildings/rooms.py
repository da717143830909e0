"""A building of rooms: shells, doors, windows, furniture, lights; shared by all types."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from soundspaces_buildings.furnish import Floor, furnish, overlap, rectangle
from soundspaces_buildings.shell import HALF, Opening, Room, shell
from soundspaces_buildings.solids import Solid, prism
from soundspaces_buildings.walkway import inside

DOOR_HEAD = 2.05  # m, height
_LEAF = 0.04  # m
_CLEAR = 0.9  # m that stay free in front of a door
_SILL = 0.005  # m, of the threshold


def windows_and_curtains(
    room: Room, a: np.ndarray, b: np.ndarray, sill: float, head: float, curtains: float
) -> tuple[list[Solid], np.ndarray]:
    """A pane before the wall between inner points a and b, anticlockwise, with curtains `curtains` m wide beside
    it; and the area in front of it."""
    along = (b - a) / np.linalg.norm(b - a)
    left = np.array([-along[1], along[0]])
    width = float(np.linalg.norm(b - a))
    floor = room.floor
    pane = rectangle(a + 0.001 * left, along, (width, 0.02))
    out = [prism(room.finishes.get("window", "window"), pane, floor + sill, floor + head)]
    if curtains > 0.0:
        label = room.finishes.get("curtain", "curtain")
        for start in (a - (curtains - 0.1) * along, b - 0.1 * along):
            cloth = rectangle(start + 0.03 * left, along, (curtains, 0.06))
            out.append(prism(label, cloth, floor + max(sill - 0.75, 0.08), floor + head + 0.12))
    return out, rectangle(a, along, (width, 0.5))


def glaze(
    room: Room,
    edge: int,
    rng: np.random.Generator,
    blocked: Sequence[np.ndarray],
    share: float,
    curtains: bool,
) -> tuple[list[Solid], list[np.ndarray]]:
    """Windows over `share` of the length of an inner edge, off doors and corners."""
    inner = room.inner
    a, b = inner[edge], inner[(edge + 1) % len(inner)]
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    tall = room.ceiling - room.floor
    sill = float(rng.choice([0.75, 0.9, 1.1])) if room.kind != "bathroom" else 1.3
    head = min(float(rng.uniform(2.0, 2.4)), tall - 0.2) if tall < 3.4 else 0.72 * tall
    ends = np.array([a, b])
    head = min(head, float(room.height_at(ends).min()) - room.floor - 0.2)
    cloth = float(rng.uniform(0.25, 0.5)) if curtains else 0.0
    if head - sill < 0.4:
        return [], []
    count = max(1, round(share * length / 1.6))
    cell = length / count
    width = min(share * cell, cell - 0.3 - 2.0 * cloth, 3.2)
    if width < 0.4:
        return [], []
    solids: list[Solid] = []
    areas = []
    for k in range(count):
        start = a + along * (cell * (k + 0.5) - 0.5 * width)
        found, front = windows_and_curtains(room, start, start + along * width, sill, head, cloth)
        reach = rectangle(start - (cloth + 0.02) * along, along, (width + 2 * cloth + 0.04, 0.15))
        if not any(overlap(reach, other) for other in blocked):
            solids += found
            areas += [front, reach]
    return solids, areas


def lamp(room: Room, at: np.ndarray) -> list[Solid]:
    """A lamp that hangs from the ceiling, where there is height for it."""
    top = float(room.height_at(at[None])[0])
    if top - room.floor < 2.45:
        return []
    drop = min(0.35, 0.5 * (top - room.floor - 2.2))
    shade = rectangle(at - 0.15, np.array([1.0, 0.0]), (0.3, 0.3))
    rod = rectangle(at - 0.01, np.array([1.0, 0.0]), (0.02, 0.02))
    return [
        prism("lamp", shade, top - drop - 0.12, top - drop),
        prism("lamp", rod, top - drop, top - 0.001),
    ]


@dataclass(frozen=True)
class Interior:
    """How a room is to be filled: `density` 0 to 1, `windows` edge and share of its length each, `curtains`;
    `rows` puts what stands in rows before the rest; `holes`: areas where there is no floor to stand on."""

    density: float
    windows: tuple[tuple[int, float], ...] = ()
    curtains: bool = False
    rows: Callable[[Floor], None] | None = None
    holes: tuple[np.ndarray, ...] = ()


@dataclass(frozen=True)
class Way:
    """What a door is in a room: its solids there, the area in front that stays free, and a place that must be
    reached."""

    solids: list[Solid]
    clear: np.ndarray
    place: np.ndarray


@dataclass(frozen=True)
class Door:
    """A doorway between `a` and `b` (2,) in the middle of a wall. `leaf`: how wide it is open, degrees;
    0 is closed, None has no leaf. `into`: the side to which the leaf swings, seen from a to b: 1 left, -1 right."""

    a: np.ndarray
    b: np.ndarray
    floor: float = 0.0
    head: float = DOOR_HEAD
    leaf: float | None = None
    into: int = 1

    @property
    def along(self) -> np.ndarray:
        return np.asarray((self.b - self.a) / np.linalg.norm(self.b - self.a))

    @property
    def left(self) -> np.ndarray:
        return np.array([-self.along[1], self.along[0]])

    @property
    def width(self) -> float:
        return float(np.linalg.norm(self.b - self.a))

    def opening(self) -> Opening:
        return Opening(self.a, self.b, self.floor, self.floor + self.head)

    def way(self, side: int) -> Way:
        """What it is in the room on one side, as seen from a to b: 1 left, -1 right."""
        at, along = (self.a, self.along) if side > 0 else (self.b, -self.along)
        clear = rectangle(at + HALF * side * self.left, along, (self.width, _CLEAR))
        place = 0.5 * (self.a + self.b) + side * (HALF + 0.4) * self.left
        return Way(self.solids("door") if side == self.into else [], clear, place)

    def solids(self, label: str) -> list[Solid]:
        """Threshold and leaf, in its frame or turned on its hinge at `a`."""
        low = self.floor
        threshold = rectangle(self.a - HALF * self.left, self.along, (self.width, 2 * HALF))
        out = [prism(label, threshold, low, low + _SILL)]
        if self.leaf is None:
            return out
        angle = np.deg2rad(self.leaf) * self.into
        c, s = np.cos(angle), np.sin(angle)
        turned = c * self.along + s * self.left
        side = np.array([-turned[1], turned[0]])
        hinge = self.a + self.into * (HALF - _LEAF - 0.005) * self.left + 0.01 * self.along
        if self.leaf > 0.0:
            hinge = self.a + self.into * (HALF + 0.01) * self.left + 0.02 * self.along
        at = hinge if self.into > 0 else hinge - _LEAF * side
        leaf = rectangle(at, turned, (self.width - 0.03, _LEAF))
        return [*out, prism(label, leaf, low + 0.01, low + self.head - 0.01)]


def fill(
    room: Room,
    ways: Sequence[Way],
    openings: Sequence[Opening],
    interior: Interior,
    rng: np.random.Generator,
    before: Sequence[Solid] = (),
) -> list[Solid] | None:
    """All solids of a room; None if what it needs does not fit. `before`: what stands there already."""
    leaves = [solid for way in ways for solid in way.solids]
    keep = [*(way.clear for way in ways), *(leaf.outline for leaf in leaves)]
    glass: list[Solid] = []
    fronts: list[np.ndarray] = []
    for edge, share in interior.windows:
        solids, areas = glaze(room, edge, rng, keep, share, interior.curtains)
        glass += solids
        fronts += areas
    floor = Floor(room, [way.place for way in ways], keep, fronts)
    floor.hang(glass)
    floor.block([*before, *leaves])
    floor.keep_off(interior.holes)
    floor.holes += interior.holes
    if interior.rows is not None:
        interior.rows(floor)
    if not floor.walkway.is_open_with() or not furnish(floor, rng, interior.density):
        return None
    centre = room.inner.mean(axis=0)
    hung = lamp(room, centre) if inside(centre[None], room.inner)[0] else []
    return [*shell(room, openings), *glass, *floor.solids, *hung]
