"""How closed the surroundings of a point are, and whether it lies inside a scene."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from soundspaces_sim.core.errors import PointError
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.scene.rays.diffuse_walk import diffuse_walks
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.scene.rays.placing import depth_of_bodies, off_faces
from soundspaces_sim.scene.scene import Scene, check_scene
from soundspaces_sim.scene.windings import outward_sides

ENCLOSED = 0.5  # closed-ness of a place that is indoors
DEEPEST = 0.6  # m, of bodies without air: what sound passes as one element
_OPEN = 0.1  # the seed paper's limit for patios: anything below is outdoors by any standard


def closedness(
    scene: Scene,
    points: np.ndarray,
    rays: int = 1000,
    bounces: int = 10,
    geometry: Geometry | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Closed-ness (N,) in [0, 1] of (N, 3) points and distance (N,) m to the nearest geometry seen; `geometry`: the
    scene's, or its `plain_geometry`."""
    points = np.ascontiguousarray(points, float)
    one_material = (geometry or scene.geometry)._replace(
        material=np.zeros((len(scene.faces), 2), np.int64)
    )
    walks = diffuse_walks(one_material, points - scene.center, point_keys(points, 0), rays, bounces, 1)
    return walks.hits[:, 0] / (rays * bounces), walks.nearest


@lru_cache(maxsize=8)
def _geometry_with_sides(scene: _Hashed) -> Geometry:
    return scene.scene.geometry._replace(outward=outward_sides(scene.scene))


def _check_in_air(scene: Scene, points: np.ndarray, what: str) -> None:
    """Raise `PointError` for points in bodies. A scene that is not larger than one is a model of a room."""
    if (scene.bounds[1] - scene.bounds[0]).min() <= 2.0 * DEEPEST:
        return
    # Windings take time in a large scene, and few points are close to faces on all sides.
    local = points - scene.center
    near = np.isfinite(depth_of_bodies(scene.geometry, local, DEEPEST, sided=False))
    if not near.any():
        return
    depth = depth_of_bodies(_geometry_with_sides(_Hashed(scene)), local[near], DEEPEST)
    if np.isfinite(depth).any():
        i = int(np.flatnonzero(near)[np.isfinite(depth)][0])
        deep = float(depth[np.isfinite(depth)][0])
        raise PointError(
            f"{what}: point {i} at ({points[i, 0]:.3f}, {points[i, 1]:.3f}, {points[i, 2]:.3f}) m is inside "
            f"a body of the scene '{scene.name}' that is {deep:.2f} m deep there, and holds no air; move it, or "
            "open the mesh there"
        )


@lru_cache(maxsize=8)
def _is_enclosure(scene: _Hashed) -> bool:
    low, high = scene.scene.bounds
    steps = (np.arange(4) + 0.5) / 4.0
    inner = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    closed, _ = closedness(scene.scene, low + inner * (high - low), 64, 10)
    return bool((closed >= ENCLOSED).mean() > 0.2)


@dataclass(frozen=True)
class _Hashed:
    """A scene under the hash of its content."""

    scene: Scene

    def __hash__(self) -> int:
        return hash(self.scene.digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Hashed) and other.scene.digest == self.scene.digest


def check_inside(scene: Scene, points: np.ndarray, what: str) -> None:
    """Raise `PointError` for points in bodies, and for points outside a scene that encloses a space.

    A body is what sound passes as one building element: there is no air in it. Outside means beyond its bounding
    box, or in surroundings less closed than even a patio's (0.1).
    A scene that encloses nothing (a lone wall, a facade) has no outside.
    """
    points = off_faces(scene.geometry, points - scene.center) + scene.center
    _check_in_air(scene, points, what)
    if not _is_enclosure(_Hashed(scene)):
        return
    low, high = scene.bounds
    beyond = ((points < low - 1e-3) | (points > high + 1e-3)).any(axis=1)
    if not beyond.any():
        beyond = closedness(scene, points, 256, 10)[0] < _OPEN
    if beyond.any():
        i = int(beyond.argmax())
        raise PointError(
            f"{what}: point {i} at ({points[i, 0]:.3f}, {points[i, 1]:.3f}, {points[i, 2]:.3f}) m is "
            f"outside the scene '{scene.name}', which spans ({low[0]:.2f}, {low[1]:.2f}, {low[2]:.2f}) "
            f"to ({high[0]:.2f}, {high[1]:.2f}, {high[2]:.2f}) m"
        )


def check_ends(scene: Scene, sources: np.ndarray, listeners: np.ndarray) -> None:
    """Raise `SceneError` for what is no scene, and `PointError` for sources or listeners outside of it."""
    check_scene(scene)
    for points, what in ((sources, "sources"), (listeners, "listeners")):
        check_inside(scene, points, what)
