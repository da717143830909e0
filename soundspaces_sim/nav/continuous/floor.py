"""The floor of a storey as an agent walks it: anywhere, not from point to point."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from soundspaces_sim.core.config import GraphConfig
from soundspaces_sim.core.errors import PointError
from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.nav.continuous.distances import CELL, DistanceField, Lattice, fill_distances
from soundspaces_sim.nav.continuous.obstacles import (
    SKIN,
    are_free,
    least_clearances,
    make_obstacles,
    move_disc,
)
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray
from soundspaces_sim.scene.scene import Scene


class Floor:
    """A level floor at `height` m of a scene, for the agent of a `GraphConfig`: its radius, its height, the highest
    step it takes. What lies between that step and its height is an obstacle.

    An agent is a disc. `move` finds contacts exactly; a move whose end has no floor within a step below is refused.
    """

    def __init__(self, scene: Scene, height: float, agent: GraphConfig) -> None:
        self.scene, self.height, self.agent = scene, height, agent
        self.obstacles = make_obstacles(
            scene.corners, height + agent.step, height + agent.height, agent.radius
        )
        self.distances = lru_cache(maxsize=256)(self._distances)
        self._pose, self._way = np.empty(2), np.empty(2)

    def move(self, x: float, y: float, dx: float, dy: float, slide: bool) -> tuple[float, float, bool]:
        """Where a step by (dx, dy) m ends, and whether it touched something or lacked a floor."""
        self._pose[:], self._way[:] = (x, y), (dx, dy)
        collided = bool(move_disc(self.obstacles, self._pose, self._way, slide))
        if not self.is_floor(self._pose[None])[0]:
            return x, y, True
        return float(self._pose[0]), float(self._pose[1]), collided

    def is_floor(self, places: np.ndarray) -> np.ndarray:
        """(N,) whether there is a floor within a step of this one at (N, 2) m."""
        below = np.empty((len(places), 3))
        below[:, :2], below[:, 2] = places, self.height + self.agent.step
        out = np.empty(len(places), np.bool_)
        _meets_below(self.scene.geometry, below - self.scene.center, 2.0 * self.agent.step + SKIN, out)
        return out

    def can_stand(self, places: np.ndarray) -> np.ndarray:
        """(N,) whether an agent can stand at (N, 2) m."""
        free = np.empty(len(places))
        least_clearances(self.obstacles, np.ascontiguousarray(places, float), free)
        return np.asarray((free >= self.agent.radius - SKIN) & self.is_floor(places))

    def check(self, x: float, y: float, what: str) -> None:
        """Raise `PointError` unless an agent can stand at (x, y)."""
        if not (math.isfinite(x) and math.isfinite(y)):
            raise PointError(f"{what}: expected finite coordinates in m, got ({x}, {y})")
        if not self.can_stand(np.array([[x, y]]))[0]:
            raise PointError(
                f"{what}: an agent of radius {self.agent.radius:g} m cannot stand at ({x:.3f}, {y:.3f}) m of "
                f"{self.scene.name}; choose a place farther from walls and furniture, on the floor at "
                f"{self.height:.2f} m"
            )

    def free_ways(self, ways: np.ndarray) -> np.ndarray:
        """(N,) whether an agent can walk straight along (N, 4) x0, y0, x1, y1, m."""
        out = np.empty(len(ways), np.bool_)
        are_free(self.obstacles, np.ascontiguousarray(ways, float), out)
        return out

    def _distances(self, x: float, y: float) -> DistanceField:
        """Walking distances to (x, y) from anywhere; kept for the last 256 places. Raises `PointError`."""
        self.check(x, y, "goal")
        return fill_distances(self.obstacles, self.lattice(), (x, y))

    def lattice(self) -> Lattice:
        """Where an agent can stand, in cells; made when first asked for."""
        if not hasattr(self, "_standing"):
            low, high = self.scene.bounds[:, :2]
            shape = np.ceil((high - low) / CELL).astype(int) + 1
            i, j = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
            places = low + CELL * np.stack([i.ravel(), j.ravel()], axis=1)
            self._standing = Lattice(low.copy(), self.can_stand(places).reshape(shape))
        return self._standing


@kernel
def _meets_below(geometry: Geometry, places: np.ndarray, reach: float, out: np.ndarray) -> None:
    """Fill `out` (N,): whether a ray downwards from places (N, 3) meets a surface within `reach` m."""
    for k in range(len(places)):
        origin = places[k, 0], places[k, 1], places[k, 2]
        out[k] = cast_ray(geometry, origin, (0.0, 0.0, -1.0), reach)[1] >= 0
