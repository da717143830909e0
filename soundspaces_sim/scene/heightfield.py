"""Triangle meshes in a heightfield: the vertical extents of triangles within the columns of a horizontal raster.

Every triangle is clipped to the columns that it crosses, so that no wall is too thin to count.

Conventions: metres, Z up; column (i, j) has index i * ny + j. Source: the heightfield of Recast (M. Mononen,
2009); clipping after Sutherland and Hodgman (1974), Reentrant polygon clipping, CACM 17 (1).
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.rows import in_order

MOST_COLUMNS = 40_000_000  # 190 x 190 m in cells of 3 cm
MOST_CLIPS = 500_000_000  # about a minute
_AT_A_TIME = 1 << 20  # parts of triangles over columns
_EDGE = 1e-5  # m by which columns overlap, so that a wall between two of them is in both


class Cells(NamedTuple):
    """A horizontal raster: cell (i, j) begins at (x0 + i * size, y0 + j * size)."""

    x0: float  # m
    y0: float  # m
    size: float  # m
    nx: int
    ny: int

    def middles(self, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x and y of the middles of cells (i, j), m."""
        return self.x0 + (i + 0.5) * self.size, self.y0 + (j + 0.5) * self.size


class Spans(NamedTuple):
    """Solids as vertical spans, those of column c in rows start[c] to start[c + 1]; n spans in all."""

    start: np.ndarray  # (nx * ny + 1,) int64
    bottom: np.ndarray  # (n,) float32, m
    top: np.ndarray  # (n,) float32, m


class _Clipping(NamedTuple):
    """Workspace for clipping one triangle to a column: convex polygons of at most 9 corners."""

    slab: np.ndarray  # (9, 3) m: the triangle's part over one row of columns
    half: np.ndarray  # (9, 3) m: what is left after the first of two cuts
    cell: np.ndarray  # (9, 3) m: its part over one column


class _Pieces(NamedTuple):
    """Parts of triangles over columns, n of them."""

    column: np.ndarray  # (n,) int64
    face: np.ndarray  # (n,) int64
    low: np.ndarray  # (n,) m, lowest z
    high: np.ndarray  # (n,) m


def vertical_spans(corners: np.ndarray, cell: float) -> tuple[Cells, Spans]:
    """A raster of `cell` m under triangles (F, 3, 3) m, and their extents in its columns by rising bottom.

    Raises `SceneError` beyond `MOST_COLUMNS` columns, or `MOST_CLIPS` of them under all triangles together.
    """
    bounds, reason = _measured(corners, cell)
    if reason:
        raise SceneError(reason)
    cells = _raster(bounds, cell)
    parts = [
        (found.column.astype(np.int32), found.low.astype(np.float32), found.high.astype(np.float32))
        for found in _pieces(corners, cells)
    ]
    column, bottom, top = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    # By column, then by height: one number for both, with floats as integers of their order, is sorted fastest.
    key = np.empty(len(column), np.int64)
    _find_keys(column, (bottom + np.float32(0.0)).view(np.int32), key)
    order = in_order(key)[1]
    start = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=cells.nx * cells.ny))])
    return cells, Spans(start, bottom[order], top[order])


@kernel
def _find_keys(column: np.ndarray, bits: np.ndarray, key: np.ndarray) -> None:
    for i in range(len(key)):
        height = np.int64(bits[i])
        height ^= height >> 31 & 0x7FFFFFFF
        key[i] = np.int64(column[i]) << 32 | (height + 2**31)


@kernel
def _measure(corners: np.ndarray, cell: float, bounds: np.ndarray) -> float:
    """Least and greatest coordinates of triangles (F, 3, 3) into `bounds` (2, 3), and cells under their boxes."""
    clips = 0.0
    for axis in range(3):
        bounds[0, axis], bounds[1, axis] = np.inf, -np.inf
    for i in range(len(corners)):
        under = 1.0
        for axis in range(3):
            a, b, c = corners[i, 0, axis], corners[i, 1, axis], corners[i, 2, axis]
            low, high = min(a, b, c), max(a, b, c)
            bounds[0, axis] = min(bounds[0, axis], low)
            bounds[1, axis] = max(bounds[1, axis], high)
            if axis < 2:
                under *= (high - low) / cell + 2.0
        clips += under
    return clips


def _raster(bounds: np.ndarray, cell: float) -> Cells:
    """Cells of `cell` m within bounds (2, 3), with an empty one on every side."""
    nx, ny = (math.ceil((bounds[1, k] - bounds[0, k]) / cell) + 2 for k in (0, 1))
    return Cells(float(bounds[0, 0]) - cell, float(bounds[0, 1]) - cell, cell, nx, ny)


def too_large(corners: np.ndarray, cell: float) -> str:
    """Why `vertical_spans` refuses these triangles (F, 3, 3), m; empty if it does not."""
    return _measured(corners, cell)[1]


def _measured(corners: np.ndarray, cell: float) -> tuple[np.ndarray, str]:
    """The bounds (2, 3) of triangles, and `too_large`."""
    bounds = np.empty((2, 3))
    clips = _measure(corners, cell, bounds)
    size = bounds[1] - bounds[0]
    columns = float((size[0] / cell + 2.0) * (size[1] / cell + 2.0))
    if columns <= MOST_COLUMNS and clips <= MOST_CLIPS:
        return bounds, ""
    return bounds, (
        f"the scene spans {size[0]:.5g} x {size[1]:.5g} m: {columns:.3g} cells of {cell} m, {clips:.3g} "
        f"under all triangles, where {MOST_COLUMNS:.0e} and {MOST_CLIPS:.0e} are the most; check the unit "
        "(--unit), or cut the mesh into parts"
    )


@part
def _clip(polygon: np.ndarray, n: int, axis: int, bound: float, sign: float, out: np.ndarray) -> int:
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
def _columns_under(triangle: np.ndarray, cells: Cells) -> tuple[int, int, int, int]:
    """Range of columns under a triangle's bounding box: i0, i1, j0, j1 (exclusive ends)."""
    lx = min(triangle[0, 0], triangle[1, 0], triangle[2, 0])
    hx = max(triangle[0, 0], triangle[1, 0], triangle[2, 0])
    ly = min(triangle[0, 1], triangle[1, 1], triangle[2, 1])
    hy = max(triangle[0, 1], triangle[1, 1], triangle[2, 1])
    i0, i1 = int((lx - _EDGE - cells.x0) / cells.size), int((hx + _EDGE - cells.x0) / cells.size) + 1
    j0, j1 = int((ly - _EDGE - cells.y0) / cells.size), int((hy + _EDGE - cells.y0) / cells.size) + 1
    return max(i0, 0), min(i1, cells.nx), max(j0, 0), min(j1, cells.ny)


@part
def _clip_to_row(triangle: np.ndarray, i: int, cells: Cells, work: _Clipping) -> int:
    """The triangle's part over row i of columns, into `work.slab`; its number of corners."""
    for k in range(3):
        for axis in range(3):
            work.slab[k, axis] = triangle[k, axis]
    along = np.int64(0)  # typed, or a version is compiled for every constant
    low, high = cells.x0 + i * cells.size - _EDGE, cells.x0 + (i + 1) * cells.size + _EDGE
    n = _clip(work.slab, np.int64(3), along, low, -1.0, work.half)
    return _clip(work.half, n, along, high, 1.0, work.slab)


@part
def _clip_to_column(n: int, j: int, cells: Cells, work: _Clipping) -> int:
    """The part of `work.slab` (n corners) over column j of its row, into `work.cell`; its number of corners."""
    along = np.int64(1)
    low, high = cells.y0 + j * cells.size - _EDGE, cells.y0 + (j + 1) * cells.size + _EDGE
    m = _clip(work.slab, n, along, low, -1.0, work.half)
    return _clip(work.half, m, along, high, 1.0, work.cell)


@part
def _height(polygon: np.ndarray, n: int) -> tuple[float, float]:
    """Lowest and highest z of a polygon's n corners."""
    low, high = polygon[0, 2], polygon[0, 2]
    for k in range(1, n):
        low, high = min(low, polygon[k, 2]), max(high, polygon[k, 2])
    return low, high


@kernel
def _clip_faces(
    corners: np.ndarray, cells: Cells, face: int, row: int, found: _Pieces, work: _Clipping
) -> tuple[int, int, int]:
    """Fill `found` with the parts of triangles (F, 3, 3) over columns, from a row of columns of a face on and
    while there is room for a whole row; the number of parts, and the face and the row that are next."""
    count, most = 0, len(found.column)
    for f in range(face, len(corners)):
        i0, i1, j0, j1 = _columns_under(corners[f], cells)
        if i1 - i0 == 1 and j1 - j0 == 1 and count < most:  # as most triangles of a scan
            found.column[count], found.face[count] = i0 * cells.ny + j0, f
            found.low[count], found.high[count] = _height(corners[f], 3)
            count += 1
            continue
        for i in range(max(i0, row) if f == face else i0, i1):
            if count + j1 - j0 > most:
                return count, f, i
            n = _clip_to_row(corners[f], i, cells, work)
            for j in range(j0, j1):
                m = _clip_to_column(n, j, cells, work)
                if m > 0:
                    found.column[count], found.face[count] = i * cells.ny + j, f
                    found.low[count], found.high[count] = _height(work.cell, m)
                    count += 1
    return count, len(corners), 0


def _pieces(corners: np.ndarray, cells: Cells) -> Iterator[_Pieces]:
    """The parts of triangles (F, 3, 3) m over columns, by face, a million or so at a time, in arrays that are
    used again."""
    most = max(cells.ny, _AT_A_TIME)
    room = _Pieces(np.empty(most, np.int64), np.empty(most, np.int64), *np.empty((2, most)))
    face, row, work = 0, 0, _Clipping(*np.empty((3, 9, 3)))
    while face < len(corners):
        count, face, row = _clip_faces(corners, cells, face, row, room, work)
        yield _Pieces(*(array[:count] for array in room))


def footprints(
    corners: np.ndarray, value: np.ndarray, cells: Cells, low: float, high: float
) -> np.ndarray:
    """(nx, ny) `value` of the face that is highest in each column, of those between two heights; -1: none.

    `corners` (F, 3, 3) m; `value` (F,) int; `low` and `high` in m. Of faces equally high it is the first.
    """
    out = np.full(cells.nx * cells.ny, -1)
    top = np.full(cells.nx * cells.ny, -np.inf)
    for found in _pieces(corners, cells):
        higher = (low < found.high) & (found.high <= high) & (found.high > top[found.column])
        column, z = found.column[higher], found.high[higher]
        np.maximum.at(top, column, z)
        highest = np.flatnonzero(z == top[column])[::-1]  # the last assignment of a column holds
        out[column[highest]] = value[found.face[higher][highest]]
    return out.reshape(cells.nx, cells.ny)
