"""Walking distances over a floor, in any direction: shortest ways of a disc among obstacles.

Lazy Theta* from the goal over all cells of a lattice (Nash, Koenig & Tovey, AAAI 2010; Daniel et al., JAIR 39,
2010): a cell's way is straight to its root, the cell behind which its goal is out of sight, and on from there.
Whether a straight way is free is decided exactly, for the disc, by `obstacles`. Corners are rounded at centres of
cells, so ways are too long by a part of a cell per corner, and never too short.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_continuous.obstacles import Obstacles, first_contact
from soundspaces_sim.parts import kernel, kernel_part as part

CELL = 0.05  # m
_SEARCH = 3  # cells around a place in which its roots are looked for
_SAME = 1e-9  # m
_ROOM = 16  # entries of the heap per cell: eight neighbours offer a way, and it may take its turn again


class Lattice(NamedTuple):
    """Cells on which an agent can stand: the centre of (i, j) is `origin` + CELL * (i, j)."""

    origin: np.ndarray  # (2,) m
    free: np.ndarray  # (nx, ny) bool


class DistanceField(NamedTuple):
    """Shortest ways to a goal."""

    obstacles: Obstacles
    lattice: Lattice
    goal: np.ndarray  # (2,) m
    distance: np.ndarray  # (nx, ny) m, inf where no way leads
    root: np.ndarray  # (nx, ny) cell to which the way is straight; -1: to the goal itself

    def ahead(self, x: float, y: float) -> tuple[float, float, float]:
        """(distance m, x, y): of the shortest way from a place, and where it first turns: the goal if it is in
        sight. The distance is inf where no way leads."""
        out = np.empty(3)
        _look_ahead(self, x, y, out)
        return float(out[0]), float(out[1]), float(out[2])


class _Heap(NamedTuple):
    """A binary heap of cells by key; a cell may be in it several times."""

    key: np.ndarray
    cell: np.ndarray
    size: np.ndarray  # (1,)


def fill_distances(obstacles: Obstacles, lattice: Lattice, goal: tuple[float, float]) -> DistanceField:
    """The field of a goal."""
    shape = lattice.free.shape
    distance, root = np.full(shape, np.inf), np.full(shape, -1, np.int64)
    room = _ROOM * lattice.free.size + _ROOM * _ROOM
    heap = _Heap(np.empty(room), np.empty(room, np.int64), np.zeros(1, np.int64))
    field = DistanceField(obstacles, lattice, np.array(goal, float), distance, root)
    _spread(field, heap, np.zeros(shape, np.bool_))
    return field


@part
def _push(heap: _Heap, key: float, cell: int) -> None:
    i = heap.size[0]
    if i == len(heap.key):
        return
    heap.size[0] = i + 1
    while i > 0 and heap.key[(i - 1) // 2] > key:
        heap.key[i], heap.cell[i] = heap.key[(i - 1) // 2], heap.cell[(i - 1) // 2]
        i = (i - 1) // 2
    heap.key[i], heap.cell[i] = key, cell


@part
def _pop(heap: _Heap) -> tuple[float, int]:
    key, cell = heap.key[0], heap.cell[0]
    n = heap.size[0] - 1
    heap.size[0] = n
    last, of_last, i = heap.key[n], heap.cell[n], 0
    while True:
        child = 2 * i + 1
        if child >= n:
            break
        if child + 1 < n and heap.key[child + 1] < heap.key[child]:
            child += 1
        if heap.key[child] >= last:
            break
        heap.key[i], heap.cell[i] = heap.key[child], heap.cell[child]
        i = child
    heap.key[i], heap.cell[i] = last, of_last
    return key, cell


@part
def _centre(field: DistanceField, cell: int) -> tuple[float, float]:
    ny = field.distance.shape[1]
    low = field.lattice.origin
    return low[0] + CELL * (cell // ny), low[1] + CELL * (cell % ny)


@part
def _of_root(field: DistanceField, root: int) -> tuple[float, float, float]:
    """(x, y, distance m) of a root."""
    if root < 0:
        return field.goal[0], field.goal[1], 0.0
    x, y = _centre(field, root)
    ny = field.distance.shape[1]
    return x, y, field.distance[root // ny, root % ny]


@part
def _sees(field: DistanceField, x: float, y: float, to_x: float, to_y: float) -> bool:
    return not first_contact(field.obstacles, x, y, to_x - x, to_y - y).share <= 1.0


@kernel
def _spread(field: DistanceField, heap: _Heap, done: np.ndarray) -> None:
    """Fill a field's tables from its goal. `done` (nx, ny): cells that are settled, none at first."""
    nx, ny = field.distance.shape
    i0 = int(round((field.goal[0] - field.lattice.origin[0]) / CELL))
    j0 = int(round((field.goal[1] - field.lattice.origin[1]) / CELL))
    for i in range(max(i0 - _SEARCH, 0), min(i0 + _SEARCH + 1, nx)):
        for j in range(max(j0 - _SEARCH, 0), min(j0 + _SEARCH + 1, ny)):
            x, y = _centre(field, i * ny + j)
            if field.lattice.free[i, j] and _sees(field, x, y, field.goal[0], field.goal[1]):
                field.distance[i, j] = math.hypot(x - field.goal[0], y - field.goal[1])
                _push(heap, field.distance[i, j], i * ny + j)
    while heap.size[0] > 0:
        key, cell = _pop(heap)
        i, j = cell // ny, cell % ny
        if done[i, j] or key > field.distance[i, j]:
            continue
        done[i, j] = True
        x, y = _centre(field, cell)
        rx, ry, _ = _of_root(field, field.root[i, j])
        if not _sees(field, x, y, rx, ry):
            # The root of a neighbour is out of sight here: the way leads over the best settled neighbour.
            best, root = np.inf, -1
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    a, b = i + di, j + dj
                    if (di != 0 or dj != 0) and 0 <= a < nx and 0 <= b < ny and done[a, b]:
                        way = field.distance[a, b] + CELL * math.hypot(di, dj)
                        if way < best:
                            px, py = _centre(field, a * ny + b)
                            if _sees(field, x, y, px, py):
                                best, root = way, a * ny + b
            field.distance[i, j], field.root[i, j] = best, root
            if best == np.inf:
                done[i, j] = False  # a later neighbour may reach it
                continue
            if heap.size[0] > 0 and best > heap.key[0]:
                done[i, j] = False  # others are nearer: it takes its turn again, its root in sight
                _push(heap, best, cell)
                continue
        rx, ry, far = _of_root(field, field.root[i, j])
        for di in range(-1, 2):
            for dj in range(-1, 2):
                a, b = i + di, j + dj
                if 0 <= a < nx and 0 <= b < ny and field.lattice.free[a, b] and not done[a, b]:
                    px, py = _centre(field, a * ny + b)
                    way = far + math.hypot(px - rx, py - ry)
                    if way < field.distance[a, b] - _SAME:
                        field.distance[a, b], field.root[a, b] = way, field.root[i, j]
                        _push(heap, way, a * ny + b)


@kernel
def _look_ahead(field: DistanceField, x: float, y: float, out: np.ndarray) -> None:
    """`look_ahead`, called from Python."""
    look_ahead(field, x, y, out)


@part
def look_ahead(field: DistanceField, x: float, y: float, out: np.ndarray) -> None:
    """Fill `out` (3,): see `DistanceField.ahead`."""
    out[0], out[1], out[2] = np.inf, x, y
    if _sees(field, x, y, field.goal[0], field.goal[1]):
        out[0] = math.hypot(field.goal[0] - x, field.goal[1] - y)
        out[1], out[2] = field.goal[0], field.goal[1]
        return
    nx, ny = field.distance.shape
    i0 = int(round((x - field.lattice.origin[0]) / CELL))
    j0 = int(round((y - field.lattice.origin[1]) / CELL))
    tried = -2
    for i in range(max(i0 - _SEARCH, 0), min(i0 + _SEARCH + 1, nx)):
        for j in range(max(j0 - _SEARCH, 0), min(j0 + _SEARCH + 1, ny)):
            if not field.distance[i, j] < np.inf:
                continue
            cx, cy = _centre(field, i * ny + j)
            rx, ry, far = _of_root(field, field.root[i, j])
            way = far + math.hypot(rx - x, ry - y)
            if field.root[i, j] != tried and way < out[0] and abs(rx - x) + abs(ry - y) > _SAME:
                tried = field.root[i, j]
                if _sees(field, x, y, rx, ry):
                    out[0], out[1], out[2] = way, rx, ry
            way = field.distance[i, j] + math.hypot(cx - x, cy - y)
            if way < out[0] - _SAME and _sees(field, x, y, cx, cy):
                out[0], out[1], out[2] = way, cx, cy
