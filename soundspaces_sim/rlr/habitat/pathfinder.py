"""`PathFinder`: where an agent can stand and how it walks, found in the scene's mesh; axes are habitat's."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

from soundspaces_sim.rlr.arguments import vector3
from soundspaces_sim.rlr.errors import RlrError, as_runtime_errors
from soundspaces_sim.rlr.habitat.records import from_habitat, to_habitat
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.storeys import floor_heights
from soundspaces_sim.scene.walkable import Columns, find_floors, neighbours, walk_straight

_CELL, _STEP = 0.05, 0.2  # m: habitat's cell_size and agent_max_climb
_LEAST_INDOORS = 1.0  # m² of floor under a roof from which on roofs are no floors


@dataclass
class ShortestPath:
    """What `find_path` is asked for and answers: (3,) ends, length in m (inf: no way), corners on the way."""

    requested_start: Any = field(default_factory=lambda: np.zeros(3))
    requested_end: Any = field(default_factory=lambda: np.zeros(3))
    geodesic_distance: float = np.inf
    points: list[np.ndarray] = field(default_factory=list)


class PathFinder:
    """The floor of a scene for an agent of a height and radius, m, made when first asked of.

    It is found in the mesh: files of navigation meshes (Recast's) are not read. Floors are those of the scene's
    storeys and what can be walked to from them; so table tops are none, and roofs are none where there is floor
    below a roof. Ways go over cells of 5 cm and are then pulled straight.
    """

    def __init__(self, scene: Scene, height: float, radius: float) -> None:
        self._scene, self._height, self._radius = scene, height, radius
        self._floor: _Floor | None = None
        self._random = np.random.default_rng(0)

    @property
    def is_loaded(self) -> bool:
        """Whether there is anywhere to stand."""
        return len(self._made().points) > 0

    @property
    def navigable_area(self) -> float:
        """Area of the floor, m²."""
        return len(self._made().points) * _CELL**2

    def load_nav_mesh(self, path: str) -> bool:
        """Habitat's way to a navigation mesh; the file is not read, the scene's own floor serves."""
        del path
        return self.is_loaded

    def seed(self, new_seed: int) -> None:
        """Seed `get_random_navigable_point`."""
        self._random = np.random.default_rng(new_seed)

    def get_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest coordinates of the floor, (3,) each."""
        points = to_habitat(self._some_floor().points)
        half = np.array([0.5, 0.0, 0.5]) * _CELL
        return points.min(axis=0) - half, points.max(axis=0) + half

    def get_random_navigable_point(self, max_tries: int = 10) -> np.ndarray:
        """(3,) float32 place on the floor, evenly distributed over it; `max_tries` is habitat's."""
        del max_tries
        floor = self._some_floor()
        place = floor.points[self._random.integers(len(floor.points))]
        off = np.append(self._random.uniform(-0.5, 0.5, 2) * 0.99 * _CELL, 0.0)
        return np.asarray(to_habitat(place + off).astype(np.float32))

    def is_navigable(self, pt: Any, max_y_delta: float = 0.5) -> bool:
        """Whether an agent can stand at a place, its height good to `max_y_delta` m."""
        place = _from_habitat(pt, "is_navigable")
        near = self._made().nearest(place)
        if near < 0:
            return False
        off = np.abs(self._made().points[near] - place)
        return bool(off[:2].max() <= 0.5 * _CELL + 1e-6 and off[2] <= max_y_delta)

    def snap_point(self, pt: Any) -> np.ndarray:
        """(3,) the place on the floor nearest to another; NaN where there is no floor."""
        near = self._made().nearest(_from_habitat(pt, "snap_point"))
        return to_habitat(self._made().points[near]) if near >= 0 else np.full(3, np.nan)

    def island_radius(self, pt: Any) -> float:
        """Radius, m, of a circle with the area of the floor that can be walked to from a place; 0 off it."""
        if not self.is_navigable(pt):
            return 0.0
        floor = self._made()
        island = floor.island[floor.nearest(_from_habitat(pt, "island_radius"))]
        return float(np.sqrt((floor.island == island).sum() * _CELL**2 / np.pi))

    def find_path(self, path: ShortestPath) -> bool:
        """Fill in the shortest way between two places, snapped to the floor; False if there is none."""
        floor = self._made()
        ends = [
            floor.nearest(_from_habitat(end, f"ShortestPath.{name}"))
            for name, end in (("requested_start", path.requested_start), ("requested_end", path.requested_end))
        ]  # fmt: skip
        path.points, path.geodesic_distance = [], np.inf
        if min(ends) < 0 or floor.island[ends[0]] != floor.island[ends[1]]:
            return False
        corners = floor.way(*ends)
        path.points = list(to_habitat(corners))
        path.geodesic_distance = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())
        return True

    def _made(self) -> _Floor:
        if self._floor is None:
            with as_runtime_errors():
                self._floor = _Floor(self._scene, self._height, self._radius)
        return self._floor

    def _some_floor(self) -> _Floor:
        floor = self._made()
        if len(floor.points) == 0:
            raise RlrError(
                f"'{self._scene.name}' has no floor for an agent {self._height:g} m high, of radius "
                f"{self._radius:g} m; check the scene's up axis and unit"
            )
        return floor


class _Floor:
    """Cells to stand on: `points` (n, 3) m, scene axes, their middles; `island` (n,) what hangs together."""

    def __init__(self, scene: Scene, height: float, radius: float) -> None:
        self.columns: Columns = find_floors(scene.corners, _CELL, height, radius, _STEP)
        columns = self.columns
        column = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
        covered = columns.stand & ~columns.sky
        use = covered if covered.sum() * _CELL**2 >= _LEAST_INDOORS else columns.stand
        of = np.flatnonzero(use)
        row = np.full(len(use), -1)
        row[of] = np.arange(len(of))
        pairs, length = neighbours(columns, _STEP)
        kept = use[pairs].all(axis=1)
        a, b = row[pairs[kept]].T
        steps: Any = coo_array((length[kept], (a, b)), shape=(len(of),) * 2).tocsr()
        island = connected_components(steps, directed=False)[1]
        near = np.abs(columns.floor[of][:, None] - floor_heights(scene, height)).min(axis=1) <= _STEP
        served = np.isin(island, island[near])
        of, self.island, self._steps = of[served], island[served], steps[served][:, served]
        xy = np.column_stack([column[of] // columns.cells.ny, column[of] % columns.cells.ny]) + 0.5
        self.points = np.column_stack(
            [xy * _CELL + [columns.cells.x0, columns.cells.y0], columns.floor[of]]
        )
        self._tree = KDTree(self.points) if len(of) else None

    def nearest(self, place: np.ndarray) -> int:
        """Row of the cell nearest to a place (3,), -1 if there is none."""
        return -1 if self._tree is None else int(self._tree.query(place)[1])

    def way(self, start: int, end: int) -> np.ndarray:
        """(k, 3) corners of the way between two cells of an island."""
        _, before = dijkstra(
            self._steps, directed=False, indices=np.array([start]), return_predecessors=True
        )
        cells = [end]
        while cells[-1] != start:
            cells.append(int(before[0, cells[-1]]))
        chain = self.points[cells[::-1]]
        corners, at = [0], 0
        while at < len(chain) - 1:  # as far as one can walk straight, then on from there
            ahead = np.arange(at + 1, len(chain))
            pairs = np.column_stack([np.full(len(ahead), at), ahead])
            free = np.isfinite(walk_straight(self.columns, chain, pairs, _STEP))
            free[0] = True  # the next cell: on a stair its height may be beyond what counts as straight
            at = int(ahead[np.flatnonzero(free)[-1]])
            corners.append(at)
        return chain[corners]


def _from_habitat(place: Any, what: str) -> np.ndarray:
    return from_habitat(np.array(vector3(place, what)))
