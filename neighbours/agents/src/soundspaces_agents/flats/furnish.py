"""Where furniture stands: in whole cells against walls, never in front of a door, never cutting the way.

After every piece all free cells are still one connected whole, and every room keeps one; so are their
quarters, the places of a half-metre grid, past what stands in front of a wall in a free cell.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from soundspaces_agents.flats.pieces import FURNITURE, SHALLOW, Piece
from soundspaces_agents.flats.plan import SIDES, Cell, FlatPlan
from soundspaces_sim.parts import Box

_FEWEST, _MOST = 44, 69  # free cells
_FILLED = 0.34  # of all cells, at most


@dataclass
class Furnishing:
    """`taken` (width, depth) cells that furniture fills; `boxes`; `used`, `deep`, `tall`: (cell, side) of walls
    with something before them, with something that one walks around, and with something before a window's
    place."""

    taken: np.ndarray
    boxes: list[Box] = field(default_factory=list)
    used: set[tuple[Cell, int]] = field(default_factory=set)
    deep: set[tuple[Cell, int]] = field(default_factory=set)
    tall: set[tuple[Cell, int]] = field(default_factory=set)


def furnish(plan: FlatPlan, rng: np.random.Generator) -> Furnishing | None:
    """Furniture for a plan; None if more cells than wanted stay free, or a room lacks what it is for."""
    doors = {(a, side_of(a, b)) for pair in plan.doors for a, b in (pair, pair[::-1])} | {plan.entrance}
    keep = {cell for cell, _ in doors}
    out = Furnishing(np.zeros((plan.width, plan.depth), bool))
    wishes = [FURNITURE[room.kind] for room in plan.rooms]
    wet_first = sorted(
        range(len(wishes)), key=lambda k: plan.rooms[k].kind not in ("bathroom", "kitchen")
    )
    for turn in range(max(len(w) for w in wishes)):
        for k in wet_first:
            wish = wishes[k]
            if turn >= len(wish):
                continue
            placed = any(_place(plan, k, piece, out, keep, doors, rng) for piece in wish[turn])
            if turn == 0 and not placed:
                return None
    if not _FEWEST <= int((~out.taken).sum()) <= _MOST:
        return None
    for k, room in enumerate(plan.rooms):
        for piece in SHALLOW[room.kind]:
            _hang(plan, k, piece, out, doors, rng)
    return out


def side_of(a: Cell, b: Cell) -> int:
    """The side of cell a on which its neighbour b lies."""
    return SIDES.index((b[0] - a[0], b[1] - a[1]))


def is_wall(plan: FlatPlan, cell: Cell, side: int) -> bool:
    """Whether a wall, with or without a door, stands on a side of a cell."""
    i, j = cell[0] + SIDES[side][0], cell[1] + SIDES[side][1]
    inside = 0 <= i < plan.width and 0 <= j < plan.depth
    return not inside or bool(plan.room_of[i, j] != plan.room_of[cell])


def _places(
    plan: FlatPlan, room: int, piece: Piece
) -> list[tuple[tuple[Cell, ...], tuple[Cell, ...], int]]:
    """(all cells, those at the wall, side of the wall) wherever a piece fits into a room."""
    r, found = plan.rooms[room], []
    depth = max(piece.depth, 1)
    for side in range(4):
        w, d = (depth, piece.width) if side < 2 else (piece.width, depth)
        for i in range(r.x0, r.x1 - w + 1):
            for j in range(r.y0, r.y1 - d + 1):
                cells = tuple((a, b) for a in range(i, i + w) for b in range(j, j + d))
                edge = (i, i + w - 1, j, j + d - 1)[side]
                back = tuple(c for c in cells if c[side // 2] == edge)
                if all(is_wall(plan, c, side) for c in back):
                    found.append((cells, back, side))
    return found


def _place(
    plan: FlatPlan,
    room: int,
    piece: Piece,
    out: Furnishing,
    keep: set[Cell],
    doors: set[tuple[Cell, int]],
    rng: np.random.Generator,
) -> bool:
    """Put a piece where it hides the most wall, ties at random."""
    options = []
    for cells, back, side in _places(plan, room, piece):
        if any(out.taken[c] or c in keep for c in cells) or any((c, side) in doors for c in back):
            continue
        sheltered = sum(is_wall(plan, c, s) for c in cells for s in range(4))
        options.append((-sheltered + rng.random(), cells, back, side))
    for _, cells, back, side in sorted(options):
        trial = out.taken.copy()
        trial[tuple(np.array(cells).T)] = True
        if int((~trial).sum()) < max(_FEWEST, (1.0 - _FILLED) * trial.size) or not _walkable(
            plan, trial, room
        ):
            continue
        out.taken[:] = trial
        walls = {(c, side) for c in back}
        out.used |= {(c, s) for c in cells for s in range(4)}
        if piece.tall:
            out.tall |= walls
        out.boxes += [_turned(box, cells, side) for box in piece.boxes(rng)]
        return True
    return False


def _hang(
    plan: FlatPlan,
    room: int,
    piece: Piece,
    out: Furnishing,
    doors: set[tuple[Cell, int]],
    rng: np.random.Generator,
) -> None:
    options = [
        (cells, side)
        for cells, _, side in _places(plan, room, piece)
        if not out.taken[cells[0]]
        and (cells[0], side) not in doors | out.used
        and not any((cells[0], s) in out.used for s in range(4))
        and (piece.flat or _quarters_connected(plan, out, (cells[0], side)))
    ]
    if not options:
        return
    cells, side = options[int(rng.integers(len(options)))]
    out.used.add((cells[0], side))
    if not piece.flat:
        out.deep.add((cells[0], side))
    if piece.tall:
        out.tall.add((cells[0], side))
    out.boxes += [_turned(box, cells, side) for box in piece.boxes(rng)]


def _walkable(plan: FlatPlan, taken: np.ndarray, room: int) -> bool:
    """Whether the free cells are one piece, doors included, and the room has one."""
    here = np.argwhere(~taken & (plan.room_of == room))
    if len(here) == 0:
        return False
    links = {frozenset(pair) for pair in plan.doors}
    seen, todo = {tuple(here[0])}, [tuple(here[0])]
    while todo:
        i, j = todo.pop()
        for di, dj in SIDES:
            other = (i + di, j + dj)
            if not (0 <= other[0] < plan.width and 0 <= other[1] < plan.depth) or taken[other]:
                continue
            free = plan.room_of[other] == plan.room_of[i, j] or frozenset(((i, j), other)) in links
            if free and other not in seen:
                seen.add(other)
                todo.append(other)
    return len(seen) == int((~taken).sum())


def _quarters_connected(plan: FlatPlan, out: Furnishing, more: tuple[Cell, int]) -> bool:
    """Whether the free quarters of cells are one piece if `more` has something before it, too."""
    free = ~np.repeat(np.repeat(out.taken, 2, axis=0), 2, axis=1)
    for (i, j), side in out.deep | {more}:
        rows = slice(2 * i + (side == 1), 2 * i + 2 - (side == 0))
        columns = slice(2 * j + (side == 3), 2 * j + 2 - (side == 2))
        free[rows, columns] = False
    links = {frozenset(pair) for pair in plan.doors}
    start = tuple(np.argwhere(free)[0])
    seen, todo = {start}, [start]
    while todo:
        i, j = todo.pop()
        for di, dj in SIDES:
            a, b = i + di, j + dj
            if (
                not (0 <= a < free.shape[0] and 0 <= b < free.shape[1])
                or not free[a, b]
                or (a, b) in seen
            ):
                continue
            here, there = (i // 2, j // 2), (a // 2, b // 2)
            if plan.room_of[here] == plan.room_of[there] or frozenset((here, there)) in links:
                seen.add((a, b))
                todo.append((a, b))
    return len(seen) == int(free.sum())


def _turned(box: Box, cells: tuple[Cell, ...], side: int) -> Box:
    """A box of a piece's frame where the piece stands, its back to the wall on `side`."""
    label, x0, y0, z0, x1, y1, z1 = box
    low = np.min(cells, axis=0)
    high = np.max(cells, axis=0) + 1
    corners = []
    for x, y in ((x0, y0), (x1, y1)):
        corners.append(
            (
                (low[0] + y, high[1] - x),
                (high[0] - y, low[1] + x),
                (low[0] + x, low[1] + y),
                (high[0] - x, high[1] - y),
            )[side]
        )
    (ax, ay), (bx, by) = corners
    values = min(ax, bx), min(ay, by), z0, max(ax, bx), max(ay, by), z1
    return (label, *(round(float(v), 4) for v in values))  # type: ignore[return-value]
