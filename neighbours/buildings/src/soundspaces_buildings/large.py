"""Large rooms: `hall-<n>`, school and concert halls and gyms, and `church-<n>`."""

from __future__ import annotations

import numpy as np

from soundspaces_buildings.data import draw_finishes
from soundspaces_buildings.furnish import column
from soundspaces_buildings.rooms import Interior, fill, windows_and_curtains
from soundspaces_buildings.shapes import gable, vault
from soundspaces_buildings.shell import HALF, Building, Opening, Profile, Room, shell
from soundspaces_buildings.single import outer_door
from soundspaces_buildings.solids import Solid, box, inset

_RISER = 0.18  # m, at most


def _box_cell(x: float, y: float) -> np.ndarray:
    """The cell whose walls' surfaces are at 0 and at these coordinates."""
    h = HALF
    return np.array([(-h, -h), (x + h, -h), (x + h, y + h), (-h, y + h)])


def _ceiling(
    outline: np.ndarray, height: float, kind: str, rng: np.random.Generator, edge: int
) -> Profile | None:
    """Flat, gable or vault whose highest line is at `height` m."""
    if kind == "flat":
        return None
    drop = min(float(rng.uniform(0.12, 0.3)) * height, height - 3.0)
    return (gable if kind == "gable" else vault)(outline, height - drop, height, edge)


def steps(
    label: str, start: float, y0: float, y1: float, rise: float, going: float, low: float = 0.0
) -> list[Solid]:
    """A straight flight that rises along +x from x = `start` to `low + rise`, as wide as y0 to y1; the last riser
    leads onto the upper floor."""
    count = int(np.ceil(rise / _RISER - 1e-9))
    return [
        box(label, start + k * going, y0, low, start + (k + 1) * going, y1, low + (k + 1) * rise / count)
        for k in range(count - 1)
    ]


def make_hall(rng: np.random.Generator) -> Building | None:
    """A hall of 150 to 900 m² with a stage, rows of seats or a bare floor, and perhaps a gallery with stairs."""
    width = float(rng.uniform(10.0, 22.0))
    length = float(width * rng.uniform(1.2, 1.9))
    height = float(rng.uniform(max(4.5, 0.3 * width), max(6.5, 0.62 * width)))
    finishes = draw_finishes("hall", rng)
    outline = _box_cell(length, width)
    kind = str(rng.choice(["flat", "flat", "gable", "vault"]))
    profile = _ceiling(outline, height, kind, rng, 0)
    room = Room("empty", outline, 0.0, height, finishes, profile)
    eaves = float(room.height_at(room.inner).min())
    stage = float(rng.uniform(3.5, 7.0)) if rng.random() < 0.75 else 0.0
    before: list[Solid] = []
    if stage:
        before += _stage(length, width, stage, eaves, finishes["curtain"], rng)
    gallery = float(rng.uniform(2.5, 4.0)) if rng.random() < 0.4 and eaves > 6.0 else 0.0
    if gallery:
        before += _gallery(gallery, width, finishes["wall"])
    if rng.random() < 0.75:
        before += _seats(gallery, length - stage, width, finishes["seat"], rng)
    if rng.random() < 0.6:
        before += _panels(gallery, length, width, eaves, rng)
    doors = [
        outer_door(room, 3, rng, 1.7) if not gallery else outer_door(room, 0, rng, 1.7),
        outer_door(room, 0, rng, 1.7),
    ]
    if any(_clash(door.clear, s) for door in doors for s in before):
        return None
    if any(_clash(doors[1].clear, s) for s in doors[0].solids):
        return None
    share = float(rng.uniform(0.3, 0.7)) if rng.random() < 0.7 else 0.0
    high = _high_windows(room, 2, share, eaves) if share else []
    filled = fill(room, doors, [], Interior(0.0), rng, before)
    return None if filled is None else Building([*filled, *high], [room])


def _clash(area: np.ndarray, solid: Solid) -> bool:
    low, high = area.min(axis=0) + 0.01, area.max(axis=0) - 0.01
    reach = solid.low.min() < 2.0 and solid.high.max() > 0.1
    return bool(
        reach and (solid.outline.min(axis=0) < high).all() and (solid.outline.max(axis=0) > low).all()
    )


def _stage(
    length: float, width: float, deep: float, eaves: float, curtain: str, rng: np.random.Generator
) -> list[Solid]:
    """A stage at the far end, with steps on both sides and often a curtain at its back."""
    tall = float(rng.uniform(0.6, 1.1))
    count = int(np.ceil(tall / _RISER - 1e-9))
    out = [box("stage", length - deep, 0.001, 0.0, length - 0.001, width - 0.001, tall)]
    for y0 in (1.3, width - 2.5):
        for k in range(count - 1):
            x1 = length - deep - 0.001
            top = (count - 1 - k) * tall / count
            out.append(box("stair", x1 - (k + 1) * 0.28, y0, 0.0, x1 - k * 0.28, y0 + 1.2, top))
    if rng.random() < 0.7:
        top = min(eaves - 0.3, tall + 5.0)
        out.append(box(curtain, length - 0.25, 0.6, tall + 0.05, length - 0.15, width - 0.6, top))
    if rng.random() < 0.4:
        out.append(
            box(
                "piano",
                length - 0.7 * deep,
                0.3 * width,
                tall,
                length - 0.7 * deep + 1.5,
                0.3 * width + 1.6,
                tall + 1.0,
            )
        )
    return out


def _gallery(deep: float, width: float, parapet: str) -> list[Solid]:
    """A gallery at the near end on columns, with a flight of stairs along a side wall."""
    floor, going = 3.06, 0.27
    flight = 16 * going
    out = [
        box("gallery", 0.001, 0.001, floor - 0.25, deep, width - 0.001, floor),
        box(parapet, deep - 0.12, 0.001, floor, deep, width - 1.4, floor + 0.95),
    ]
    for step in steps("stair", 0.0, width - 1.3, width - 0.1, floor, going):
        # The flight rises towards the gallery: mirrored along x.
        x0, x1 = step.outline[:, 0].min(), step.outline[:, 0].max()
        top = float(step.high.max())
        out.append(
            box("stair", deep + flight - x1, width - 1.3, 0.0, deep + flight - x0, width - 0.1, top)
        )
    posts = np.linspace(2.0, width - 2.5, max(2, round(width / 5.0)))
    out += [column(np.array([deep - 0.3, y]), 0.15, 0.0, floor - 0.25, "column") for y in posts]
    return out


def _seats(
    gallery: float, end: float, width: float, label: str, rng: np.random.Generator
) -> list[Solid]:
    """Rows of seats, aisles in the middle and at the sides, clear of stairs and of the stage."""
    first = max(gallery + 1.2, 3.0)
    side = 2.9 if gallery else 1.6
    middle = 0.5 * width
    pitch = float(rng.uniform(0.9, 1.05))
    out = []
    for x in np.arange(first, end - 3.6, pitch):
        for y0, y1 in ((side, middle - 0.7), (middle + 0.7, width - side)):
            out.append(box(label, x + 0.1, y0, 0.0, x + 0.55, y1, 0.44))
            out.append(box(label, x, y0, 0.0, x + 0.099, y1, 0.85))
    return out


def _panels(
    gallery: float, length: float, width: float, eaves: float, rng: np.random.Generator
) -> list[Solid]:
    """Sound absorbers, or panelling, high on the side walls, clear of a gallery."""
    label = str(rng.choice(["acoustic-panel", "wall-wood-panel", "wall-acoustic-plaster"]))
    high = min(eaves - 0.4, 4.5)
    out = []
    for x in np.arange(gallery + 1.2, length - 2.2, 2.4):
        for y0, y1 in ((0.001, 0.06), (width - 0.06, width - 0.001)):
            if high > 2.9:
                out.append(box(label, x, y0, 2.4, x + 1.5, y1, high))
    return out


def _high_windows(room: Room, edge: int, share: float, eaves: float) -> list[Solid]:
    """Panes above head height along an edge."""
    inner = room.inner
    a, b = inner[edge], inner[(edge + 1) % len(inner)]
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    count = max(2, round(length / 4.5))
    width = share * length / count
    head = min(eaves - 0.35, 0.85 * eaves)
    sill = max(0.45 * head, 2.0)
    out: list[Solid] = []
    if head < sill + 0.5 or width < 0.4:
        return out
    left = np.array([-along[1], along[0]])
    for k in range(count):
        start = a + along * (length * (k + 0.5) / count - 0.5 * width) + 0.061 * left
        out += windows_and_curtains(room, start, start + along * width, sill, head, 0.0)[0]
    return out


def make_church(rng: np.random.Generator) -> Building | None:
    """A nave with pews and perhaps rows of columns, a chancel with an altar behind an arch, a west gallery."""
    width = float(rng.uniform(7.5, 18.0))
    length = float(width * rng.uniform(1.5, 2.6))
    height = float(np.clip(width * rng.uniform(0.6, 1.15), 5.5, 18.0))
    finishes = draw_finishes("church", rng)
    outline = _box_cell(length, width)
    profile = _ceiling(outline, height, str(rng.choice(["gable", "vault", "vault", "flat"])), rng, 0)
    nave = Room("empty", outline, 0.0, height, finishes, profile)
    eaves = float(nave.height_at(nave.inner).min())
    chancel, arch = _chancel(length, width, eaves, finishes, rng)
    before: list[Solid] = []
    aisled = width > 11.5 and rng.random() < 0.75
    if aisled:
        before += _rows_of_columns(nave, length, width, rng)
    before += _pews(length, width, aisled, finishes["pew"], rng)
    if rng.random() < 0.5 and eaves > 5.5:
        deep = float(rng.uniform(2.2, 3.0))
        before.append(box("gallery", 0.001, 0.001, 2.9, deep, width - 0.001, 3.15))
        before.append(box("gallery", deep - 0.1, 0.001, 3.15, deep, width - 0.001, 4.1))
        before.append(box("organ", 0.3, 0.3 * width, 3.15, 1.5, 0.7 * width, eaves - 0.4))
    if rng.random() < 0.7:
        before.append(box("pulpit", length - 1.6, 0.9, 0.0, length - 0.6, 1.9, 1.6))
    door = outer_door(nave, 3, rng, 1.8)
    filled = fill(nave, [door], [arch], Interior(0.0), rng, before)
    if filled is None:
        return None
    share = float(rng.uniform(0.25, 0.5))
    altar = _altar(length, width)
    windows = [w for edge in (0, 2) for w in _high_windows(nave, edge, share, eaves)]
    return Building([*filled, *shell(chancel, [arch]), *altar, *windows], [nave, chancel])


def _rows_of_columns(nave: Room, length: float, width: float, rng: np.random.Generator) -> list[Solid]:
    """Two rows that part aisles from the nave, up to the ceiling."""
    label = nave.finishes["wall"].replace("wall", "column")
    radius = float(rng.uniform(0.25, 0.45))
    out = []
    for y in (0.24 * width, 0.76 * width):
        top = float(nave.height_at(np.array([[0.0, y]]))[0]) - 0.02
        out += [
            column(np.array([x, y]), radius, 0.0, top, label) for x in np.arange(4.0, length - 2.5, 4.5)
        ]
    return out


def _chancel(
    length: float, width: float, eaves: float, finishes: dict[str, str], rng: np.random.Generator
) -> tuple[Room, Opening]:
    """A narrower room beyond the nave, square or with an apse of five sides, and the arch between."""
    wide = float(rng.uniform(0.5, 0.7)) * width
    y0, y1 = 0.5 * (width - wide), 0.5 * (width + wide)
    deep = float(rng.uniform(0.6, 1.0)) * wide
    x0 = length + 2 * HALF
    inner = np.array([(x0, y0), (x0 + deep, y0), (x0 + deep, y1), (x0, y1)])
    if rng.random() < 0.6:
        bow = 0.3 * wide
        apse = [(x0 + deep + bow, y0 + 0.3 * wide), (x0 + deep + bow, y1 - 0.3 * wide)]
        inner = np.array([(x0, y0), (x0 + deep, y0), *apse, (x0 + deep, y1), (x0, y1)])
    tall = float(rng.uniform(0.8, 1.0)) * eaves
    room = Room("empty", inset(inner, -HALF), 0.0, tall, finishes)
    x = length + HALF
    stub = 0.25
    ends = np.array([x, y0 + stub]), np.array([x, y1 - stub])
    return room, Opening(*ends, 0.0, min(tall, eaves) - 0.5)


def _pews(
    length: float, width: float, aisled: bool, label: str, rng: np.random.Generator
) -> list[Solid]:
    """Pews on both sides of the middle aisle, between the columns if there are any."""
    side = 0.24 * width + 0.7 if aisled else 1.1
    middle = 0.5 * width
    pitch = float(rng.uniform(0.9, 1.05))
    out = []
    for x in np.arange(3.6, length - 3.5, pitch):
        for y0, y1 in ((side, middle - 0.75), (middle + 0.75, width - side)):
            out.append(box(label, x + 0.05, y0, 0.0, x + 0.45, y1, 0.45))
            out.append(box(label, x, y0, 0.0, x + 0.049, y1, 0.9))
    return out


def _altar(length: float, width: float) -> list[Solid]:
    x, y = length + 0.14 + 1.6, 0.5 * width
    return [
        box("altar", x, y - 0.9, 0.0, x + 0.8, y + 0.9, 0.95),
        box("stone", x - 0.6, y - 1.4, 0.0, x + 1.3, y + 1.4, 0.16),
    ]
