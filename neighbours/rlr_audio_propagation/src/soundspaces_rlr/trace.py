"""Single rays into a scene."""

from __future__ import annotations

import numpy as np

from soundspaces_rlr.arguments import vector3
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.kernels import probe
from soundspaces_rlr.records import Ray
from soundspaces_sim import Scene


def first_hit(scene: Scene | None, ray: Ray, unit: float) -> tuple[float, list[float]] | None:
    """Where a ray first meets a surface: (t in lengths of its direction, unit normal that faces it), or
    None. Raises `RlrError` for a ray without direction."""
    origin = unit * np.array(vector3(ray.origin, "Ray.origin"))
    direction = unit * np.array(vector3(ray.direction, "Ray.direction"))
    length = float(np.linalg.norm(direction))
    if not length > 0.0:
        raise RlrError(f"Ray.direction: expected a vector with a length, got {ray.direction!r}")
    if scene is None:
        return None
    start = origin + ray.t_min * direction - scene.center
    reach = (ray.t_max - ray.t_min) * length
    if not reach > 0.0:
        return None
    distance, triangle = probe(scene.geometry, start, direction / length, reach)
    if triangle < 0:
        return None
    normal = scene.normals[triangle]
    facing = normal if normal @ direction < 0.0 else -normal
    return ray.t_min + distance / length, [float(v) for v in facing]
