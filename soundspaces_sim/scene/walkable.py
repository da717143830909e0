"""Where an agent can walk: floors with headroom, found by filling a grid of columns with the mesh.

Every triangle is clipped to the columns that it crosses, so nothing is thin enough to slip through.
What overlaps in a column is solid; the top of a solid with enough room above is a floor. An agent can
stand where the floor goes on, within a step, all around it (Recast's heightfield, M. Mononen 2009).

Conventions: metres, Z up; column (i, j) has index i * ny + j; errs by a cell towards "blocked".
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part

MOST_COLUMNS = 40_000_000  # 190 x 190 m in cells of 3 cm
MOST_CLIPS = 500_000_000  # about a minute
_GAP = 0.01  # m; solids closer than this are one
_EDGE = 1e-5  # m by which columns overlap, so that a wall between two of them is in both


class Columns(NamedTuple):
    """Floors per column: `start` (nx * ny + 1,) into `floor` (k,) m, ascending, `stand` (k,) whether an
    agent can stand there, `sky` (k,) whether nothing is above; `top` (nx * ny,) m, -inf where all is empty."""

    x0: float
    y0: float
    cell: float
    nx: int
    ny: int
    start: np.ndarray
    floor: np.ndarray
    stand: np.ndarray
    sky: np.ndarray
    top: np.ndarray


def find_floors(corners: np.ndarray, cell: float, height: float, radius: float, step: float) -> Columns:
    """Floors under `height` m of free air, and where an agent of `radius` can stand.

    `corners` (F, 3, 3) m. `step`: the highest step it takes, m. Raises `SceneError` beyond `MOST_COLUMNS`
    columns, or `MOST_CLIPS` of them under all triangles together.
    """
    reason = too_large(corners, cell)
    if reason:
        raise SceneError(reason)
    low, high = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    x0, y0 = float(low[0]) - cell, float(low[1]) - cell
    nx, ny = (int(math.ceil((high[k] - low[k]) / cell)) + 2 for k in (0, 1))
    count = np.zeros(nx * ny, np.int64)
    _count_spans(corners, x0, y0, cell, nx, ny, count, np.empty((3, 9, 3)))
    start = np.concatenate([[0], np.cumsum(count)])
    bottom, top = np.empty(start[-1], np.float32), np.empty(start[-1], np.float32)
    _fill_spans(corners, x0, y0, cell, nx, ny, start[:-1].copy(), bottom, top, np.empty((3, 9, 3)))
    order = np.lexsort((bottom, np.repeat(np.arange(len(count)), count)))
    floor, sky = np.empty(len(bottom), np.float32), np.zeros(len(bottom), np.bool_)
    highest, first = np.empty(len(count)), np.empty(len(start), np.int64)
    k = _free_floors(start, bottom[order], top[order], height, floor, sky, highest, first)
    columns = Columns(
        x0, y0, cell, nx, ny, first, floor[:k].copy(), np.zeros(k, np.bool_), sky[:k].copy(), highest
    )
    _mark_standable(columns, int(math.ceil(radius / cell - 1e-9)), radius, step)
    return columns


def too_large(corners: np.ndarray, cell: float) -> str:
    """Why `find_floors` refuses triangles (F, 3, 3) m; empty if it does not."""
    flat = corners.reshape(-1, 3)
    size = flat.max(axis=0) - flat.min(axis=0)
    columns = float((size[0] / cell + 2.0) * (size[1] / cell + 2.0))
    across = np.ptp(corners, axis=1)[:, :2] / cell + 2.0
    clips = float((across[:, 0] * across[:, 1]).sum())
    if columns <= MOST_COLUMNS and clips <= MOST_CLIPS:
        return ""
    return (
        f"the scene spans {size[0]:.5g} x {size[1]:.5g} m: {columns:.3g} cells of {cell} m, {clips:.3g} "
        f"under all triangles, where {MOST_COLUMNS:.0e} and {MOST_CLIPS:.0e} are the most; check the unit "
        "(--unit), or cut the mesh into parts"
    )


@part
def _clip(polygon, n, axis, bound, sign, out):
    """Part of a polygon (n, 3) where sign * x[axis] <= sign * bound, into `out`; its number of corners."""
    m = 0
    for i in range(n):
        j = (i + 1) % n
        a, b = sign * (polygon[i, axis] - bound), sign * (polygon[j, axis] - bound)
        if a <= 0.0:
            for k in range(3):
                out[m, k] = polygon[i, k]
            m += 1
        if (a < 0.0 and b > 0.0) or (a > 0.0 and b < 0.0):
            t = a / (a - b)
            for k in range(3):
                out[m, k] = polygon[i, k] + t * (polygon[j, k] - polygon[i, k])
            m += 1
    return m


@part
def _columns_of(triangle, x0, y0, cell, nx, ny):
    """Range of columns under a triangle's bounding box: i0, i1, j0, j1 (exclusive ends)."""
    lx = min(triangle[0, 0], triangle[1, 0], triangle[2, 0])
    hx = max(triangle[0, 0], triangle[1, 0], triangle[2, 0])
    ly = min(triangle[0, 1], triangle[1, 1], triangle[2, 1])
    hy = max(triangle[0, 1], triangle[1, 1], triangle[2, 1])
    i0, i1 = int((lx - _EDGE - x0) / cell), int((hx + _EDGE - x0) / cell) + 1
    j0, j1 = int((ly - _EDGE - y0) / cell), int((hy + _EDGE - y0) / cell) + 1
    return max(i0, 0), min(i1, nx), max(j0, 0), min(j1, ny)


@part
def _slab(triangle, i, x0, cell, a, b):
    """The triangle's part over column row i, into `a`; its number of corners."""
    for k in range(3):
        for axis in range(3):
            a[k, axis] = triangle[k, axis]
    along = np.int64(0)  # typed, or a version is compiled for every constant
    n = _clip(a, np.int64(3), along, x0 + i * cell - _EDGE, -1.0, b)
    return _clip(b, n, along, x0 + (i + 1) * cell + _EDGE, 1.0, a)


@part
def _cell(part, n, j, y0, cell, b, c):
    """What of a slab's part (n corners) lies over column j of its row, into `c`; its number of corners."""
    along = np.int64(1)
    m = _clip(part, n, along, y0 + j * cell - _EDGE, -1.0, b)
    return _clip(b, m, along, y0 + (j + 1) * cell + _EDGE, 1.0, c)


@part
def _height(part, n):
    """Lowest and highest z of a polygon's n corners."""
    low, high = part[0, 2], part[0, 2]
    for k in range(1, n):
        low, high = min(low, part[k, 2]), max(high, part[k, 2])
    return low, high


@kernel
def _count_spans(corners, x0, y0, cell, nx, ny, count, work):
    a, b, c = work[0], work[1], work[2]
    for f in range(len(corners)):
        i0, i1, j0, j1 = _columns_of(corners[f], x0, y0, cell, nx, ny)
        for i in range(i0, i1):
            n = _slab(corners[f], i, x0, cell, a, b)
            for j in range(j0, j1):
                if _cell(a, n, j, y0, cell, b, c) > 0:
                    count[i * ny + j] += 1


@kernel
def _fill_spans(corners, x0, y0, cell, nx, ny, place, bottom, top, work):
    a, b, c = work[0], work[1], work[2]
    for f in range(len(corners)):
        i0, i1, j0, j1 = _columns_of(corners[f], x0, y0, cell, nx, ny)
        for i in range(i0, i1):
            n = _slab(corners[f], i, x0, cell, a, b)
            for j in range(j0, j1):
                m = _cell(a, n, j, y0, cell, b, c)
                if m > 0:
                    k = place[i * ny + j]
                    bottom[k], top[k] = _height(c, m)
                    place[i * ny + j] += 1


@kernel
def _free_floors(start, bottom, top, height, floor, sky, highest, first):
    """Number of the tops of solids with `height` m of air above; fills these, whether nothing else is above,
    the highest top of each column, and where each column's floors begin. Spans rise within a column."""
    k = 0
    for column in range(len(start) - 1):
        first[column] = k
        begin, end = start[column], start[column + 1]
        level = -np.inf
        for r in range(begin, end):
            level = max(level, top[r])
            above = bottom[r + 1] if r + 1 < end else np.inf
            if above - level > max(height, _GAP):
                floor[k] = level
                sky[k] = above == np.inf
                k += 1
        highest[column] = level
    first[-1] = k
    return k


@part
def nearest_floor(columns, i, j, z, step):
    """Row of the floor of column (i, j) nearest to height z, within `step`; -1 if there is none."""
    if i < 0 or j < 0 or i >= columns.nx or j >= columns.ny:
        return -1
    best, found = step + 1e-6, -1
    c = i * columns.ny + j
    for k in range(columns.start[c], columns.start[c + 1]):
        d = abs(columns.floor[k] - z)
        if d <= best:
            best, found = d, k
    return found


@kernel
def _mark_standable(columns, reach, radius, step):
    """Set `columns.stand`."""
    for i in range(columns.nx):
        for j in range(columns.ny):
            c = i * columns.ny + j
            for k in range(columns.start[c], columns.start[c + 1]):
                free = True
                for di in range(-reach, reach + 1):
                    for dj in range(-reach, reach + 1):
                        if free and math.hypot(di, dj) * columns.cell <= radius + 1e-9:
                            free = nearest_floor(columns, i + di, j + dj, columns.floor[k], step) >= 0
                columns.stand[k] = free


@kernel
def _stand_at(columns, points, step, rows):
    for p in range(len(points)):
        i = int(math.floor((points[p, 0] - columns.x0) / columns.cell))
        j = int(math.floor((points[p, 1] - columns.y0) / columns.cell))
        k = nearest_floor(columns, i, j, points[p, 2], step)
        if k >= 0 and columns.stand[k]:
            rows[p] = k


def stand_at(columns: Columns, points: np.ndarray, step: float) -> np.ndarray:
    """(N,) row of the floor on which an agent stands at each (N, 3) place (z: the floor's), or -1."""
    rows = np.full(len(points), -1)
    _stand_at(columns, points, step, rows)
    return rows


@kernel
def _walk_straight(first, last, columns, points, pairs, step, length):
    for p in range(first, last):
        a, b = points[pairs[p, 0]], points[pairs[p, 1]]
        dx, dy = b[0] - a[0], b[1] - a[1]
        distance = math.hypot(dx, dy)
        n = int(math.ceil(distance / (0.25 * columns.cell))) + 1
        z, free = a[2], True
        for s in range(n + 1):
            i = int(math.floor((a[0] + dx * s / n - columns.x0) / columns.cell))
            j = int(math.floor((a[1] + dy * s / n - columns.y0) / columns.cell))
            k = nearest_floor(columns, i, j, z, step)
            if k < 0 or not columns.stand[k] or abs(columns.floor[k] - a[2]) > step + 1e-6:
                free = False
                break
            z = columns.floor[k]
        if free and abs(z - b[2]) <= step + 1e-6:
            length[p] = distance


def walk_straight(columns: Columns, points: np.ndarray, pairs: np.ndarray, step: float) -> np.ndarray:
    """(P,) length of the straight walk between points (N, 3) of each pair, or inf if it is blocked.

    No step is higher than `step`, and the floor stays within `step` of the height where the walk began.
    """
    length = np.full(len(pairs), np.inf)
    over_rows(_walk_straight, len(pairs), columns, points, pairs, step, length)
    return length


@kernel
def _neighbours(columns, step, pairs, length):
    """Counts what `neighbours` returns, and fills it where there is room for it."""
    e = 0
    for i in range(columns.nx):
        for j in range(columns.ny):
            c = i * columns.ny + j
            for k in range(columns.start[c], columns.start[c + 1]):
                if not columns.stand[k]:
                    continue
                for di, dj in ((1, -1), (1, 0), (1, 1), (0, 1)):
                    other = nearest_floor(columns, i + di, j + dj, columns.floor[k], step)
                    if other >= 0 and columns.stand[other]:
                        rise = columns.floor[other] - columns.floor[k]
                        if e < len(pairs):
                            pairs[e, 0], pairs[e, 1] = k, other
                            length[e] = math.sqrt((di * di + dj * dj) * columns.cell**2 + rise * rise)
                        e += 1
    return e


def neighbours(columns: Columns, step: float) -> tuple[np.ndarray, np.ndarray]:
    """(E, 2) rows of floors where an agent walks from one column to the next, and (E,) lengths, m."""
    # Counted first, and in 32 bits: of a large building's cells these are the most memory that is taken.
    count = _neighbours(columns, step, np.empty((0, 2), np.int32), np.empty(0))
    pairs, length = np.empty((count, 2), np.int32), np.empty(count)
    _neighbours(columns, step, pairs, length)
    return pairs, length


@kernel
def _footprints(corners, value, x0, y0, cell, low, high, out, reach, work):
    nx, ny = out.shape
    a, b, c = work[0], work[1], work[2]
    for f in range(len(corners)):
        i0, i1, j0, j1 = _columns_of(corners[f], x0, y0, cell, nx, ny)
        for i in range(i0, i1):
            n = _slab(corners[f], i, x0, cell, a, b)
            for j in range(j0, j1):
                m = _cell(a, n, j, y0, cell, b, c)
                if m > 0:
                    _, top = _height(c, m)
                    if low < top <= high and top > reach[i, j]:
                        reach[i, j], out[i, j] = top, value[f]


def footprints(
    corners: np.ndarray, value: np.ndarray, x0: float, y0: float, cell: float, nx: int, ny: int, low: float,
    high: float,
) -> np.ndarray:  # fmt: skip
    """(nx, ny) `value` of the face that is highest in each column, of those between two heights; -1: none.

    `corners` (F, 3, 3) m; `value` (F,) int.
    """
    out = np.full((nx, ny), -1)
    reach = np.full((nx, ny), -np.inf)
    _footprints(corners, value, x0, y0, cell, low, high, out, reach, np.empty((3, 9, 3)))
    return out
