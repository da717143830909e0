"""`Floor`: cells of a scene that an agent can stand on, and how one gets from one to another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

from soundspaces_sim import Scene
from soundspaces_sim.parts import (
    FloorColumns as Columns,
    find_floors,
    floor_heights,
    neighbouring_cells as neighbours,
    walk_straight,
)

_LEAST_INDOORS = 1.0  # m² of floor under a roof from which on roofs are no floors


@dataclass
class NavMeshSettings:
    """Size of an agent and of the cells, m, with habitat's names; the fields of Recast's polygons, which there are
    none of here, do nothing."""

    agent_height: float = 1.5
    agent_radius: float = 0.1
    agent_max_climb: float = 0.2
    cell_size: float = 0.05
    cell_height: float = 0.2
    agent_max_slope: float = 45.0
    filter_low_hanging_obstacles: bool = True
    filter_ledge_spans: bool = True
    filter_walkable_low_height_spans: bool = True
    include_static_objects: bool = False

    def set_defaults(self) -> None:
        """Back to the defaults."""
        vars(self).update(vars(NavMeshSettings()))


class Floor:
    """Cells to stand on: `points` (n, 3) m, scene axes, their middles; `island` (n,) what hangs together."""

    def __init__(self, scene: Scene, settings: NavMeshSettings) -> None:
        height, self.cell, self.climb = (
            settings.agent_height,
            settings.cell_size,
            settings.agent_max_climb,
        )
        self.columns: Columns = find_floors(
            scene.corners, self.cell, height, settings.agent_radius, self.climb
        )
        columns = self.columns
        column = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
        covered = columns.stand & ~columns.sky
        use = covered if covered.sum() * self.cell**2 >= _LEAST_INDOORS else columns.stand
        of = np.flatnonzero(use)
        row = np.full(len(use), -1)
        row[of] = np.arange(len(of))
        pairs, length = neighbours(columns, self.climb)
        kept = use[pairs].all(axis=1)
        a, b = row[pairs[kept]].T
        steps: Any = coo_array((length[kept], (a, b)), shape=(len(of),) * 2).tocsr()
        island = connected_components(steps, directed=False)[1]
        near = (
            np.abs(columns.floor[of][:, None] - floor_heights(scene, height)).min(axis=1) <= self.climb
        )
        served = np.isin(island, island[near])
        of, self.island, self._steps = of[served], island[served], steps[served][:, served]
        xy = np.column_stack([column[of] // columns.cells.ny, column[of] % columns.cells.ny]) + 0.5
        self.points = np.column_stack(
            [xy * self.cell + [columns.cells.x0, columns.cells.y0], columns.floor[of]]
        )
        self._tree = KDTree(self.points) if len(of) else None
        self._column = column[of]  # ascending

    def nearest(self, place: np.ndarray) -> int:
        """Row of the cell nearest to a place (3,), -1 if there is none."""
        return -1 if self._tree is None else int(self._tree.query(place)[1])

    def nearest_way(self, start: np.ndarray, ends: list[np.ndarray]) -> tuple[int, np.ndarray]:
        """The place (3,) of `ends` with the shortest way from `start`, by its row, and the corners (k, 3) of that
        way, all snapped to cells; -1 and none where there is no way to any."""
        first, goals = self.nearest(start), [self.nearest(end) for end in ends]
        reached = [
            i for i, goal in enumerate(goals) if goal >= 0 and self.island[goal] == self.island[first]
        ]
        if first < 0 or not reached:
            return -1, np.empty((0, 3))
        before = self._chains(first)
        ways = {i: self._pulled(before, first, goals[i]) for i in reached}
        far = {i: np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for i, way in ways.items()}
        best = min(far, key=far.__getitem__)
        return best, ways[best]

    def way(self, start: int, end: int) -> np.ndarray:
        """(k, 3) corners of the way between two cells of an island."""
        return self._pulled(self._chains(start), start, end)

    def _chains(self, start: int) -> np.ndarray:
        """(n,) the cell before each on the shortest chain of cells from one."""
        _, before = dijkstra(
            self._steps, directed=False, indices=np.array([start]), return_predecessors=True
        )
        return np.asarray(before[0])

    def _pulled(self, before: np.ndarray, start: int, end: int) -> np.ndarray:
        """(k, 3) corners of a chain of cells, pulled straight."""
        cells = [end]
        while cells[-1] != start:
            cells.append(int(before[cells[-1]]))
        chain = self.points[cells[::-1]]
        corners, at = [0], 0
        while at < len(chain) - 1:  # as far as one can walk straight, then on from there
            ahead = np.arange(at + 1, len(chain))
            pairs = np.column_stack([np.full(len(ahead), at), ahead])
            free = np.isfinite(walk_straight(self.columns, chain, pairs, self.climb))
            free[0] = True  # the next cell: on a stair its height may be beyond what counts as straight
            at = int(ahead[np.flatnonzero(free)[-1]])
            corners.append(at)
        return chain[corners]

    def holds(self, places: np.ndarray, rise: float) -> np.ndarray:
        """(n,) whether one can stand at places (n, 3), their heights good to `rise` m."""
        if self._tree is None:
            return np.zeros(len(places), bool)
        off = np.abs(self.points[self._tree.query(places)[1]] - places)
        return np.asarray((off[:, :2].max(axis=1) <= 0.5 * self.cell + 1e-6) & (off[:, 2] <= rise))

    def near(self, place: np.ndarray, radius: float) -> np.ndarray:
        """Rows of the cells whose middles are within `radius` m of a place (3,)."""
        if self._tree is None:
            return np.empty(0, np.int64)
        return np.array(sorted(self._tree.query_ball_point(place, radius)), np.int64)

    def straight(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(3,) how far one gets from a cell's middle or elsewhere on the floor straight towards `end`."""
        across = end[:2] - start[:2]
        steps = max(1, int(np.ceil(np.linalg.norm(across) / (0.25 * self.cell))))
        reached, height = start, float(start[2])
        for share in np.arange(1, steps + 1) / steps:
            place = start[:2] + share * across
            row = self._at(place, height)
            if row < 0:
                break
            height = float(self.points[row, 2])
            reached = np.append(place, height)
        return np.asarray(reached)

    def slid(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(3,) the place nearest to `end` that one gets to from `start` without going farther away from it than
        `end` is: what is left of a step along a wall."""
        reached = self.straight(start, end)
        if np.array_equal(reached[:2], end[:2]):
            return reached
        around = self.near(start, float(np.linalg.norm(end[:2] - start[:2])) + 1.5 * self.cell)
        home = self._at(start[:2], float(start[2]))
        if home < 0 or not len(around):
            return reached
        part = connected_components(self._steps[around][:, around], directed=False)[1]
        local = around[part == part[np.searchsorted(around, home)]]
        half = 0.5 * self.cell
        nearest = np.clip(end[:2], self.points[local, :2] - half, self.points[local, :2] + half)
        best = int(np.linalg.norm(nearest - end[:2], axis=1).argmin())
        return np.append(nearest[best], self.points[local[best], 2])

    def _at(self, place: np.ndarray, height: float) -> int:
        """Row of the cell over which (2,) lies, of a height within a climb; -1 if there is none."""
        cells = self.columns.cells
        ix, iy = np.floor((place - [cells.x0, cells.y0]) / self.cell).astype(int)
        if not (0 <= iy < cells.ny and ix >= 0):
            return -1
        first, last = np.searchsorted(self._column, [ix * cells.ny + iy, ix * cells.ny + iy + 1])
        if first == last:
            return -1
        rise = np.abs(self.points[first:last, 2] - height)
        best = int(rise.argmin())
        return int(first + best) if rise[best] <= self.climb + 1e-9 else -1
