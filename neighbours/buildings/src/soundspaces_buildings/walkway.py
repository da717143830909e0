"""Where one can walk in a room: the clearance, the distance to the next wall or piece, decides.

Whoever is 0.4 m wide gets from every door to every other, and there is no gap in which somebody could stand who
cannot get there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy

_CELL = 0.05  # m
#: Half the width of who gets through every room, and to every place, m.
_WIDE, _SLIM = 0.2, 0.15
#: Half the width of who must not get stuck, as a navigation graph's cells may tell it, and how far from such a
#: way one is not stuck, m.
_NARROW, _BESIDE = 0.08, 0.15
_FINE = np.stack(np.meshgrid(*2 * [np.linspace(-1 / 3, 1 / 3, 3)], indexing="ij"), axis=-1).reshape(
    -1, 2
)
_CORNER = 0.05  # sine of half the angle of the sharpest corner out of which one walks
_PACE = 0.01  # m, of a step out of it
_FAR = 0.5  # m from a piece, from where on its distance decides nothing
_EIGHT = np.ones((3, 3))  # neighbours of a cell


def inside(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """(n,) whether points (n, 2) lie in a simple polygon, by crossings."""
    a, b = outline, np.roll(outline, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    above = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return np.asarray((above & (x < at)).sum(axis=1) % 2 == 1)


def _clearance(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """(n,) distance from points (n, 2) to a polygon's sides, m; negative outside of it."""
    edge = np.roll(outline, -1, axis=0) - outline
    out = np.full(len(points), np.inf)
    for a, along in zip(outline, edge, strict=True):
        offset = points - a
        share = np.clip(offset @ along / (along @ along), 0.0, 1.0)
        np.minimum(out, np.hypot(*(offset - share[:, None] * along).T), out=out)
    return np.where(inside(points, outline), out, -out)


def _nearest(points: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """(n, m, 2) offsets of points (n, 2) from the nearest points of sides (m, 2, 2)."""
    along = sides[:, 1] - sides[:, 0]
    offset = points[:, None] - sides[:, 0]
    share = np.clip((offset * along).sum(axis=2) / (along * along).sum(axis=1), 0.0, 1.0)
    return np.asarray(offset - share[:, :, None] * along)


def _uphill(point: np.ndarray, sides: np.ndarray) -> tuple[np.ndarray, float]:
    """Unit vector along which the clearance between sides (m, 2, 2) grows, and how fast: between two of them the
    bisector, and the sine of half the angle."""
    offset = _nearest(point[None], sides)[0]
    distance = np.linalg.norm(offset, axis=1)
    order = np.argsort(distance, kind="stable")
    near = order[distance[order] < distance[order[0]] + _PACE]
    away = offset[near] / distance[near, None]
    along = away[0]
    both = along + away[int((away @ along).argmin())]
    along = both / max(float(np.linalg.norm(both)), 1e-9)
    return along, float((away @ along).min())


class Walkway:
    """The floor between walls, `inner` (n, 2), and what stands there; `ways` (n, 2): places that stay connected."""

    def __init__(self, inner: np.ndarray, ways: Sequence[np.ndarray]) -> None:
        self.inner, self.ways = inner, list(ways)
        self.blocked: list[np.ndarray] = []  # polygons
        low, high = inner.min(axis=0) - _CELL, inner.max(axis=0) + _CELL
        self._low = low
        n = np.ceil((high - low) / _CELL).astype(int)
        x, y = np.meshgrid(*(low[i] + _CELL * (np.arange(n[i]) + 0.5) for i in (0, 1)), indexing="ij")
        centres = np.stack([x.ravel(), y.ravel()], axis=1)
        self._clear = _clearance(centres, inner).reshape(x.shape)

    def narrow(self, outlines: Sequence[np.ndarray]) -> None:
        """Let nobody walk in polygons."""
        self.blocked += outlines
        for outline in outlines:
            self._lower(self._clear, outline)

    def is_open_with(self, outlines: Sequence[np.ndarray] = ()) -> bool:
        """Whether, with polygons in the way too, all ways stay connected, and no place cannot be reached."""
        clear = self._clear.copy()
        for outline in outlines:
            self._lower(clear, outline)
        parts, count = scipy.ndimage.label(clear > _WIDE, _EIGHT)
        if count == 0:
            return False
        main = int(np.bincount(parts.ravel())[1:].argmax()) + 1
        if any(self._near(parts, way) != main for way in self.ways):
            return False
        # Wherever somebody may stand is next to where everybody gets to who is not wide, or in a corner.
        slim = scipy.ndimage.label(clear > _SLIM, _EIGHT)[0]
        reached = slim == slim[np.unravel_index(int((clear * (parts == main)).argmax()), clear.shape)]
        away = scipy.ndimage.distance_transform_edt(~reached) * _CELL
        stuck = (clear > _NARROW - _CELL * math.sqrt(0.5)) & (away > _BESIDE)
        if not stuck.any():
            return True
        polygons = [self.inner, *self.blocked, *outlines]
        sides = np.concatenate([np.stack([p, np.roll(p, -1, axis=0)], axis=1) for p in polygons])
        out = away <= _BESIDE
        return all(self._gets_out(cell, sides, out) for cell in np.argwhere(stuck))

    def _gets_out(self, cell: np.ndarray, sides: np.ndarray, out: np.ndarray) -> bool:
        """Whether nobody narrow stands in a cell, or gets to those that are `out` (nx, ny), which takes in what was
        crossed, by going where the clearance between sides (m, 2, 2) grows: so one gets out of any corner of walls,
        and between parallel ones it does not grow."""
        fine = self._low + _CELL * (cell + 0.5 + _FINE)
        clear = np.linalg.norm(_nearest(fine, sides), axis=2).min(axis=1)
        point = fine[clear.argmax()]
        crossed = [tuple(cell)]
        if clear.max() <= _NARROW:
            return True
        for _ in range(int(2.0 / _PACE)):
            at: tuple[int, ...] = tuple(((point - self._low) / _CELL).astype(int))
            if out[at]:
                out[tuple(np.transpose(crossed))] = True
                return True
            crossed.append(at)
            along, rise = _uphill(point, sides)
            if not rise >= _CORNER:
                return False
            point = point + _PACE * along
        return False

    def _lower(self, clear: np.ndarray, outline: np.ndarray) -> None:
        """Lower the clearance (nx, ny) to the distance from a convex polygon, below 0 in it, where that is near."""
        low = np.maximum(((outline.min(axis=0) - self._low - _FAR) / _CELL).astype(int), 0)
        high = ((outline.max(axis=0) - self._low + _FAR) / _CELL).astype(int) + 1
        part = clear[low[0] : high[0], low[1] : high[1]]
        if part.size == 0:
            return
        x = self._low[0] + _CELL * (low[0] + 0.5 + np.arange(part.shape[0]))
        y = self._low[1] + _CELL * (low[1] + 0.5 + np.arange(part.shape[1]))
        centres = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        np.minimum(part, -_clearance(centres, outline).reshape(part.shape), out=part)

    def _near(self, parts: np.ndarray, way: np.ndarray) -> int:
        """The part at a place, or at the nearest cell within 0.3 m that has one."""
        rows = np.argwhere(parts > 0)
        if len(rows) == 0:
            return 0
        distance = np.linalg.norm(self._low + _CELL * (rows + 0.5) - way, axis=1)
        k = int(distance.argmin())
        return int(parts[tuple(rows[k])]) if distance[k] < 0.3 else 0
