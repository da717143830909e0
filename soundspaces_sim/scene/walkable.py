"""Walkable floors of a mesh, from a heightfield: floors with headroom on which an agent of given radius can stand.

Extents of triangles that overlap within a column are one solid; the top of a solid with enough air above is a
floor. An agent can stand on a floor if every column within its radius has a floor within one step of it.

Conventions: metres, Z up; column (i, j) has index i * ny + j; errors of one cell are towards "blocked".
Source: the heightfield of Recast (M. Mononen, 2009).
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.scene.heightfield import Cells, Spans, vertical_spans

_GAP = 0.01  # m; solids closer than this are one


class Columns(NamedTuple):
    """The floors of every column of a raster, ascending within a column; k floors in all."""

    cells: Cells
    # (nx * ny + 1,) int64: column c has rows start[c] to start[c + 1] of the next three
    start: np.ndarray
    floor: np.ndarray  # (k,) float32, height, m
    stand: np.ndarray  # (k,) bool: an agent can stand there
    clear: np.ndarray  # (k,) float32, m of free air above; inf under the sky
    top: np.ndarray  # (nx * ny,) height of the highest solid, m; -inf in an empty column

    @property
    def sky(self) -> np.ndarray:
        """(k,) whether nothing is above."""
        return np.isinf(self.clear)


def find_floors(corners: np.ndarray, cell: float, height: float, radius: float, step: float) -> Columns:
    """Floors under `height` m of free air, and where an agent of `radius` can stand.

    `corners` (F, 3, 3) m. `step`: the highest step it takes, m. Raises `SceneError` beyond `MOST_COLUMNS`
    columns, or `MOST_CLIPS` of them under all triangles together.
    """
    cells, spans = vertical_spans(corners, cell)
    count = len(spans.bottom)
    floor, clear = np.empty((2, count), np.float32)
    columns = Columns(
        cells,
        np.empty(len(spans.start), np.int64),
        floor,
        np.zeros(count, np.bool_),
        clear,
        np.empty(len(spans.start) - 1),
    )
    k = _free_floors(spans, height, columns)
    columns = columns._replace(floor=floor[:k].copy(), clear=clear[:k].copy())
    return columns._replace(stand=standable(columns, radius, step))


def standable(columns: Columns, radius: float, step: float) -> np.ndarray:
    """(k,) whether all columns within `radius` m of a floor have one within `step` m of it."""
    free = np.zeros(len(columns.floor), np.bool_)
    _mark_standable(columns, int(math.ceil(radius / columns.cells.size - 1e-9)), radius, step, free)
    return free


@kernel
def _free_floors(spans: Spans, height: float, columns: Columns) -> int:
    """Fill `columns` but for `stand` with the tops of solids that have `height` m of air above; their number."""
    k = 0
    for column in range(len(spans.start) - 1):
        columns.start[column] = k
        begin, end = spans.start[column], spans.start[column + 1]
        level = -np.inf
        for r in range(begin, end):
            level = max(level, spans.top[r])
            above = spans.bottom[r + 1] if r + 1 < end else np.inf
            if above - level > max(height, _GAP):
                columns.floor[k] = level
                columns.clear[k] = above - level
                k += 1
        columns.top[column] = level
    columns.start[-1] = k
    return k


@part
def nearest_floor(columns: Columns, i: int, j: int, z: float, step: float) -> int:
    """Row of the floor of column (i, j) nearest to height z, within `step`; -1 if there is none."""
    if i < 0 or j < 0 or i >= columns.cells.nx or j >= columns.cells.ny:
        return -1
    best, found = step + 1e-6, -1
    c = i * columns.cells.ny + j
    for k in range(columns.start[c], columns.start[c + 1]):
        d = abs(columns.floor[k] - z)
        if d <= best:
            best, found = d, k
    return found


@kernel
def _mark_standable(columns: Columns, reach: int, radius: float, step: float, stand: np.ndarray) -> None:
    """Set `stand` (k,)."""
    for i in range(columns.cells.nx):
        for j in range(columns.cells.ny):
            c = i * columns.cells.ny + j
            for k in range(columns.start[c], columns.start[c + 1]):
                free = True
                for di in range(-reach, reach + 1):
                    for dj in range(-reach, reach + 1):
                        if free and math.hypot(di, dj) * columns.cells.size <= radius + 1e-9:
                            free = nearest_floor(columns, i + di, j + dj, columns.floor[k], step) >= 0
                stand[k] = free


@kernel
def _stand_at(columns: Columns, points: np.ndarray, step: float, rows: np.ndarray) -> None:
    cells = columns.cells
    for p in range(len(points)):
        i = int(math.floor((points[p, 0] - cells.x0) / cells.size))
        j = int(math.floor((points[p, 1] - cells.y0) / cells.size))
        k = nearest_floor(columns, i, j, points[p, 2], step)
        if k >= 0 and columns.stand[k]:
            rows[p] = k


def stand_at(columns: Columns, points: np.ndarray, step: float) -> np.ndarray:
    """(N,) row of the floor on which an agent stands at each (N, 3) place (z: the floor's), or -1."""
    rows = np.full(len(points), -1)
    _stand_at(columns, points, step, rows)
    return rows


@kernel
def _walk_straight(
    first: int,
    last: int,
    columns: Columns,
    points: np.ndarray,
    pairs: np.ndarray,
    step: float,
    length: np.ndarray,
) -> None:
    cells = columns.cells
    for p in range(first, last):
        a, b = points[pairs[p, 0]], points[pairs[p, 1]]
        dx, dy, rise = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        distance = math.hypot(dx, dy)
        n = int(math.ceil(distance / (0.25 * cells.size))) + 1
        z, free = a[2], True
        for s in range(n + 1):
            i = int(math.floor((a[0] + dx * s / n - cells.x0) / cells.size))
            j = int(math.floor((a[1] + dy * s / n - cells.y0) / cells.size))
            k = nearest_floor(columns, i, j, z, step)
            if (
                k < 0
                or not columns.stand[k]
                or abs(columns.floor[k] - a[2] - rise * s / n) > step + 1e-6
            ):
                free = False
                break
            z = columns.floor[k]
        if free and abs(z - b[2]) <= step + 1e-6:
            length[p] = math.hypot(distance, rise)


def walk_straight(columns: Columns, points: np.ndarray, pairs: np.ndarray, step: float) -> np.ndarray:
    """(P,) length of the straight walk between points (N, 3) of each pair, or inf if it is blocked.

    No step is higher than `step`, and the floor stays within `step` of the straight line between the points.
    """
    length = np.full(len(pairs), np.inf)
    over_rows(_walk_straight, len(pairs), columns, points, pairs, step, length)
    return length


@kernel
def _neighbours(columns: Columns, step: float, pairs: np.ndarray, length: np.ndarray) -> int:
    """Counts what `neighbours` returns, and fills it where there is room for it."""
    e = 0
    for i in range(columns.cells.nx):
        for j in range(columns.cells.ny):
            c = i * columns.cells.ny + j
            for k in range(columns.start[c], columns.start[c + 1]):
                if not columns.stand[k]:
                    continue
                for di, dj in ((1, -1), (1, 0), (1, 1), (0, 1)):
                    other = nearest_floor(columns, i + di, j + dj, columns.floor[k], step)
                    if other >= 0 and columns.stand[other]:
                        rise = columns.floor[other] - columns.floor[k]
                        if e < len(pairs):
                            pairs[e, 0], pairs[e, 1] = k, other
                            length[e] = math.sqrt(
                                (di * di + dj * dj) * columns.cells.size**2 + rise * rise
                            )
                        e += 1
    return e


def neighbours(columns: Columns, step: float) -> tuple[np.ndarray, np.ndarray]:
    """(E, 2) rows of floors where an agent walks from one column to the next, and (E,) lengths, m."""
    # Counted first, and in 32 bits: of a large building's cells these are the most memory that is taken.
    count = _neighbours(columns, step, np.empty((0, 2), np.int32), np.empty(0))
    pairs, length = np.empty((count, 2), np.int32), np.empty(count)
    _neighbours(columns, step, pairs, length)
    return pairs, length
