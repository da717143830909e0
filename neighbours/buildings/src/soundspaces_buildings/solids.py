"""Closed solids that stand upright on a polygon, and their mesh.

Conventions: metres, Z up, outlines anticlockwise seen from above. Coordinates are rounded to 0.1 mm, so that a
mesh does not depend on the last digits of sines.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.parts import LabelledMesh

_DIGITS = 4  # of metres
_FLAT = 1e-9  # m², of a corner that is none


@dataclass(frozen=True)
class Solid:
    """A solid on `outline` (n, 2) between heights `low` and `high` (n,) of its corners; both are planes."""

    label: str
    outline: np.ndarray
    low: np.ndarray
    high: np.ndarray


def prism(label: str, outline: ArrayLike, low: ArrayLike, high: ArrayLike) -> Solid:
    """A solid on a simple polygon (n, 2); heights are numbers or one for each corner."""
    points = np.asarray(outline, float)
    if area(points) < 0.0:
        raise ValueError(f"{label}: the outline runs clockwise")
    heights = (np.broadcast_to(np.asarray(h, float), len(points)).copy() for h in (low, high))
    return Solid(label, points, *heights)


def box(label: str, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> Solid:
    """A box between two corners."""
    return prism(label, [(x0, y0), (x1, y0), (x1, y1), (x0, y1)], z0, z1)


def turned(points: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Points (…, 2) with their x axis along the unit vector `along`."""
    return np.asarray(points @ np.array([along, (-along[1], along[0])]))


def moved(solid: Solid, at: np.ndarray, along: np.ndarray, floor: float = 0.0) -> Solid:
    """The solid with its origin at `at` (2,), its x axis along the unit vector `along`, and lifted by `floor`."""
    return Solid(solid.label, turned(solid.outline, along) + at, solid.low + floor, solid.high + floor)


def area(outline: np.ndarray) -> float:
    """Of a simple polygon, m²; negative if it runs clockwise."""
    x, y = outline.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def triangles(outline: np.ndarray) -> list[tuple[int, int, int]]:
    """A simple polygon as triangles of its corners, by cutting off ears (Meisters 1975)."""
    left, out = list(range(len(outline))), []
    while len(left) > 3:
        for k in range(len(left)):
            a, b, c = left[k - 1], left[k], left[(k + 1) % len(left)]
            corner = outline[[a, b, c]]
            if area(corner) <= _FLAT:
                continue
            others = outline[[i for i in left if i not in (a, b, c)]]
            if not _inside_triangle(corner, others).any():
                out.append((a, b, c))
                left.pop(k)
                break
        else:
            raise ValueError("the outline crosses itself")
    return [*out, (left[0], left[1], left[2])]


def _inside_triangle(corner: np.ndarray, points: np.ndarray) -> np.ndarray:
    inside = np.ones(len(points), bool)
    for k in range(3):
        a, b = corner[k], corner[(k + 1) % 3]
        inside &= cross(b - a, points - a) >= -_FLAT
    return inside


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of vectors in the plane, (…, 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def inset(outline: np.ndarray, width: float) -> np.ndarray:
    """The corners of a polygon whose edges lie `width` m further inside."""
    edge = np.roll(outline, -1, axis=0) - outline
    edge /= np.linalg.norm(edge, axis=1)[:, None]
    normal = np.stack([-edge[:, 1], edge[:, 0]], axis=1)
    before = np.roll(normal, 1, axis=0)
    # Where the two lines meet, along the sum of their normals.
    return np.asarray(
        outline + width * (normal + before) / (1.0 + (normal * before).sum(axis=1))[:, None]
    )


def clip(outline: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """The part of a convex polygon where normal · x >= offset; (0, 2) where there is none."""
    side = outline @ normal - offset
    out: list[np.ndarray] = []
    for k in range(len(outline)):
        j = (k + 1) % len(outline)
        if side[k] >= -1e-9:
            out.append(outline[k])
        if side[k] * side[j] < -1e-18 and min(abs(side[k]), abs(side[j])) > 1e-9:
            out.append(outline[k] + (outline[j] - outline[k]) * side[k] / (side[k] - side[j]))
    return np.array(out).reshape(-1, 2)


def solids_mesh(solids: Iterable[Solid], name: str) -> LabelledMesh:
    """Labelled solids as one mesh: corners are not shared between solids, every solid is closed."""
    kept: Sequence[Solid] = list(solids)
    labels = tuple(sorted({solid.label for solid in kept}))
    vertices, faces, rows, first = [], [], [], 0
    for solid in kept:
        n = len(solid.outline)
        caps = np.array(triangles(solid.outline))
        k = np.arange(n)
        j = (k + 1) % n
        vertices += [np.column_stack([solid.outline, z]) for z in (solid.low, solid.high)]
        faces += [
            first + caps[:, ::-1],
            first + n + caps,
            first + np.stack([k, j, n + j], axis=1),
            first + np.stack([k, n + j, n + k], axis=1),
        ]
        rows += [labels.index(solid.label)] * (2 * len(caps) + 2 * n)
        first += 2 * n
    points = np.round(np.concatenate(vertices), _DIGITS) + 0.0
    return LabelledMesh(points, np.concatenate(faces), labels, np.array(rows), name)
