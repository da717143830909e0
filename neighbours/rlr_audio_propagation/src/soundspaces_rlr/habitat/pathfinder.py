"""`PathFinder`: where an agent can stand and how it walks, found in the scene's mesh; axes are habitat's."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from soundspaces_rlr.arguments import length, vector3
from soundspaces_rlr.errors import RlrError, as_runtime_errors
from soundspaces_rlr.habitat.floor import Floor, NavMeshSettings
from soundspaces_rlr.habitat.records import from_habitat, to_habitat
from soundspaces_sim import Scene

_MOST_PIXELS = 2**26


@dataclass
class ShortestPath:
    """What `find_path` is asked for and answers: (3,) ends, length in m (inf: no way), corners on the way."""

    requested_start: Any = field(default_factory=lambda: np.zeros(3))
    requested_end: Any = field(default_factory=lambda: np.zeros(3))
    geodesic_distance: float = np.inf
    points: list[np.ndarray] = field(default_factory=list)


@dataclass
class MultiGoalShortestPath:
    """`ShortestPath` to the nearest of several ends: `closest_end_point_index` is its row, -1: no way to any."""

    requested_start: Any = field(default_factory=lambda: np.zeros(3))
    requested_ends: Any = field(default_factory=list)
    geodesic_distance: float = np.inf
    closest_end_point_index: int = -1
    points: list[np.ndarray] = field(default_factory=list)


class PathFinder:
    """The floor of a scene for an agent of a height and radius, m, made when first asked of.

    It is found in the mesh: files of navigation meshes (Recast's) are not read. Floors are those of the scene's
    storeys and what can be walked to from them; so table tops are none, and roofs are none where there is floor
    below a roof. Ways go over cells of 5 cm and are then pulled straight.
    """

    def __init__(
        self, scene: Scene, height: float, radius: float, settings: NavMeshSettings | None = None
    ) -> None:
        self._scene = scene
        self.nav_mesh_settings = (
            replace(settings) if settings else NavMeshSettings(agent_height=height, agent_radius=radius)
        )
        self._floor: Floor | None = None
        self._random = np.random.default_rng(0)

    @property
    def is_loaded(self) -> bool:
        """Whether there is anywhere to stand."""
        return len(self._made().points) > 0

    @property
    def navigable_area(self) -> float:
        """Area of the floor, m²."""
        return len(self._made().points) * self._made().cell ** 2

    def remake(self, settings: NavMeshSettings) -> bool:
        """Find the floor anew for an agent and cells of other sizes; whether there is any."""
        self.nav_mesh_settings = replace(settings)
        self._floor = None
        return self.is_loaded

    def load_nav_mesh(self, path: str) -> bool:
        """Habitat's way to a navigation mesh; the file is not read, the scene's own floor serves."""
        del path
        return self.is_loaded

    def seed(self, new_seed: int) -> None:
        """Seed `get_random_navigable_point`."""
        self._random = np.random.default_rng(new_seed)

    def get_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest coordinates of the floor, (3,) each."""
        floor = self._some_floor()
        points = to_habitat(floor.points)
        half = np.array([0.5, 0.0, 0.5]) * floor.cell
        return points.min(axis=0) - half, points.max(axis=0) + half

    def get_random_navigable_point(self, max_tries: int = 10) -> np.ndarray:
        """(3,) place on the floor, evenly distributed over it; `max_tries` is habitat's."""
        del max_tries
        floor = self._some_floor()
        return self._random_place(floor, int(self._random.integers(len(floor.points))))

    def get_random_navigable_point_near(
        self, circle_center: Any, radius: float, max_tries: int = 100
    ) -> np.ndarray:
        """(3,) place on the floor within `radius` m of another; NaN where there is none."""
        place = _from_habitat(circle_center, "get_random_navigable_point_near")
        floor = self._made()
        cells = floor.near(place, length(radius, "get_random_navigable_point_near: radius"))
        for _ in range(max_tries if len(cells) else 0):
            found = self._random_place(floor, int(cells[self._random.integers(len(cells))]))
            if np.linalg.norm(_from_habitat(found, "") - place) <= radius:
                return found
        return np.full(3, np.nan)

    def _random_place(self, floor: Floor, row: int) -> np.ndarray:
        off = np.append(self._random.uniform(-0.5, 0.5, 2) * 0.99 * floor.cell, 0.0)
        return to_habitat(floor.points[row] + off)

    def is_navigable(self, pt: Any, max_y_delta: float = 0.5) -> bool:
        """Whether an agent can stand at a place, its height good to `max_y_delta` m."""
        place = _from_habitat(pt, "is_navigable")
        return bool(self._made().holds(place[None], length(max_y_delta, "max_y_delta"))[0])

    def get_topdown_view(self, meters_per_pixel: float, height: float, eps: float = 0.5) -> np.ndarray:
        """(rows along z, columns along x) bool: where one can stand, at floors within `eps` m of `height`, over the
        bounds of the floor. Raises `RlrError`."""
        low, high = self.get_bounds()
        size = (
            np.floor((high - low)[[2, 0]] / meters_per_pixel) if meters_per_pixel > 0.0 else np.zeros(2)
        )
        if not (size.min() >= 1 and size.prod() <= _MOST_PIXELS):
            raise RlrError(
                f"get_topdown_view: meters_per_pixel: expected a length that gives 1 to {_MOST_PIXELS} pixels, got "
                f"{meters_per_pixel!r}"
            )
        z, x = (
            np.arange(int(n)) * meters_per_pixel + first
            for n, first in zip(size, low[[2, 0]], strict=True)
        )
        if not np.isfinite(float(height)):
            raise RlrError(f"get_topdown_view: height: expected a finite number, got {height!r}")
        places = np.stack(np.broadcast_arrays(x, float(height), z[:, None]), axis=-1)
        held = self._made().holds(from_habitat(places.reshape(-1, 3)), length(eps, "eps"))
        return held.reshape(places.shape[:2])

    def try_step(self, start: Any, end: Any) -> np.ndarray:
        """(3,) where one gets to from a place on a step to another; along a wall as far as that leads nearer."""
        return self._step(start, end, sliding=True)

    def try_step_no_sliding(self, start: Any, end: Any) -> np.ndarray:
        """(3,) where one gets to from a place on a straight step to another, up to the first wall."""
        return self._step(start, end, sliding=False)

    def _step(self, start: Any, end: Any, sliding: bool) -> np.ndarray:
        a, b = _from_habitat(start, "try_step"), _from_habitat(end, "try_step")
        floor = self._made()
        if floor.nearest(a) < 0:
            return to_habitat(a)
        if not floor.holds(a[None], floor.climb)[0]:
            a = floor.points[floor.nearest(a)]
        return to_habitat(floor.slid(a, b) if sliding else floor.straight(a, b))

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
        return float(np.sqrt((floor.island == island).sum() * floor.cell**2 / np.pi))

    def find_path(self, path: ShortestPath | MultiGoalShortestPath) -> bool:
        """Fill in the shortest way between two places, or from one to the nearest of several, snapped to the floor;
        False if there is none."""
        if isinstance(path, MultiGoalShortestPath):
            ends, name = path.requested_ends, "MultiGoalShortestPath.requested_ends"
        else:
            ends, name = [path.requested_end], "ShortestPath.requested_end"
        goals = [_from_habitat(end, name) for end in ends]
        start = _from_habitat(path.requested_start, f"{type(path).__name__}.requested_start")
        best, corners = self._made().nearest_way(start, goals)
        path.points = list(to_habitat(corners))
        path.geodesic_distance = np.inf
        if isinstance(path, MultiGoalShortestPath):
            path.closest_end_point_index = best
        if best >= 0:
            path.geodesic_distance = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())
        return best >= 0

    def _made(self) -> Floor:
        if self._floor is None:
            with as_runtime_errors():
                self._floor = Floor(self._scene, self.nav_mesh_settings)
        return self._floor

    def _some_floor(self) -> Floor:
        floor = self._made()
        if len(floor.points) == 0:
            size = self.nav_mesh_settings
            raise RlrError(
                f"'{self._scene.name}' has no floor for an agent {size.agent_height:g} m high, of radius "
                f"{size.agent_radius:g} m; check the scene's up axis and unit"
            )
        return floor


def _from_habitat(place: Any, what: str) -> np.ndarray:
    return from_habitat(np.array(vector3(place, what)))
