"""Homes: `home-<n>`, flats and houses of one or two storeys, with slanted roofs, galleries, open plans and bays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from soundspaces_buildings.data import draw_area, draw_finishes, programmes
from soundspaces_buildings.furnish import rectangle
from soundspaces_buildings.large import steps
from soundspaces_buildings.rooms import Door, Interior, Way, fill
from soundspaces_buildings.shapes import draw_height
from soundspaces_buildings.shell import HALF, Building, Opening, Profile, Room
from soundspaces_buildings.single import draw_density, outer_door
from soundspaces_buildings.solids import Solid, box

_SLACK = 1.45  # how far an area may lie beyond its programme's bounds


@dataclass(frozen=True)
class Cell:
    """A room of a plan: `strip` is south, north, hall or end (over the full depth); x0 to x1 along the corridor.
    `hook`: an L that takes the end of the corridor from there on, m; 0 is none."""

    kind: str
    strip: str
    x0: float
    x1: float
    hook: float = 0.0


@dataclass(frozen=True)
class Plan:
    """The storey's cells; `width` along the corridor, m; depths of both strips and of the corridor."""

    cells: tuple[Cell, ...]
    width: float
    south: float
    hall: float
    north: float

    @property
    def depth(self) -> float:
        return self.south + self.hall + self.north

    def outline(self, cell: Cell) -> np.ndarray:
        """(n, 2) of a cell."""
        s, t = self.south, self.south + self.hall
        y0, y1 = {
            "south": (0.0, s),
            "north": (t, self.depth),
            "hall": (s, t),
            "end": (0.0, self.depth),
        }[cell.strip]
        points = [(cell.x0, y0), (cell.x1, y0), (cell.x1, y1), (cell.x0, y1)]
        if cell.hook:
            points = [
                (cell.x0, y0),
                (cell.x1, y0),
                (cell.x1, t),
                (cell.hook, t),
                (cell.hook, y1),
                (cell.x0, y1),
            ]
        return np.array(points)


def draw_kinds(rng: np.random.Generator, storeys: int) -> list[list[str]]:
    """Rooms of each storey, living room first: one to four bedrooms, a bathroom on every storey."""
    bedrooms = int(rng.choice([1, 2, 3, 4], p=[0.2, 0.35, 0.33, 0.12]))
    rest = [
        kind
        for kind, chance in (("study", 0.3), ("dining", 0.2), ("storage", 0.45))
        if rng.random() < chance
    ]
    if storeys == 1:
        return [["living", "kitchen", "bathroom", *["bedroom"] * bedrooms, *rest]]
    below = ["living", "kitchen", *rest, *(["bathroom"] if rng.random() < 0.5 else [])]
    return [below, ["bathroom", *["bedroom"] * max(bedrooms, 2)]]


def draw_plan(
    kinds: Sequence[str],
    rng: np.random.Generator,
    hall: float,
    fixed: tuple[float, float, float] | None = None,
    void: tuple[float, float] | None = None,
) -> Plan | None:
    """A plan for these rooms, or None if they do not fit. `fixed`: width and depths of the strips, of a storey
    above another; `void`: x0 and x1 of a part of the southern strip that stays empty."""
    areas = [draw_area(programmes()[kind], rng) for kind in kinds]
    # The depth of a strip makes a bedroom of 12 m² 2.7 to 4 m wide.
    south, north = (float(v) for v in rng.uniform(3.0, 4.5, 2)) if fixed is None else fixed[1:]
    order = rng.permutation(len(kinds))
    strips: dict[str, list[int]] = {"south": [], "north": []}
    used = {"south": void[1] - void[0] if void else 0.0, "north": 0.0}
    for k in sorted(order.tolist(), key=lambda k: -areas[k]):
        strip = min(used, key=lambda s: (used[s], s))
        strips[strip].append(k)
        used[strip] += areas[k] / (south if strip == "south" else north) + 2 * HALF
    width = max(used.values()) if fixed is None else fixed[0]
    cells = []
    for strip, rows in strips.items():
        start = void[1] if void and strip == "south" else 0.0
        if not rows:
            return None
        rows = [rows[i] for i in rng.permutation(len(rows))]
        deep = south if strip == "south" else north
        wanted = np.array([areas[k] / (deep - 2 * HALF) + 2 * HALF for k in rows])
        edges = start + (width - start) * np.concatenate([[0.0], np.cumsum(wanted) / wanted.sum()])
        for k, x0, x1 in zip(rows, edges[:-1], edges[1:], strict=True):
            if not _fits(kinds[k], x1 - x0 - 2 * HALF, deep - 2 * HALF):
                return None
            cells.append(Cell(kinds[k], strip, float(x0), float(x1)))
    return Plan((Cell("hall", "hall", 0.0, width), *cells), width, south, hall, north)


def _fits(kind: str, width: float, deep: float) -> bool:
    programme = programmes()[kind]
    low, _, high = programme.area
    return (
        min(width, deep) >= programme.narrow
        and low / _SLACK <= width * deep <= high * _SLACK
        and max(width, deep) <= 3.2 * min(width, deep)
    )


def with_variation(plan: Plan, rng: np.random.Generator) -> Plan:
    """Some plans change: the living room takes the end of the corridor as an L, or a new end of the house."""
    living = next((c for c in plan.cells if c.kind == "living"), None)
    draw = rng.random()
    if living is None or draw > 0.5:
        return plan
    cells = [c for c in plan.cells if c.kind not in ("hall", "living")]
    if draw < 0.25 and living.strip == "south" and abs(living.x1 - plan.width) < 1e-9:
        hook = max(living.x0 + 1.3, living.x1 - 3.2)
        # Doors of the northern rooms stay on what is left of the corridor.
        if all(c.x0 < hook - 1.5 for c in cells if c.strip == "north"):
            hall = Cell("hall", "hall", 0.0, hook)
            return Plan(
                (hall, *cells, Cell("living", "south", living.x0, living.x1, hook)),
                plan.width,
                plan.south,
                plan.hall,
                plan.north,
            )
    if draw >= 0.25 and any(c.strip == living.strip for c in cells):
        # The rest of its strip is stretched over the gap that it leaves; it becomes the house's end.
        rest = [c for c in cells if c.strip == living.strip]
        scale = plan.width / (plan.width - (living.x1 - living.x0))
        if scale > 1.5 or any(c.strip == "end" for c in cells):
            return plan
        moved_cells, x = [c for c in cells if c.strip != living.strip], 0.0
        for c in sorted(rest, key=lambda c: c.x0):
            moved_cells.append(Cell(c.kind, c.strip, x, x + scale * (c.x1 - c.x0)))
            x += scale * (c.x1 - c.x0)
        wide = max((living.x1 - living.x0) * plan.south / plan.depth, 3.0)
        end = Cell("living", "end", plan.width, plan.width + wide)
        hall = Cell("hall", "hall", 0.0, plan.width)
        return Plan((hall, *moved_cells, end), plan.width + wide, plan.south, plan.hall, plan.north)
    return plan


_BETWEEN = 0.3  # m from a ceiling to the floor above
_GOING = 0.25  # m
_FLIGHT = 1.0  # m, its width
_ALONG = np.array([1.0, 0.0])
_LANDING = 0.9  # m before the first step and after the last that stay free
_FINISHES = {"kitchen": "kitchen", "bathroom": "wet", "hall": "passage", "storage": "passage"}
_REFURNISH = 4  # tries to furnish a room before the plan is drawn anew
_CURTAINS = {
    "living": 0.9,
    "bedroom": 0.9,
    "dining": 0.8,
    "study": 0.8,
}  # shares of rooms that have some
_CURTAINS_ELSEWHERE = 0.5
_BLIND = ("hall", "storage", "stairwell")  # rooms without windows


@dataclass
class _Storey:
    plan: Plan
    floor: float
    height: float
    doors: list[
        tuple[Door, Cell | None, Cell]
    ]  # with the cells on its right and left as seen from a to b
    openings: list[Opening]


@dataclass(frozen=True)
class _Stairs:
    """A flight beside the northern wall of the hall, from x0 to x1, and the edge of the hole above it."""

    x0: float
    x1: float
    y: float
    wall: float

    @property
    def hole(self) -> np.ndarray:
        return rectangle(np.array([self.x0, self.y]), _ALONG, (self.x1 - self.x0, self.wall - self.y))

    def way(self, up: bool) -> Way:
        """Where one steps off the flight upstairs (`up`) or onto it downstairs."""
        at = np.array([self.x1 if up else self.x0 - _LANDING, self.y])
        clear = rectangle(at, _ALONG, (_LANDING, self.wall - HALF - self.y))
        return Way([], clear, clear.mean(axis=0))


def make_home(rng: np.random.Generator) -> Building | None:
    """A furnished home, or None if what was drawn does not fit."""
    storeys = 2 if rng.random() < 0.4 else 1
    kinds = draw_kinds(rng, storeys)
    hall = 2 * HALF + (2.3 if storeys == 2 else float(rng.uniform(1.05, 1.5)))
    ground = draw_plan(kinds[0], rng, hall)
    if ground is None or ground.width > 16.0:
        return None
    if storeys == 1:
        home = _single_storey(with_variation(ground, rng), rng)
    else:
        home = _two_storeys(ground, kinds[1], rng)
    if home is None or rng.random() < 0.5:
        return home
    angle = float(rng.uniform(0.0, 2.0 * np.pi))
    return home.turned(np.array([np.cos(angle), np.sin(angle)]))


def _single_storey(plan: Plan, rng: np.random.Generator) -> Building | None:
    storey = _Storey(plan, 0.0, draw_height(rng), [], [])
    roof = None
    if rng.random() < 0.3:
        roof = float(rng.uniform(2.25, 2.6))  # eaves
        pitch = np.tan(np.deg2rad(float(rng.uniform(15.0, 42.0))))
        storey.height = float(min(roof + pitch * 0.5 * plan.depth, 4.5))
    # A shear turns every cross wall off the right angle.
    shear = float(rng.uniform(-0.25, 0.25)) if rng.random() < 0.25 else 0.0
    if any(c.strip == "end" or c.hook for c in plan.cells):
        shear = 0.0
    if not _add_doors(storey, None, rng):
        return None
    return _rooms(storey, rng, draw_finishes("dwelling", rng), roof=roof, shear=shear)


def _two_storeys(plan: Plan, upper_kinds: list[str], rng: np.random.Generator) -> Building | None:
    h = float(rng.uniform(2.35, 2.9))
    rise = h + _BETWEEN
    count = int(np.ceil(rise / 0.18 - 1e-9))
    length = (count - 1) * _GOING
    y = plan.south + plan.hall - HALF - _FLIGHT
    spare = plan.width - length - 2.4
    if spare < 0.0:
        return None
    x0 = 1.2 + spare * float(rng.random())
    stairs = _Stairs(x0, x0 + length, y, plan.south + plan.hall)
    living = next(c for c in plan.cells if c.kind == "living")
    tall = living.strip == "south" and living.x0 < 1e-9 and rng.random() < 0.7
    void = (0.0, living.x1) if tall else None
    above = draw_plan(upper_kinds, rng, plan.hall, (plan.width, plan.south, plan.north), void)
    if above is None:
        return None
    low, high = _Storey(plan, 0.0, h, [], []), _Storey(above, rise, float(rng.uniform(2.3, 2.8)), [], [])
    if not _add_doors(low, stairs, rng) or not _add_doors(high, stairs, rng):
        return None
    if tall:
        a, b = (np.array([x, plan.south]) for x in (0.6, living.x1 - 0.6))
        gallery = Opening(a, b, rise + 0.95, rise + 2.15)
        low.openings.append(gallery)
        high.openings.append(gallery)
    finishes = draw_finishes("dwelling", rng)
    below = _rooms(low, rng, finishes, stairs=stairs, tall=high if tall else None)
    if below is None:
        return None
    upper = _rooms(high, rng, finishes, stairs=stairs)
    if upper is None:
        return None
    flight = _stair_solids(stairs, finishes, h, rise)
    return Building([*below.solids, *upper.solids, *flight], [*below.rooms, *upper.rooms])


def _stair_solids(stairs: _Stairs, finishes: dict[str, str], ceiling: float, rise: float) -> list[Solid]:
    """The flight, what closes the wall beside its hole, and the railing on two sides of it."""
    x0, y, end = stairs.x0, stairs.y, stairs.wall - HALF - 0.001
    return [
        *steps(finishes["stair"], x0, y, end, rise, _GOING),
        box(finishes["wall"], x0, stairs.wall - HALF, ceiling, stairs.x1, stairs.wall, rise),
        box("railing", x0 - 0.05, y - 0.06, rise, stairs.x1, y - 0.02, rise + 0.95),
        box("railing", x0 - 0.05, y - 0.02, rise, x0 - 0.01, end, rise + 0.95),
    ]


def _add_doors(storey: _Storey, stairs: _Stairs | None, rng: np.random.Generator) -> bool:
    """A door from the hall into every room, clear of the flight; and between rooms of a strip an opening, a closed
    or an open door, at times. Whether all rooms got one."""
    plan = storey.plan
    hall = next(c for c in plan.cells if c.kind == "hall")
    for cell in plan.cells:
        if cell.kind == "hall":
            continue
        width = 0.8 if cell.kind in ("bathroom", "storage") else 0.9
        if cell.strip == "end" or cell.hook:
            x = cell.hook or cell.x0
            middle = plan.south + 0.5 * plan.hall
            a, b = np.array([x, middle + 0.5 * width]), np.array([x, middle - 0.5 * width])
        else:
            end = hall.x1 if cell.strip == "north" else min(cell.x1, hall.x1)
            at = _free_place(
                cell.x0, min(cell.x1, end), width, stairs if cell.strip == "north" else None, rng
            )
            if at is None:
                return False
            y = plan.south if cell.strip == "south" else plan.south + plan.hall
            ends = (np.array([at, y]), np.array([at + width, y]))
            # The room lies to the left as seen from a to b.
            a, b = ends if cell.strip == "north" else ends[::-1]
        leaf = (None, float(rng.uniform(38.0, 70.0)), float(rng.uniform(80.0, 95.0)))[
            int(np.searchsorted([0.12, 0.5], rng.random()))
        ]
        storey.doors.append((Door(a, b, storey.floor, leaf=leaf), hall, cell))
    _join_rooms(storey, rng)
    storey.openings += [door.opening() for door, _, _ in storey.doors]
    return True


def _free_place(
    x0: float, x1: float, width: float, stairs: _Stairs | None, rng: np.random.Generator
) -> float | None:
    """Where a door of this width may begin between two walls, off the flight of stairs."""
    margin = HALF + 0.06
    spans = [(x0 + margin, x1 - margin)]
    if stairs is not None:
        spans = [
            (max(low, a), min(high, b))
            for low, high in spans
            for a, b in ((-np.inf, stairs.x0 - 0.1), (stairs.x1 + 0.1, np.inf))
        ]
    spans = [(low, high - width) for low, high in spans if high - low > width]
    if not spans:
        return None
    low, high = max(spans, key=lambda s: s[1] - s[0])
    return float(rng.choice([low, high, rng.uniform(low, high)]))


def _join_rooms(storey: _Storey, rng: np.random.Generator) -> None:
    plan = storey.plan
    shared = ("living", "kitchen", "dining", "study")
    for one in plan.cells:
        for other in plan.cells:
            beside = one.strip == other.strip and abs(one.x1 - other.x0) < 1e-9
            if not beside or not {one.kind, other.kind} <= set(shared) or one.hook or other.hook:
                continue
            y0, y1 = (0.0, plan.south) if one.strip == "south" else (plan.south + plan.hall, plan.depth)
            draw = rng.random()
            if draw < 0.45:  # open plan
                ends = np.array([one.x1, y0 + 0.5]), np.array([one.x1, y1 - 0.4])
                storey.openings.append(Opening(*ends, storey.floor, storey.floor + 9.0))
            elif draw < 0.8:
                a = np.array([one.x1, y0 + 1.1])
                leaf = 0.0 if draw < 0.65 else 90.0
                door = Door(a, a + np.array([0.0, 0.9]), storey.floor, leaf=leaf)
                storey.doors.append((door, other, one))


def _sheared(points: np.ndarray, shear: float) -> np.ndarray:
    return np.asarray(points + np.stack([shear * points[:, 1], 0.0 * points[:, 1]], axis=1))


def _finishes_by_room(finishes: dict[str, str], rng: np.random.Generator) -> dict[str, dict[str, str]]:
    """Finishes of the rooms that have other ones than the living room."""
    sets = {kind: draw_finishes(use, rng, finishes) for kind, use in _FINISHES.items()}
    other = draw_finishes("dwelling", rng)["floor"]
    return {**sets, "bedroom": {**finishes, "floor": other if rng.random() < 0.5 else finishes["floor"]}}


def _rooms(
    storey: _Storey,
    rng: np.random.Generator,
    finishes: dict[str, str],
    stairs: _Stairs | None = None,
    tall: _Storey | None = None,
    roof: float | None = None,
    shear: float = 0.0,
) -> Building | None:
    """All rooms of a storey; `tall`: the storey above, into which the living room rises."""
    plan = storey.plan
    out: list[Solid] = []
    rooms: list[Room] = []
    sets = _finishes_by_room(finishes, rng)
    doors = [
        (replace(d, a=_sheared(d.a[None], shear)[0], b=_sheared(d.b[None], shear)[0]), r, l)
        for d, r, l in storey.doors
    ]
    openings = [
        replace(o, a=_sheared(o.a[None], shear)[0], b=_sheared(o.b[None], shear)[0])
        for o in storey.openings
    ]
    crowd = draw_density(rng)
    for cell in plan.cells:
        room = _room(storey, cell, sets.get(cell.kind, finishes), stairs, tall, roof)
        bay = cell.kind == "living" and cell.strip == "south" and not cell.hook and not roof
        if bay and cell.x1 - cell.x0 > 3.6 and rng.random() < 0.35:
            room = _with_bay(room, rng)
        room = replace(room, outline=_sheared(room.outline, shear))
        ways = [d.way(1) for d, _, left in doors if left is cell]
        ways += [d.way(-1) for d, right, _ in doors if right is cell]
        if cell.kind == "hall" and storey.floor == 0.0:
            ways.append(outer_door(room, len(room.outline) - 1, rng))
        if cell.kind == "hall" and stairs is not None:
            ways.append(stairs.way(storey.floor > 0.0))
        holes = (stairs.hole,) if stairs is not None and cell.kind == "hall" else ()
        density = float(np.clip(crowd + 0.15 * rng.standard_normal(), 0.02, 1.0)) if crowd else 0.0
        curtains = rng.random() < _CURTAINS.get(cell.kind, _CURTAINS_ELSEWHERE)
        interior = Interior(density, _windows(plan, cell, room, rng), curtains, holes=holes)
        for _ in range(_REFURNISH):
            solids = fill(room, ways, openings, interior, rng)
            if solids is not None:
                break
        else:
            return None
        out += solids
        rooms.append(room)
    return Building([*out, *(s for door, _, _ in doors for s in door.solids("door")[:1])], rooms)


def _room(
    storey: _Storey,
    cell: Cell,
    finishes: dict[str, str],
    stairs: _Stairs | None,
    tall: _Storey | None,
    roof: float | None,
) -> Room:
    plan, outline = storey.plan, storey.plan.outline(cell)
    top = storey.floor + storey.height
    room = Room(cell.kind, outline, storey.floor, top, finishes)
    if cell.kind == "hall" and stairs is not None:
        s, (w, y0, y1) = stairs, (plan.width, plan.south, plan.south + plan.hall)
        notch = np.array(
            [(0.0, y0), (w, y0), (w, y1), (s.x1, y1), (s.x1, s.y), (s.x0, s.y), (s.x0, y1), (0.0, y1)]
        )
        room = replace(room, kind="stairwell")
        if storey.floor == 0.0:
            return replace(room, ceiling_outline=notch)
        return replace(room, floor_outline=notch)
    if tall is not None and cell.kind == "living":
        return replace(room, ceiling=tall.floor + tall.height)
    if roof is None or cell.kind == "hall" or cell.hook:
        return room
    if cell.strip == "end":
        at = np.array([0.0, 0.5, 1.0]) * plan.depth
        ridge = np.array([roof, top, roof])
        return replace(room, profile=Profile(np.zeros(2), np.array([1.0, 0.0]), at, ridge))
    south = cell.strip == "south"
    origin = np.zeros(2) if south else np.array([0.0, plan.depth])
    along = np.array([1.0, 0.0]) if south else np.array([-1.0, 0.0])
    at = np.array([0.0, plan.south if south else plan.north])
    return replace(room, profile=Profile(origin, along, at, np.array([roof, top])))


def _with_bay(room: Room, rng: np.random.Generator) -> Room:
    """The room with a bay in its southern wall."""
    (x0, y), (x1, _) = room.outline[:2]
    wide, deep = float(rng.uniform(2.0, 2.6)), float(rng.uniform(0.6, 0.9))
    a = 0.5 * (x0 + x1 - wide)
    bay = [(a, y), (a + 0.5, y - deep), (a + wide - 0.5, y - deep), (a + wide, y)]
    points = np.array([(x0, y), *bay, *room.outline[1:]])
    return replace(room, outline=points)


def _windows(
    plan: Plan, cell: Cell, room: Room, rng: np.random.Generator
) -> tuple[tuple[int, float], ...]:
    """Windows in outer walls: the long ones always, those at the ends of the house at times."""
    if room.kind in _BLIND:
        return ()
    points = room.outline
    middle = 0.5 * (points[:, 1] + np.roll(points[:, 1], -1))
    out = []
    for k in range(len(points)):
        a, b = points[k], points[(k + 1) % len(points)]
        facade = middle[k] < 1e-6 or middle[k] > plan.depth - 1e-6
        gable = (cell.x0 < 1e-9 and k == len(points) - 1) or (cell.x1 > plan.width - 1e-9 and k == 1)
        if np.linalg.norm(b - a) < 1.0:
            continue
        if facade or (gable and len(points) == 4 and rng.random() < 0.3):
            out.append((k, float(rng.uniform(0.3, 0.65))))
    return tuple(out)
