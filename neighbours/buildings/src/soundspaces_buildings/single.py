"""Single rooms: `room-<n>` of dwellings, `office-<n>` and `classroom-<n>`."""

from __future__ import annotations

import numpy as np

from soundspaces_buildings.data import draw_area, draw_finishes, furniture, programmes
from soundspaces_buildings.furnish import Floor, column, rectangle
from soundspaces_buildings.rooms import Interior, Way, fill
from soundspaces_buildings.shapes import cell_of, draw_height, draw_shape, gable, slope
from soundspaces_buildings.shell import Building, Profile, Room
from soundspaces_buildings.solids import Solid, prism
from soundspaces_buildings.walkway import inside

#: Uses of a single room in a dwelling, and shapes, with weights.
_USES = {
    "living": 0.28,
    "bedroom": 0.26,
    "kitchen": 0.1,
    "bathroom": 0.1,
    "study": 0.1,
    "dining": 0.08,
    "empty": 0.08,
}
_SHAPES = {"box": 0.48, "L": 0.14, "T": 0.05, "skew": 0.13, "bay": 0.1, "polygon": 0.1}
_FINISHES = {"kitchen": "kitchen", "bathroom": "wet"}


def pick(weights: dict[str, float], rng: np.random.Generator) -> str:
    """A key with a chance in proportion to its weight."""
    total = np.cumsum(list(weights.values()))
    return list(weights)[min(int(np.searchsorted(total, rng.random() * total[-1])), len(weights) - 1)]


def draw_density(rng: np.random.Generator) -> float:
    """How full a room is: 0 to 1; one in twenty has next to nothing in it."""
    return 0.0 if rng.random() < 0.05 else float(rng.beta(2.2, 1.6))


def edges_by_length(room: Room) -> list[int]:
    """Edges of a room from the longest to the shortest."""
    inner = room.inner
    length = np.linalg.norm(np.roll(inner, -1, axis=0) - inner, axis=1)
    return [int(k) for k in np.argsort(-length, kind="stable")]


def outer_door(room: Room, edge: int, rng: np.random.Generator, width: float = 0.9) -> Way:
    """A closed door on an edge of a room that leads outside."""
    inner = room.inner
    a, b = inner[edge], inner[(edge + 1) % len(inner)]
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    spare = max(length - width - 0.24, 0.0)
    start = 0.5 * (length - width - spare) + spare * float(rng.choice([0.0, 1.0, rng.random()]))
    left = np.array([-along[1], along[0]])
    at = a + start * along
    leaf = rectangle(at + 0.001 * left, along, (width, 0.03))
    solid = prism("door", leaf, room.floor + 0.001, room.floor + 2.05)
    return Way([solid], rectangle(at, along, (width, 0.9)), at + 0.5 * width * along + 0.45 * left)


def of_one(room: Room, solids: list[Solid] | None) -> Building | None:
    """A building of one room."""
    return None if solids is None else Building(solids, [room])


def make_room(rng: np.random.Generator) -> Building | None:
    """A room of a dwelling, from a shoebox to a polygon, from empty to crowded."""
    use, shape = pick(_USES, rng), pick(_SHAPES, rng)
    programme = programmes()[use]
    if shape in ("L", "T", "bay", "polygon") and programme.area[1] < 8.0:
        shape = "box"
    inner = draw_shape(shape, draw_area(programme, rng), programme.narrow, rng)
    outline = cell_of(inner, float(rng.uniform(0.0, 2.0 * np.pi)) if rng.random() < 0.5 else 0.0)
    height = draw_height(rng)
    profile: Profile | None = None
    kind = rng.random()
    if kind < 0.16 and height > 2.6:
        profile = slope(outline, rng, height)
    elif kind < 0.26 and shape == "box" and height > 2.7:
        profile = gable(outline, max(2.3, height - float(rng.uniform(0.4, 1.8))), height)
    finishes = draw_finishes("dwelling", rng)
    if use in _FINISHES:
        finishes = draw_finishes(_FINISHES[use], rng, finishes)
    room = Room(use, outline, 0.0, height, finishes, profile)
    order = edges_by_length(room)
    entrance = outer_door(room, order[int(rng.integers(2))], rng)
    others = [k for k in order if _length(room, k) > 1.1]
    glazed = [k for k in others if rng.random() < 0.45][:3]
    windows = tuple((k, float(rng.uniform(0.25, 0.7))) for k in glazed)
    soft = use in ("living", "bedroom", "study", "dining") and rng.random() < 0.7
    density = 0.0 if use == "empty" else draw_density(rng)
    return of_one(room, fill(room, [entrance], [], Interior(density, windows, soft), rng))


def _length(room: Room, edge: int) -> float:
    inner = room.inner
    return float(np.linalg.norm(inner[(edge + 1) % len(inner)] - inner[edge]))


def make_office(rng: np.random.Generator) -> Building | None:
    """An office for one to four, a meeting room, or an open plan with rows of desks."""
    use = pick({"office": 0.4, "meeting": 0.25, "open-plan": 0.35}, rng)
    programme = programmes()[use]
    floor = draw_area(programme, rng)
    inner = draw_shape(pick({"box": 0.7, "L": 0.12, "skew": 0.18}, rng), floor, programme.narrow, rng)
    outline = cell_of(inner, float(rng.uniform(0.0, 2.0 * np.pi)) if rng.random() < 0.3 else 0.0)
    finishes = draw_finishes("office", rng)
    hung = finishes["ceiling"].split("-", 1)[1] not in ("plaster", "concrete")
    height = float(rng.uniform(2.5, 3.1) if hung else rng.uniform(2.8, 4.0))
    room = Room(use, outline, 0.0, height, finishes)
    order = edges_by_length(room)
    doors = [outer_door(room, order[1], rng)]
    if floor > 100.0:
        doors.append(outer_door(room, order[2], rng, 1.6))
    windows = ((order[0], float(rng.uniform(0.5, 0.85))),)

    def rows(spot: Floor) -> None:
        if use == "open-plan":
            _workstations(spot, order[0], rng)

    soft = rng.random() < 0.4
    before = _columns(room, rng) if floor > 130.0 else []
    interior = Interior(draw_density(rng), windows, soft, rows)
    return of_one(room, fill(room, doors, [], interior, rng, before))


def _columns(room: Room, rng: np.random.Generator) -> list[Solid]:
    """Columns on a lattice of about 7 m, off the walls."""
    inner = room.inner
    along = (inner[1] - inner[0]) / np.linalg.norm(inner[1] - inner[0])
    left = np.array([-along[1], along[0]])
    u, v = (inner - inner[0]) @ along, (inner - inner[0]) @ left
    pitch = float(rng.uniform(6.0, 8.0))
    out = []
    for x in np.arange(u.min() + pitch, u.max() - 2.0, pitch):
        for y in np.arange(v.min() + pitch, v.max() - 2.0, pitch):
            at = inner[0] + x * along + y * left
            reach = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
            ring = at + 0.9 * np.stack([np.cos(reach), np.sin(reach)], axis=1)
            if inside(ring, inner).all():
                out.append(column(at, 0.25, 0.0, room.ceiling - 0.001, "column"))
    return out


def _workstations(spot: Floor, edge: int, rng: np.random.Generator) -> None:
    """Desks back to back in rows at right angles to the windows, screens between them in half of the rooms."""
    inner, piece = spot.inner, furniture()["workstation"]
    a, b = inner[edge], inner[(edge + 1) % len(inner)]
    along = (b - a) / np.linalg.norm(b - a)
    left = np.array([-along[1], along[0]])
    u, v = (inner - a) @ along, (inner - a) @ left
    screens = float(rng.choice([0.0, 1.15, 1.4]))
    full = float(rng.uniform(0.55, 1.0))
    w, d = piece.size
    label = spot.room.finishes["screen"]
    for x in np.arange(u.min() + d + 0.9, u.max() - d - 0.7, 2 * d + 1.15):
        in_row = 0
        for y in np.arange(v.min() + 1.3, v.max() - w - 0.9, w + 0.03):
            in_row = 0 if in_row == 5 else in_row + 1  # a gap to walk through
            if in_row == 0 or rng.random() > full:
                continue
            at = a + x * along + y * left
            # Back to back: one faces +along, its neighbour -along.
            one = spot.put(piece, at + 0.02 * along + w * left, -left, 1.0)
            other = spot.put(piece, at - 0.02 * along, left, 1.0)
            if screens and one and other:
                wall = rectangle(at - 0.015 * along, left, (w, -0.03))[::-1]
                spot.solids.append(prism(label, wall, 0.4, screens))


def make_classroom(rng: np.random.Generator) -> Building | None:
    """A classroom: board and teacher's desk in front, pupils' desks in rows or in groups of four."""
    programme = programmes()["classroom"]
    inner = draw_shape(pick({"box": 0.85, "skew": 0.15}, rng), draw_area(programme, rng), 5.6, rng)
    outline = cell_of(inner, float(rng.uniform(0.0, 2.0 * np.pi)) if rng.random() < 0.3 else 0.0)
    room = Room("classroom", outline, 0.0, float(rng.uniform(2.6, 3.9)), draw_finishes("classroom", rng))
    front = 1 if rng.random() < 0.8 else 3
    door = outer_door(room, 2, rng, float(rng.choice([0.9, 1.0])))
    grouped = rng.random() < 0.4

    def rows(spot: Floor) -> None:
        _pupils(spot, front, grouped, rng)

    windows = ((0, float(rng.uniform(0.5, 0.85))),)
    density = draw_density(rng)
    interior = Interior(density, windows, rng.random() < 0.4, rows)
    return of_one(room, fill(room, [door], [], interior, rng))


def _pupils(spot: Floor, front: int, grouped: bool, rng: np.random.Generator) -> None:
    inner, pieces = spot.inner, furniture()
    a, b = inner[front], inner[(front + 1) % 4]
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    left = np.array([-along[1], along[0]])
    deep = float(((inner - a) @ left).max())
    board = pieces["whiteboard"]
    width = float(rng.uniform(*board.stretch))
    start = 0.5 * (length - width * board.size[0])
    spot.put(board, a + start * along + 0.012 * left, along, width)
    teacher = pieces["desk"]
    # The teacher faces the class, the back of the desk towards it.
    spot.put(teacher, a + (0.3 * length + 0.7) * along + 1.75 * left, -along, 1.0)
    piece = pieces["pupil-desk"]
    w, d = piece.size
    aisle = float(rng.uniform(0.55, 0.8))
    for y in np.arange(2.5, deep - d - 0.4, 2 * d + 0.75 if grouped else d + 0.5):
        for x in np.arange(0.6, length - w - 0.4, w + aisle):
            at = a + x * along + y * left
            if not grouped:
                spot.put(piece, at, along, 1.0)
            elif y + 2 * d < deep - 0.3:
                spot.put(piece, at + d * left + (w * along), -along, 1.0)
                spot.put(piece, at + (d + 0.025) * left, along, 1.0)
