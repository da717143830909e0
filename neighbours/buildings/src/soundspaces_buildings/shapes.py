"""Outlines and ceilings of single rooms: boxes, L and T shapes, bays, skewed and many-sided ones."""

from __future__ import annotations

import numpy as np

from soundspaces_buildings.shell import HALF, Profile
from soundspaces_buildings.solids import area, inset

_STANDING = 2.25  # m, least height under a slope


def draw_shape(kind: str, floor: float, narrow: float, rng: np.random.Generator) -> np.ndarray:
    """(n, 2) inner outline of about `floor` m², no narrower than `narrow` m; edge 0 lies along x."""
    aspect = min(float(rng.uniform(1.0, 1.8)), max(floor / narrow**2, 1.0))
    w, d = (floor * aspect) ** 0.5, (floor / aspect) ** 0.5
    points = {"L": _l_shape, "T": _t_shape, "skew": _skew, "bay": _bay, "polygon": _polygon}.get(
        kind, _box
    )(w, d, narrow, rng)
    return np.asarray(points * (floor / area(points)) ** 0.5)


def _box(w: float, d: float, _: float, __: np.random.Generator) -> np.ndarray:
    return np.array([(0.0, 0.0), (w, 0.0), (w, d), (0.0, d)])


def _l_shape(w: float, d: float, narrow: float, rng: np.random.Generator) -> np.ndarray:
    x = max(w * float(rng.uniform(0.45, 0.65)), min(narrow, 0.8 * w))
    y = max(d * float(rng.uniform(0.45, 0.65)), min(narrow, 0.8 * d))
    return np.array([(0.0, 0.0), (w, 0.0), (w, y), (x, y), (x, d), (0.0, d)])


def _t_shape(w: float, d: float, narrow: float, rng: np.random.Generator) -> np.ndarray:
    y = max(d * float(rng.uniform(0.5, 0.65)), min(narrow, 0.8 * d))
    stem = max(w * float(rng.uniform(0.4, 0.55)), min(narrow, 0.8 * w))
    x = (w - stem) * float(rng.uniform(0.35, 0.65))
    return np.array(
        [(0.0, 0.0), (w, 0.0), (w, y), (x + stem, y), (x + stem, d), (x, d), (x, y), (0.0, y)]
    )


def _skew(w: float, d: float, _: float, rng: np.random.Generator) -> np.ndarray:
    points = _box(w, d, 0.0, rng)
    points[2:] += rng.uniform(-0.13, 0.13, (2, 2)) * (w, d)
    return points


def _bay(w: float, d: float, _: float, rng: np.random.Generator) -> np.ndarray:
    deep = float(rng.uniform(0.5, 0.8))
    wide = min(float(rng.uniform(1.8, 2.6)), w - 1.0)
    x = (w - wide) * float(rng.uniform(0.35, 0.65))
    out = [(x + wide, d), (x + wide - 0.45, d + deep), (x + 0.45, d + deep), (x, d)]
    return np.array([(0.0, 0.0), (w, 0.0), (w, d), *out, (0.0, d)])


def _polygon(w: float, d: float, _: float, rng: np.random.Generator) -> np.ndarray:
    count = int(rng.integers(5, 9))
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count - 0.5 * np.pi - 2.0 * np.pi / count
    points = np.stack([0.5 * w * np.cos(angle), 0.5 * d * np.sin(angle)], axis=1)
    return np.asarray(points - points[0])


def cell_of(inner: np.ndarray, angle: float) -> np.ndarray:
    """The cell of an inner outline, turned by `angle` (radians)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(inset(inner, -HALF) @ np.array([[c, s], [-s, c]]))


def draw_height(rng: np.random.Generator) -> float:
    """m, of a room in a dwelling: 2.3 to 4.5, the high ones in old houses."""
    low, high = ((2.3, 2.7), (2.7, 3.3), (3.3, 4.5))[int(np.searchsorted([0.62, 0.9], rng.random()))]
    return float(rng.uniform(low, high))


def slope(outline: np.ndarray, rng: np.random.Generator, top: float) -> Profile:
    """A ceiling that rises from one edge to `top` m at the far side, 10 to 45 degrees."""
    k = int(rng.integers(len(outline)))
    a, b = outline[k], outline[(k + 1) % len(outline)]
    along = (b - a) / np.linalg.norm(b - a)
    v = (outline - a) @ np.array([-along[1], along[0]])
    far, near = float(v.max()), float(v.min())
    rise = min(float(np.tan(np.deg2rad(rng.uniform(10, 45)))) * (far - near), top - _STANDING)
    return Profile(a, along, np.array([near, far]), np.array([top - rise, top]))


def across_box(outline: np.ndarray, edge: int, z: np.ndarray, at: np.ndarray | None = None) -> Profile:
    """A ceiling over a box with heights `z` (n,) at shares `at` of the way from an edge to the opposite one."""
    a, b = outline[edge], outline[(edge + 1) % 4]
    along = (b - a) / np.linalg.norm(b - a)
    deep = float((outline[(edge + 2) % 4] - a) @ np.array([-along[1], along[0]]))
    share = np.linspace(0.0, 1.0, len(z)) if at is None else at
    return Profile(a, along, deep * share, z)


def gable(outline: np.ndarray, eaves: float, ridge: float, edge: int = 0) -> Profile:
    """A ridge parallel to an edge of a box."""
    return across_box(outline, edge, np.array([eaves, ridge, eaves]))


def vault(outline: np.ndarray, springing: float, crown: float, edge: int = 0) -> Profile:
    """A barrel of eight strips, half an ellipse."""
    angle = np.linspace(np.pi, 0.0, 9)
    z = springing + (crown - springing) * np.sin(angle)
    return across_box(outline, edge, z, 0.5 * (1.0 + np.cos(angle)))
