"""Pieces of furniture of whole cells, each a few boxes.

Conventions: a piece stands with its back to a wall. In its own frame x runs along the wall and y away from
it, m; the wall's surface is at y = 0.05. Boxes: (label, x0, y0, z0, x1, y1, z1). Nothing leaves the cells
that the piece fills, whatever has a flat top below 1.5 m is too high to step on, and cupboards have a board
inside, so that nobody stands in them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from soundspaces_sim.parts import Box

_B = 0.06  # m, where backs begin: just off the wall


def _table(label: str, x: float, y: float, w: float, d: float, h: float) -> Iterator[Box]:
    yield label, x, y, h - 0.04, x + w, y + d, h
    for lx in (x, x + w - 0.06):
        for ly in (y, y + d - 0.06):
            yield label, lx, ly, 0.0, lx + 0.06, ly + 0.06, h - 0.04


def _chair(x: float, y: float, back: str) -> Iterator[Box]:
    """0.44 m square; `back`: n, s, e or w in the piece's frame."""
    s, t = 0.44, 0.04
    yield "chair", x, y, 0.42, x + s, y + s, 0.46
    for lx in (x, x + s - t):
        for ly in (y, y + s - t):
            yield "chair", lx, ly, 0.0, lx + t, ly + t, 0.42
    x0, x1 = (x, x + t) if back == "w" else (x + s - t, x + s) if back == "e" else (x, x + s)
    y0, y1 = (y, y + t) if back == "s" else (y + s - t, y + s) if back == "n" else (y, y + s)
    yield "chair", x0, y0, 0.46, x1, y1, 0.9


def double_bed(rng: np.random.Generator) -> Iterator[Box]:
    w = 1.5
    yield "bed", 0.06, _B, 0.0, 0.06 + w, 0.11, 0.95
    yield "bed", 0.06, 0.11, 0.1, 0.06 + w, 1.98, 0.48
    for x in (0.14, 0.86):
        yield "pillow", x, 0.15, 0.48, x + 0.62, 0.55, 0.6
    yield "blanket", 0.06, 0.7, 0.48, 0.06 + w, 1.98, 0.54
    yield "nightstand", 1.6, _B, 0.0, 1.96, 0.42, 0.5
    yield "lamp", 1.71, 0.16, 0.5, 1.85, 0.3, 0.85
    if rng.random() < 0.5:
        yield "chest-of-drawers", 1.62, 1.1, 0.0, 1.98, 1.9, 0.8


def single_bed(_: np.random.Generator) -> Iterator[Box]:
    yield "bed", 0.06, _B, 0.0, 0.94, 0.11, 0.85
    yield "bed", 0.06, 0.11, 0.1, 0.94, 1.98, 0.46
    yield "pillow", 0.16, 0.15, 0.46, 0.84, 0.5, 0.57
    yield "blanket", 0.06, 0.65, 0.46, 0.94, 1.98, 0.52


def wardrobe(rng: np.random.Generator) -> Iterator[Box]:
    yield "wardrobe", 0.08, _B, 0.0, 0.92, 0.66, 1.05
    yield "wardrobe", 0.08, _B, 1.05, 0.92, 0.66, 2.1
    if rng.random() < 0.5:
        yield "box", 0.2, 0.12, 2.1, 0.7, 0.55, 2.35


def wide_wardrobe(_: np.random.Generator) -> Iterator[Box]:
    for x0, x1 in ((0.1, 1.0), (1.0, 1.9)):
        yield "wardrobe", x0, _B, 0.0, x1, 0.68, 1.1
        yield "wardrobe", x0, _B, 1.1, x1, 0.68, 2.2


def chest(_: np.random.Generator) -> Iterator[Box]:
    yield "chest-of-drawers", 0.06, _B, 0.0, 0.94, 0.56, 0.85
    yield "basket", 0.3, 0.15, 0.85, 0.65, 0.4, 1.0


def _seat(x: float, w: float) -> Iterator[Box]:
    yield "sofa", x, _B, 0.08, x + w, 0.92, 0.42
    yield "sofa", x, _B, 0.42, x + w, 0.3, 0.85
    for side in (x - 0.16, x + w):
        yield "sofa", side, _B, 0.08, side + 0.16, 0.92, 0.62


def sofa(rng: np.random.Generator) -> Iterator[Box]:
    yield from _seat(0.22, 1.56)
    for x in (0.3, 1.3):
        if rng.random() < 0.8:
            yield "cushion", x, 0.31, 0.43, x + 0.4, 0.45, 0.8


def long_sofa(rng: np.random.Generator) -> Iterator[Box]:
    yield from _seat(0.28, 2.44)
    for x in (0.4, 1.3, 2.2):
        if rng.random() < 0.8:
            yield "cushion", x, 0.31, 0.43, x + 0.4, 0.45, 0.8


def armchair(_: np.random.Generator) -> Iterator[Box]:
    yield from _seat(0.24, 0.52)


def dining_table(_: np.random.Generator) -> Iterator[Box]:
    yield from _table("table", 0.36, 0.6, 1.28, 0.8, 0.75)
    for x in (0.45, 1.11):
        yield from _chair(x, 0.3, "s")
        yield from _chair(x, 1.26, "n")
    yield "bowl", 0.88, 0.88, 0.75, 1.12, 1.12, 0.83


def wall_table(_: np.random.Generator) -> Iterator[Box]:
    yield from _table("table", 0.35, _B, 1.3, 0.52, 0.75)
    for x in (0.48, 1.08):
        yield from _chair(x, 0.5, "n")
    yield "plate", 0.6, 0.2, 0.75, 0.82, 0.42, 0.77


def plant(_: np.random.Generator) -> Iterator[Box]:
    yield "indoor-plant", 0.32, 0.32, 0.0, 0.68, 0.68, 0.38
    yield "indoor-plant", 0.46, 0.46, 0.38, 0.54, 0.54, 0.7
    yield "indoor-plant", 0.2, 0.2, 0.7, 0.8, 0.8, 1.35


def floor_lamp(_: np.random.Generator) -> Iterator[Box]:
    yield from _table("table", 0.25, 0.25, 0.5, 0.5, 0.5)
    yield "lamp", 0.42, 0.42, 0.5, 0.58, 0.58, 0.95


def desk(_: np.random.Generator) -> Iterator[Box]:
    yield from _table("desk", 0.2, _B, 1.6, 0.5, 0.74)
    yield "monitor", 0.7, 0.14, 0.84, 1.3, 0.18, 1.22
    yield "computer-keyboard", 0.78, 0.33, 0.74, 1.22, 0.48, 0.765
    yield from _chair(0.78, 0.53, "n")


def small_desk(_: np.random.Generator) -> Iterator[Box]:
    yield from _table("desk", 0.06, _B, 0.88, 0.48, 0.74)
    yield "laptop", 0.32, 0.15, 0.74, 0.66, 0.38, 0.77
    yield from _chair(0.28, 0.52, "n")


def shelving(_: np.random.Generator) -> Iterator[Box]:
    for x in (0.06, 0.91):
        yield "shelving", x, _B, 0.0, x + 0.03, 0.62, 2.0
    for z in (0.1, 0.6, 1.1, 1.6):
        yield "shelving", 0.09, _B, z, 0.91, 0.62, z + 0.03
    yield "box", 0.2, 0.1, 0.13, 0.7, 0.5, 0.45
    yield "box", 0.3, 0.12, 0.63, 0.8, 0.55, 0.9


def bathtub(_: np.random.Generator) -> Iterator[Box]:
    x0, x1, y0, y1 = 0.12, 1.88, _B, 0.8
    yield "bathtub", x0, y0, 0.0, x1, y1, 0.28
    yield "bathtub", x0, y0, 0.28, x1, y0 + 0.07, 0.56
    yield "bathtub", x0, y1 - 0.07, 0.28, x1, y1, 0.56
    yield "bathtub", x0, y0 + 0.07, 0.28, x0 + 0.07, y1 - 0.07, 0.56
    yield "bathtub", x1 - 0.07, y0 + 0.07, 0.28, x1, y1 - 0.07, 0.56


def shower(_: np.random.Generator) -> Iterator[Box]:
    yield "shower", 0.08, _B, 0.0, 0.92, 0.92, 0.22
    yield "shower-stall", 0.08, 0.9, 0.22, 0.92, 0.92, 1.95
    yield "shower-stall", 0.08, _B, 0.22, 0.1, 0.9, 1.95


def toilet(_: np.random.Generator) -> Iterator[Box]:
    yield "toilet", 0.3, 0.24, 0.0, 0.7, 0.74, 0.42
    yield "toilet", 0.28, _B, 0.0, 0.72, 0.24, 0.82


def washer(_: np.random.Generator) -> Iterator[Box]:
    yield "major-appliance", 0.2, 0.1, 0.0, 0.8, 0.7, 0.86
    yield "basket", 0.3, 0.2, 0.86, 0.7, 0.6, 1.08


def kitchen_run(cells: int) -> Callable[[np.random.Generator], Iterator[Box]]:
    """Cabinets over `cells` cells with sink and cooktop, a refrigerator at one end."""

    def boxes(rng: np.random.Generator) -> Iterator[Box]:
        end = cells - 0.72
        yield "base-cabinet", 0.06, _B, 0.0, end, 0.64, 0.86
        yield "countertop", 0.06, _B, 0.86, end, 0.67, 0.9
        yield "wall-cabinet", 0.06, _B, 1.5, end, 0.4, 2.2
        yield "sink", 0.2, 0.14, 0.9, 0.68, 0.56, 0.92
        if cells > 1:
            yield "cooktop", end - 0.55, 0.12, 0.9, end - 0.05, 0.6, 0.915
        if cells > 2 and rng.random() < 0.7:
            yield "microwave", 0.85, 0.12, 0.9, 1.3, 0.45, 1.2
        for z0, z1 in ((0.0, 0.7), (0.7, 1.8)):
            yield "refrigerator", cells - 0.68, _B, z0, cells - 0.06, 0.68, z1

    return boxes


# Pieces that stand in front of a wall and leave the way past them free: at most 0.3 m deep.


def bookcase(_: np.random.Generator) -> Iterator[Box]:
    for x in (0.08, 0.89):
        yield "shelf", x, _B, 0.0, x + 0.03, 0.3, 1.9
    for i, z in enumerate((0.05, 0.42, 0.79, 1.16, 1.53)):
        yield "shelf", 0.11, _B, z, 0.89, 0.3, z + 0.03
        yield "book", 0.14, 0.08, z + 0.03, 0.4 + 0.1 * (i % 4), 0.27, z + 0.29


def tv(_: np.random.Generator) -> Iterator[Box]:
    yield "tv-stand", 0.02, _B, 0.0, 0.98, 0.3, 0.42
    yield "tv-screen", 0.03, 0.12, 0.5, 0.97, 0.16, 1.05


def basin(_: np.random.Generator) -> Iterator[Box]:
    yield "sink", 0.25, _B, 0.7, 0.75, 0.32, 0.86
    yield "mirror", 0.25, 0.051, 1.1, 0.75, 0.07, 1.85


def sideboard(_: np.random.Generator) -> Iterator[Box]:
    yield "cabinet", 0.08, _B, 0.0, 0.92, 0.26, 0.82
    yield "picture", 0.25, 0.051, 1.2, 0.75, 0.07, 1.75


def wall_picture(_: np.random.Generator) -> Iterator[Box]:
    yield "picture", 0.15, 0.051, 1.2, 0.85, 0.075, 1.8


def wall_mirror(_: np.random.Generator) -> Iterator[Box]:
    yield "mirror", 0.3, 0.051, 0.4, 0.7, 0.07, 1.9


def towels(_: np.random.Generator) -> Iterator[Box]:
    yield "towel", 0.3, 0.06, 0.9, 0.7, 0.1, 1.6


def coats(_: np.random.Generator) -> Iterator[Box]:
    yield "rack", 0.15, 0.051, 1.65, 0.85, 0.08, 1.75
    yield "clothes", 0.25, 0.08, 0.85, 0.75, 0.2, 1.65


@dataclass(frozen=True)
class Piece:
    """`width` cells along the wall and `depth` cells away from it; 0 deep: the cell stays free."""

    width: int
    depth: int
    boxes: Callable[[np.random.Generator], Iterator[Box]]
    tall: bool = False  # no window behind it
    flat: bool = False  # mounted on the wall, in nobody's way


#: Per kind of room, in order of need; a tuple: the first that fits.
FURNITURE: dict[str, tuple[tuple[Piece, ...], ...]] = {
    "bedroom": (
        (Piece(2, 2, double_bed), Piece(1, 2, single_bed)),
        (Piece(2, 1, wide_wardrobe, True), Piece(1, 1, wardrobe, True)),
        (Piece(1, 1, small_desk),),
        (Piece(1, 1, chest),),
    ),
    "living": (
        (Piece(3, 1, long_sofa), Piece(2, 1, sofa)),
        (Piece(2, 2, dining_table), Piece(2, 1, wall_table)),
        (Piece(1, 1, armchair),),
        (Piece(1, 1, plant),),
        (Piece(1, 1, floor_lamp),),
        (Piece(2, 1, desk),),
        (Piece(1, 1, plant),),
    ),
    "kitchen": (
        (
            Piece(4, 1, kitchen_run(4), True),
            Piece(3, 1, kitchen_run(3), True),
            Piece(2, 1, kitchen_run(2), True),
        ),
        (Piece(2, 1, wall_table),),
        (Piece(1, 1, plant),),
    ),
    "bathroom": (
        (Piece(1, 1, toilet),),
        (Piece(2, 1, bathtub), Piece(1, 1, shower, True)),
        (Piece(1, 1, washer),),
    ),
    "toilet": ((Piece(1, 1, toilet),),),
    "study": (
        (Piece(2, 1, desk), Piece(1, 1, small_desk)),
        (Piece(2, 1, sofa), Piece(1, 1, armchair)),
        (Piece(1, 1, plant),),
    ),
    "storage": ((Piece(1, 1, shelving, True),), (Piece(1, 1, washer),)),
    "hall": (),
}

#: The same for what leaves its cell free.
SHALLOW: dict[str, tuple[Piece, ...]] = {
    "bedroom": (Piece(1, 0, wall_mirror, True, True), Piece(1, 0, wall_picture, True, True)),
    "living": (
        Piece(1, 0, tv),
        Piece(1, 0, bookcase, True),
        Piece(1, 0, wall_picture, True, True),
        Piece(1, 0, bookcase, True),
    ),
    "kitchen": (Piece(1, 0, wall_picture, True, True),),
    "bathroom": (Piece(1, 0, basin, True), Piece(1, 0, towels, True, True)),
    "toilet": (Piece(1, 0, basin, True),),
    "study": (Piece(1, 0, bookcase, True), Piece(1, 0, wall_picture, True, True)),
    "storage": (),
    "hall": (
        Piece(1, 0, coats, True),
        Piece(1, 0, sideboard, True),
        Piece(1, 0, wall_mirror, True, True),
        Piece(1, 0, wall_picture, True, True),
    ),
}
