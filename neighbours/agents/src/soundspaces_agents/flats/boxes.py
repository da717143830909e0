"""Scenes `flat-0`, `flat-1`, …: furnished flats made by code from their number, for agents to learn in.

Rooms, doors, furniture: `flats`. Walls are 0.1 m thick on lattice lines, 0.2 m outside, doors 0.9 m wide and
centred on cells, so that at 1 m spacing every free cell of the lattice is a point, at 0.5 m four.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from soundspaces_agents.flats.furnish import Furnishing, furnish, is_wall, side_of
from soundspaces_agents.flats.nooks import fill_nooks
from soundspaces_agents.flats.plan import SIDES, Cell, FlatPlan, make_plan
from soundspaces_sim import SceneError
from soundspaces_sim.parts import Box, LabelledMesh, boxes_mesh

_HEIGHT, _DOOR_HEIGHT = 2.6, 2.05
_OUTER, _HALF = 0.2, 0.05  # m: outer walls; half the thickness of inner ones
_TUCK = 0.001  # m by which a wall's end hides in the wall that it meets
_JAMB = 0.05  # m from a cell's edge to its door
_STREAM = 0xF1A7  # keeps flats apart from other uses of the same seed


def flat_mesh(seed: int) -> LabelledMesh:
    """Flat number `seed` as a labelled mesh; the same number gives the same mesh. Raises `SceneError`."""
    return boxes_mesh(flat_boxes(seed), f"flat-{seed}")


def flat_boxes(
    seed: int, height: float = _HEIGHT, stream: int = _STREAM, name: str = "flat"
) -> list[Box]:
    """The boxes of flat number `seed` with rooms `height` m high, at least 2.5. `stream`: another gives other
    flats. Raises `SceneError`, which calls it `name`."""
    if not 0 <= seed < 10**9:
        raise SceneError(f"{name}: expected a number from 0 to 999999999, got {seed}")
    rng = np.random.default_rng((stream, seed))
    while True:
        plan = make_plan(rng)
        furniture = furnish(plan, rng)
        if furniture is not None:
            break
    boxes = [
        *_shell(plan, height),
        *_inner_walls(plan, height),
        *furniture.boxes,
        *_leaves(plan, furniture),
        *_windows(plan, furniture, rng),
        *_floor_and_ceiling(plan, furniture, height, rng),
    ]
    return [*boxes, *fill_nooks(boxes, plan.width, plan.depth)]


def _shell(plan: FlatPlan, h: float) -> Iterator[Box]:
    w, d, o = float(plan.width), float(plan.depth), _OUTER
    yield "floor", -o, -o, -0.2, w + o, d + o, 0.0
    yield "ceiling", -o, -o, h, w + o, d + o, h + 0.2
    yield "wall", -o, -o, 0.0, 0.0, d + o, h
    yield "wall", w, -o, 0.0, w + o, d + o, h
    yield "wall", 0.0, -o, 0.0, w, 0.0, h
    yield "wall", 0.0, d, 0.0, w, d + o, h


def _inner_walls(plan: FlatPlan, height: float) -> Iterator[Box]:
    """Walls between rooms, cell edges in a row merged, cut at doors."""
    doors = {frozenset(pair) for pair in plan.doors}
    for axis in (0, 1):
        across, along = (plan.width, plan.depth) if axis == 0 else (plan.depth, plan.width)
        for line in range(1, across):
            edges: list[int] = []
            for k in range(along):
                a, b = ((line - 1, k), (line, k)) if axis == 0 else ((k, line - 1), (k, line))
                edges.append(0 if plan.room_of[a] == plan.room_of[b] else 2 if {a, b} in doors else 1)
            yield from _wall_line(axis, line, edges, height)


def _wall_line(axis: int, line: int, edges: list[int], height: float) -> Iterator[Box]:
    """One lattice line; per cell edge 0 nothing, 1 wall, 2 wall with a door."""

    def piece(label: str, a: float, b: float, low: float, high: float, half: float = _HALF) -> Box:
        a, b = round(a, 4), round(b, 4)
        if axis == 0:
            return label, line - half, a, low, line + half, b, high
        return label, a, line - half, low, b, line + half, high

    k = 0
    while k < len(edges):
        if not edges[k]:
            k += 1
            continue
        start = k
        while k < len(edges) and edges[k]:
            k += 1
        # Ends reach into the wall that they meet, so that corners are whole.
        begin, end = start - (_HALF - _TUCK) * (start > 0), k + (_HALF - _TUCK) * (k < len(edges))
        for door in (d for d in range(start, k) if edges[d] == 2):
            yield piece("wall", begin, door + _JAMB, 0.0, height)
            yield piece("wall", door + _JAMB, door + 1 - _JAMB, _DOOR_HEIGHT, height)
            begin = door + 1 - _JAMB
        yield piece("wall", begin, end, 0.0, height)


def _against(cell: Cell, side: int, a: float, b: float, near: float, far: float) -> tuple[float, ...]:
    """x0, y0, x1, y1 of what spans a to b along a cell's side, from `near` to `far` m off the lattice line."""
    i, j = cell
    if side == 0:
        return i + near, j + a, i + far, j + b
    if side == 1:
        return i + 1 - far, j + a, i + 1 - near, j + b
    if side == 2:
        return i + a, j + near, i + b, j + far
    return i + a, j + 1 - far, i + b, j + 1 - near


def _panel(label: str, spans: tuple[float, ...], low: float, high: float) -> Box:
    x0, y0, x1, y1 = (round(float(v), 4) for v in spans)
    return label, x0, y0, low, x1, y1, high


def _leaves(plan: FlatPlan, furniture: Furnishing) -> Iterator[Box]:
    """Door leaves, wide open: at a wall beside the door, folded back on it, or, without either, none."""
    (cell, side) = plan.entrance
    yield _panel("door", _against(cell, side, 0.05, 0.95, 0.001, 0.03), 0.0, 2.05)
    doors = {(a, side_of(a, b)) for pair in plan.doors for a, b in (pair, pair[::-1])} | {plan.entrance}
    for pair in plan.doors:
        if place := _leaf_place(plan, furniture, doors, pair):
            cell, side, a, b = place
            furniture.used.add((cell, side))
            furniture.tall.add((cell, side))
            yield _panel("door", _against(cell, side, a, b, 0.06, 0.1), 0.01, 2.03)


def _leaf_place(
    plan: FlatPlan, furniture: Furnishing, doors: set[tuple[Cell, int]], pair: tuple[Cell, Cell]
) -> tuple[Cell, int, float, float] | None:
    for a, b in (pair, pair[::-1]):
        side = side_of(a, b)
        for turn in (2, 3) if side < 2 else (0, 1):  # a wall at a right angle, in the door's own cell
            if is_wall(plan, a, turn) and (a, turn) not in doors | furniture.used:
                low = side in (0, 2)  # the door is at the low end of that wall
                return a, turn, *((0.06, 0.92) if low else (0.08, 0.94))
        for turn in (2, 3) if side < 2 else (0, 1):  # folded back on the wall beside it
            beside = (a[0] + SIDES[turn][0], a[1] + SIDES[turn][1])
            if not (0 <= beside[0] < plan.width and 0 <= beside[1] < plan.depth):
                continue
            same = plan.room_of[beside] == plan.room_of[a]
            if (
                same
                and is_wall(plan, beside, side)
                and not furniture.taken[beside]
                and (beside, side) not in doors | furniture.used
            ):
                return beside, side, *((0.08, 0.94) if turn in (0, 2) else (0.06, 0.92))
    return None


def _windows(plan: FlatPlan, furniture: Furnishing, rng: np.random.Generator) -> Iterator[Box]:
    """Panes on outer walls, one or two cells wide, with curtains in rooms to live in."""
    for room in plan.rooms:
        if room.kind in ("hall", "storage", "toilet"):
            continue
        for side in range(4):
            at_edge = (room.x0 == 0, room.x1 == plan.width, room.y0 == 0, room.y1 == plan.depth)[side]
            if not at_edge:
                continue
            row = sorted(c for c in room.cells() if not _inside(plan, c, side))
            free = [c for c in row if (c, side) not in furniture.tall and (c, side) != plan.entrance]
            if not free:
                continue
            first = free[int(rng.integers(len(free)))]
            step = (0, 1) if side < 2 else (1, 0)
            second = (first[0] + step[0], first[1] + step[1])
            wide = second in free and room.kind != "bathroom"
            sill = 1.3 if room.kind == "bathroom" else 1.0 if room.kind == "kitchen" else 0.9
            a, b = (0.2, 1.8) if wide else (0.15, 0.85)
            yield _panel("window", _against(first, side, a, b, 0.001, 0.02), sill, 2.15)
            if room.kind in ("living", "bedroom", "study"):
                for x in (a - 0.14, b + 0.01):
                    yield _panel("curtain", _against(first, side, x, x + 0.13, 0.03, 0.09), 1.0, 2.35)


def _inside(plan: FlatPlan, cell: Cell, side: int) -> bool:
    i, j = cell[0] + SIDES[side][0], cell[1] + SIDES[side][1]
    return 0 <= i < plan.width and 0 <= j < plan.depth


def _floor_and_ceiling(
    plan: FlatPlan, furniture: Furnishing, height: float, rng: np.random.Generator
) -> Iterator[Box]:
    """A rug where people sit and sleep, a mat where it is wet, a lamp in every room."""
    for room in plan.rooms:
        x, y = 0.5 * (room.x0 + room.x1), 0.5 * (room.y0 + room.y1)
        yield _panel("lamp", (x - 0.18, y - 0.18, x + 0.18, y + 0.18), 2.2, 2.45)
        yield _panel("lamp", (x - 0.01, y - 0.01, x + 0.01, y + 0.01), 2.45, height)
        chance = {"living": 1.0, "bedroom": 0.7, "hall": 0.6, "bathroom": 0.8, "study": 0.5}.get(
            room.kind, 0.0
        )
        if rng.random() >= chance:
            continue
        free = [c for c in room.cells() if not furniture.taken[c]]
        if room.kind == "bathroom":
            i, j = free[int(rng.integers(len(free)))]
            yield _panel("mat", (i + 0.15, j + 0.2, i + 0.85, j + 0.8), 0.0, 0.015)
            continue
        inset = 0.25 if room.kind == "hall" else 0.45
        spans = (room.x0 + inset, room.y0 + inset, room.x1 - inset, room.y1 - inset)
        if min(spans[2] - spans[0], spans[3] - spans[1]) > 0.3:
            yield _panel("rug", spans, 0.0, 0.012)
