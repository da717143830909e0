"""The plan of a generated flat: rooms on a lattice of 1 m cells by binary space partition, doors between them.

Half of the flats have a corridor, as most real ones, the others open from a living room. Doors make a tree,
rooms hanging on corridor and living room first, then a few more make loops.

Conventions: cell (i, j) covers i to i + 1 m along x and j to j + 1 m along y; a wall lies on a lattice line.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

Cell = tuple[int, int]
_LEAST, _MOST = 54, 84  # cells; with furniture, 44 to 54 stay free (measured)
_ROOMS = (4, 9)
_SHARED = ("hall", "living", "dining")  # rooms that one walks through


@dataclass(frozen=True)
class Room:
    """A rectangle of cells, from (x0, y0) to (x1, y1), and what it is for."""

    x0: int
    y0: int
    x1: int
    y1: int
    kind: str = ""

    @property
    def area(self) -> int:
        return (self.x1 - self.x0) * (self.y1 - self.y0)

    @property
    def narrow(self) -> int:
        """The shorter side."""
        return min(self.x1 - self.x0, self.y1 - self.y0)

    def cells(self) -> Iterator[Cell]:
        return ((i, j) for i in range(self.x0, self.x1) for j in range(self.y0, self.y1))


@dataclass(frozen=True)
class FlatPlan:
    """`rooms`; `room_of` (width, depth) their rows; `doors`: pairs of neighbouring cells of two rooms;
    `entrance`: a cell at an outer wall, and the side (0 west, 1 east, 2 south, 3 north) of the front door."""

    width: int
    depth: int
    rooms: tuple[Room, ...]
    room_of: np.ndarray
    doors: tuple[tuple[Cell, Cell], ...]
    entrance: tuple[Cell, int]


#: Step to the neighbouring cell on each side: west, east, south, north.
SIDES: tuple[Cell, ...] = ((-1, 0), (1, 0), (0, -1), (0, 1))


def make_plan(rng: np.random.Generator) -> FlatPlan:
    """A flat of 8 to 11 by 6 to 9 m, of 5 to 9 rooms."""
    while True:
        width, depth = int(rng.integers(8, 12)), int(rng.integers(6, 10))
        if not _LEAST <= width * depth <= _MOST:
            continue
        rooms = _cut_rooms(rng, width, depth)
        if not _ROOMS[0] <= len(rooms) <= _ROOMS[1]:
            continue
        room_of = np.empty((width, depth), np.int64)
        for k, room in enumerate(rooms):
            room_of[room.x0 : room.x1, room.y0 : room.y1] = k
        borders = _borders(room_of)
        named = _name_rooms(rooms, borders)
        if not _like_a_flat(named):
            continue
        doors = _choose_doors(rng, named, borders)
        entrance = _choose_entrance(rng, named, width, depth)
        if entrance is not None:
            return FlatPlan(width, depth, tuple(named), room_of, tuple(doors), entrance)


def _cut_rooms(rng: np.random.Generator, width: int, depth: int) -> list[Room]:
    """Rectangles that tile the flat; a corridor of one cell's width, if there is one, comes first."""
    limit = int(rng.integers(10, 17))
    if rng.random() < 0.55:
        at = int(rng.integers(2, depth - 2))
        end = width - (int(rng.integers(3, 5)) if rng.random() < 0.6 else 0)
        parts = [Room(0, 0, end, at), Room(0, at + 1, end, depth)]
        if end < width:
            parts.append(Room(end, 0, width, depth))
        corridor = [Room(0, at, end, at + 1, "hall")]
        if rng.random() < 0.5:
            parts, corridor = (
                [Room(width - r.x1, r.y0, width - r.x0, r.y1, r.kind) for r in group]
                for group in (parts, corridor)
            )
    else:
        parts, corridor = [Room(0, 0, width, depth)], []
    return corridor + [room for part in parts for room in _split(rng, part, limit)]


def _split(rng: np.random.Generator, room: Room, limit: int) -> list[Room]:
    """Cut until no room is larger than `limit` cells or longer than twice its width and a bit."""
    w, d = room.x1 - room.x0, room.y1 - room.y0
    if (room.area <= limit and max(w, d) <= 2 * min(w, d) + 1) or max(w, d) < 4:
        return [room]
    if w >= d:
        at = room.x0 + int(rng.integers(2, w - 1))
        halves = Room(room.x0, room.y0, at, room.y1), Room(at, room.y0, room.x1, room.y1)
    else:
        at = room.y0 + int(rng.integers(2, d - 1))
        halves = Room(room.x0, room.y0, room.x1, at), Room(room.x0, at, room.x1, room.y1)
    return [*_split(rng, halves[0], limit), *_split(rng, halves[1], limit)]


def _borders(room_of: np.ndarray) -> dict[tuple[int, int], list[tuple[Cell, Cell]]]:
    """Pairs of cells on both sides of the wall between two rooms, by the rooms (lower first)."""
    found: dict[tuple[int, int], list[tuple[Cell, Cell]]] = {}
    width, depth = room_of.shape
    for i in range(width):
        for j in range(depth):
            for di, dj in ((1, 0), (0, 1)):
                if i + di < width and j + dj < depth and room_of[i, j] != room_of[i + di, j + dj]:
                    a, b = int(room_of[i, j]), int(room_of[i + di, j + dj])
                    pair = ((i, j), (i + di, j + dj))
                    found.setdefault((min(a, b), max(a, b)), []).append(pair if a < b else pair[::-1])
    return found


def _name_rooms(
    rooms: list[Room], borders: dict[tuple[int, int], list[tuple[Cell, Cell]]]
) -> list[Room]:
    """What each room is for, by size: the largest is to live in, the smallest with a door in reach is the
    bathroom, the kitchen is beside the living room."""
    kinds = [room.kind for room in rooms]
    open_ = [k for k in range(len(rooms)) if not kinds[k]]
    open_.sort(key=lambda k: (-rooms[k].area, k))

    def take(kind: str, order: list[int]) -> None:
        if order:
            kinds[order[0]] = kind
            open_.remove(order[0])

    take("living", open_)
    living = kinds.index("living")
    take("bathroom", sorted(open_, key=lambda k: (rooms[k].area, k)))
    beside = [k for k in open_ if (min(k, living), max(k, living)) in borders and rooms[k].area <= 12]
    take("kitchen", sorted(beside or open_, key=lambda k: (abs(rooms[k].area - 7), k)))
    take("bedroom", open_)
    for k in list(open_):
        area = rooms[k].area
        large = "study" if area < 9 and "study" not in kinds else "bedroom"
        kinds[k] = large if area >= 6 else "storage"
    if kinds.count("storage") > 1:
        kinds[max(k for k, kind in enumerate(kinds) if kind == "storage")] = "toilet"
    return [Room(r.x0, r.y0, r.x1, r.y1, kind) for r, kind in zip(rooms, kinds, strict=True)]


def _like_a_flat(rooms: list[Room]) -> bool:
    """A living room worth the name, no bathroom as large as it, a bed that fits."""
    kinds = {room.kind: room for room in rooms}
    if not {"living", "bathroom", "kitchen", "bedroom"} <= set(kinds):
        return False
    living, bath, bedroom = kinds["living"], kinds["bathroom"], kinds["bedroom"]
    return (
        living.narrow >= 3
        and living.area >= 12
        and bath.area <= 9
        and bedroom.narrow >= 2
        and bedroom.area >= 8
        and kinds["kitchen"].area <= 14
        and sum(r.kind == "storage" for r in rooms) <= 2
    )


def _choose_doors(
    rng: np.random.Generator, rooms: list[Room], borders: dict[tuple[int, int], list[tuple[Cell, Cell]]]
) -> list[tuple[Cell, Cell]]:
    """A tree of doors, the way through shared rooms where there is one, and one to three loops."""

    def cost(pair: tuple[int, int]) -> float:
        kinds = {rooms[pair[0]].kind, rooms[pair[1]].kind}
        shared = sum(kind in _SHARED for kind in kinds)
        private = sum(kind in ("bathroom", "toilet", "storage", "bedroom") for kind in kinds)
        return 2.0 * private - 3.0 * shared - 4.0 * (kinds == {"living", "kitchen"}) + rng.random()

    ranked = sorted(borders, key=cost)
    group = list(range(len(rooms)))
    chosen, spare = [], []
    for a, b in ranked:
        if group[a] != group[b]:
            chosen.append((a, b))
            group = [group[a] if g == group[b] else g for g in group]
        else:
            spare.append((a, b))
    loops = [p for p in spare if not {rooms[p[0]].kind, rooms[p[1]].kind} & {"toilet", "storage"}]
    chosen += loops[: int(rng.integers(1, 4))]
    return [borders[pair][int(rng.integers(len(borders[pair])))] for pair in chosen]


def _choose_entrance(
    rng: np.random.Generator, rooms: list[Room], width: int, depth: int
) -> tuple[Cell, int] | None:
    for kind in ("hall", "living"):
        places = [
            ((i, j), side)
            for room in rooms
            if room.kind == kind
            for i, j in room.cells()
            for side, (di, dj) in enumerate(SIDES)
            if not (0 <= i + di < width and 0 <= j + dj < depth)
        ]
        ends = [p for p in places if kind != "hall" or p[1] < 2] or places
        if ends:
            return ends[int(rng.integers(len(ends)))]
    return None
