"""The built-in scene: a furnished apartment of six rooms, about 90 m², made of boxes by code.

Living room, kitchen, hall, bathroom, study and bedroom; open doors, windows, a ceiling at 2.6 m.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from soundspaces_sim.scene.labelled import LabelledMesh, SceneFormat

_WIDTH, _DEPTH, _HEIGHT = 10.8, 8.4, 2.6  # inside, m
_OUTER, _INNER = 0.2, 0.12  # wall thickness, m
_DOOR_HEIGHT = 2.05

_BOX_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_BOX_FACES = np.array([face for a, b, c, d in _SIDES for face in ((a, b, c), (a, c, d))])

Box = tuple[str, float, float, float, float, float, float]  # label, lowest corner, highest corner


def _structure() -> Iterable[Box]:
    w, d, h, o = _WIDTH, _DEPTH, _HEIGHT, _OUTER
    yield "floor", -o, -o, -0.2, w + o, d + o, 0.0
    yield "ceiling", -o, -o, h, w + o, d + o, h + 0.2
    yield "wall", -o, -o, 0, 0, d + o, h
    yield "wall", w, -o, 0, w + o, d + o, h
    yield "wall", 0, -o, 0, w, 0, h
    yield "wall", 0, d, 0, w, d + o, h
    # Partitions: west | east at x = 6.4, living | kitchen at y = 5.2, the hall at y = 4.0 .. 5.3,
    # bathroom | study at x = 8.6. Doors lie on lines of the grids of 1 m and 0.5 m, so that one walks through.
    yield from _partition("x", 6.4, 0.0, d, [(4.25, 5.1)])
    yield from _partition("y", 5.2, 0.0, 6.4, [(3.0, 4.6)])
    yield from _partition("y", 3.88, 6.4 + _INNER, w, [(7.0, 7.85), (9.0, 9.85)])
    yield from _partition("y", 5.3, 6.4 + _INNER, w, [(8.0, 8.9)])
    yield from _partition("x", 8.6, 0.0, 3.88, [])


def _partition(
    axis: str, at: float, start: float, end: float, doors: list[tuple[float, float]]
) -> Iterable[Box]:
    """A wall across `axis` from `start` to `end`, with a lintel over each door."""

    def piece(a: float, b: float, z: float) -> Box:
        if axis == "x":
            return "wall", at, a, z, at + _INNER, b, _HEIGHT
        return "wall", a, at, z, b, at + _INNER, _HEIGHT

    edge = start
    for a, b in doors:
        yield piece(edge, a, 0.0)
        yield piece(a, b, _DOOR_HEIGHT)
        edge = b
    yield piece(edge, end, 0.0)


def _legs(label: str, x: float, y: float, w: float, d: float, top: float, leg: float) -> Iterable[Box]:
    for lx in (x, x + w - leg):
        for ly in (y, y + d - leg):
            yield label, lx, ly, 0.0, lx + leg, ly + leg, top


def _table(label: str, x: float, y: float, w: float, d: float, h: float) -> Iterable[Box]:
    yield label, x, y, h - 0.04, x + w, y + d, h
    yield from _legs(label, x, y, w, d, h - 0.04, 0.06)


def _chair(x: float, y: float, back: str) -> Iterable[Box]:
    """A 0.44 m square chair; `back` is the side of its back: n, s, e or w."""
    s = 0.44
    yield "chair", x, y, 0.42, x + s, y + s, 0.46
    yield from _legs("chair", x, y, s, s, 0.42, 0.04)
    low, high = {
        "n": ((0, s - 0.04), (s, s)),
        "s": ((0, 0), (s, 0.04)),
        "e": ((s - 0.04, 0), (s, s)),
        "w": ((0, 0), (0.04, s)),
    }[back]
    yield "chair", x + low[0], y + low[1], 0.46, x + high[0], y + high[1], 0.9


def _shelf(label: str, x: float, y: float, w: float, d: float, h: float, gap: float) -> Iterable[Box]:
    """Open shelves facing along y: two sides and boards."""
    yield label, x, y, 0.0, x + 0.03, y + d, h
    yield label, x + w - 0.03, y, 0.0, x + w, y + d, h
    for z in np.arange(0.05, h, gap):
        yield label, x + 0.03, y, float(z), x + w - 0.03, y + d, float(z) + 0.03


def _living() -> Iterable[Box]:
    yield "rug", 1.2, 1.0, 0.0, 4.2, 3.2, 0.012
    # sofa: seat, back, two arms
    yield "sofa", 1.5, 0.15, 0.1, 3.7, 1.05, 0.42
    yield "sofa", 1.5, 0.15, 0.42, 3.7, 0.38, 0.85
    yield "sofa", 1.3, 0.15, 0.1, 1.5, 1.05, 0.62
    yield "sofa", 3.7, 0.15, 0.1, 3.9, 1.05, 0.62
    yield "cushion", 1.6, 0.40, 0.43, 2.0, 0.55, 0.8
    yield "cushion", 3.2, 0.40, 0.43, 3.6, 0.55, 0.8
    yield from _table("table", 2.0, 1.7, 1.1, 0.6, 0.42)
    yield "book", 2.3, 1.85, 0.42, 2.5, 2.0, 0.46
    yield "sofa", 5.1, 1.5, 0.1, 5.9, 2.3, 0.42
    yield "sofa", 5.75, 1.5, 0.42, 5.95, 2.3, 0.9
    yield "tv-stand", 1.0, 4.8, 0.0, 2.8, 5.18, 0.45
    yield "tv-screen", 1.25, 4.98, 0.55, 2.55, 5.03, 1.3
    yield from _shelf("shelf", 4.7, 0.05, 1.5, 0.32, 2.0, 0.35)
    for i, z in enumerate((0.43, 0.78, 1.13)):
        yield "book", 4.8, 0.08, z, 5.3 + 0.2 * i, 0.3, z + 0.24
    yield "indoor-plant", 0.2, 4.5, 0.0, 0.5, 4.8, 0.35
    yield "indoor-plant", 0.1, 4.4, 0.5, 0.6, 4.9, 1.2
    yield "lamp", 0.4, 0.4, 0.0, 0.44, 0.44, 1.5
    yield "lamp", 0.25, 0.25, 1.5, 0.6, 0.6, 1.8
    yield "window", 0.0, 1.2, 0.9, 0.02, 3.6, 2.2
    yield "curtain", 0.05, 0.8, 0.05, 0.12, 1.2, 2.4
    yield "curtain", 0.05, 3.6, 0.05, 0.12, 4.0, 2.4
    yield "picture", 6.37, 1.4, 1.3, 6.4, 2.4, 2.0


def _kitchen() -> Iterable[Box]:
    yield "base-cabinet", 0.0, 7.8, 0.0, 2.3, 8.4, 0.86
    yield "countertop", 0.0, 7.76, 0.86, 2.3, 8.4, 0.9
    yield "wall-cabinet", 0.0, 8.05, 1.5, 1.8, 8.4, 2.2
    yield "cooktop", 1.2, 7.85, 0.9, 1.75, 8.3, 0.915
    yield "sink", 0.5, 7.88, 0.9, 1.1, 8.3, 0.92
    yield "microwave", 1.83, 7.95, 0.9, 2.26, 8.3, 1.2
    yield "refrigerator", 2.35, 7.75, 0.0, 3.0, 8.4, 1.8
    yield from _table("table", 4.2, 6.1, 1.5, 0.9, 0.75)
    yield from _chair(4.4, 5.65, "s")
    yield from _chair(5.1, 5.65, "s")
    yield from _chair(4.4, 7.0, "n")
    yield from _chair(5.1, 7.0, "n")
    yield "bowl", 4.8, 6.4, 0.75, 5.05, 6.65, 0.83
    yield "bin", 0.1, 5.45, 0.0, 0.4, 5.75, 0.6
    yield "window", 0.0, 6.0, 1.0, 0.02, 7.4, 2.2


def _east() -> Iterable[Box]:
    # hall
    yield "rug", 7.2, 4.3, 0.0, 9.7, 5.0, 0.012
    yield "cabinet", 9.9, 4.93, 0.0, 10.7, 5.28, 0.85
    yield "mirror", 10.77, 4.2, 0.6, 10.8, 4.7, 1.9
    # bathroom
    yield "bathtub", 6.55, 0.02, 0.0, 8.4, 0.12, 0.55
    yield "bathtub", 6.55, 0.68, 0.0, 8.4, 0.75, 0.55
    yield "bathtub", 6.55, 0.12, 0.0, 6.62, 0.68, 0.55
    yield "bathtub", 8.33, 0.12, 0.0, 8.4, 0.68, 0.55
    yield "toilet", 8.0, 1.6, 0.0, 8.58, 2.0, 0.42
    yield "sink", 6.53, 1.7, 0.75, 6.95, 2.3, 0.88
    yield "mirror", 6.52, 1.7, 1.1, 6.54, 2.3, 1.9
    yield "towel", 6.53, 2.7, 0.9, 6.56, 3.2, 1.6
    # study
    yield from _table("desk", 8.9, 0.2, 1.6, 0.7, 0.74)
    yield from _chair(9.4, 1.0, "n")
    yield "monitor", 9.4, 0.35, 0.85, 10.0, 0.39, 1.25
    yield "computer-keyboard", 9.45, 0.55, 0.74, 9.95, 0.7, 0.765
    yield from _shelf("shelf", 10.15, 3.55, 0.6, 0.3, 1.8, 0.4)
    yield "window", 9.0, 0.0, 1.0, 10.4, 0.02, 2.1
    # bedroom
    yield "bed", 8.6, 6.0, 0.1, 10.7, 7.7, 0.5
    yield "pillow", 10.2, 6.1, 0.5, 10.6, 6.8, 0.62
    yield "pillow", 10.2, 6.9, 0.5, 10.6, 7.6, 0.62
    yield "blanket", 8.6, 6.0, 0.5, 10.0, 7.7, 0.56
    yield "nightstand", 10.3, 5.45, 0.0, 10.75, 5.9, 0.5
    yield "lamp", 10.45, 5.6, 0.5, 10.6, 5.75, 0.85
    yield "wardrobe", 6.55, 7.8, 0.0, 7.9, 8.38, 2.1
    yield "rug", 7.0, 5.8, 0.0, 8.4, 7.4, 0.012
    yield "window", 10.78, 6.2, 0.95, 10.8, 7.8, 2.2
    yield "curtain", 10.68, 5.9, 0.05, 10.74, 6.2, 2.4
    yield "curtain", 10.68, 7.8, 0.05, 10.74, 8.1, 2.4
    # door leaves, open at a right angle
    yield "door", 7.86, 3.03, 0.02, 7.9, 3.86, 2.03
    yield "door", 8.95, 3.03, 0.02, 8.99, 3.86, 2.03
    yield "door", 7.95, 5.44, 0.02, 7.99, 6.32, 2.03
    yield "door", 6.54, 5.1, 0.02, 7.38, 5.14, 2.03


def boxes_mesh(boxes: list[Box], name: str) -> LabelledMesh:
    """Labelled boxes as one mesh: 12 faces each, corners not shared, every box closed."""
    low = np.array([box[1:4] for box in boxes], float)
    high = np.array([box[4:7] for box in boxes], float)
    vertices = low[:, None] + _BOX_CORNERS * (high - low)[:, None]
    faces = _BOX_FACES + 8 * np.arange(len(boxes))[:, None, None]
    names = [box[0] for box in boxes]
    labels = tuple(sorted(set(names)))
    rows = np.array([labels.index(label) for label in names])
    return LabelledMesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), labels, np.repeat(rows, 12), name)


def demo_mesh() -> LabelledMesh:
    """The apartment as a labelled mesh."""
    return boxes_mesh([*_structure(), *_living(), *_kitchen(), *_east()], "demo")


FORMAT = SceneFormat("'demo'", lambda source: source == "demo", lambda _: demo_mesh())
