"""Which specular planes are in sight of an edge, found when it is first asked for: a place that sees an edge by a
plane sees a plane that the edge sees."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray
from soundspaces_sim.transport.diffraction.image_wedges import tried_points
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.diffraction.wedges import Wedges, clear_point
from soundspaces_sim.transport.image_source.prepared import prepare_planes
from soundspaces_sim.transport.image_source.sequences import ray_direction
from soundspaces_sim.transport.model import Model

_RAYS = 1024  # from each of an edge's points that images try: planes of which it sees 0.02 sr or more


class EdgePlanes(NamedTuple):
    """Of E edges, filled on the way."""

    known: np.ndarray  # (E,)
    sees: np.ndarray  # (E, P) whether rays from an edge meet a plane


def edge_planes(model: Model) -> EdgePlanes:
    """Nothing known: `model.once(edge_planes)`, which one thread may use."""
    edges = len(model.prepared.part(prepare_wedges).wedges.length)
    planes = len(model.prepared.part(prepare_planes).offset)
    return EdgePlanes(np.zeros(edges, np.bool_), np.zeros((edges, planes), np.bool_))


@part
def edge_sees_plane(found: EdgePlanes, geometry: Geometry, wedges: Wedges, e: int, a: int) -> bool:
    """Whether rays from edge e meet plane a."""
    if not found.known[e]:
        count = tried_points(wedges, e)
        for k in range(count):
            p = clear_point(wedges, e, (k + 0.5) / count * wedges.length[e])
            for ray in range(_RAYS):
                _, triangle = cast_ray(geometry, p, ray_direction(ray, _RAYS), math.inf)
                if triangle >= 0 and geometry.plane[triangle] >= 0:
                    found.sees[e, geometry.plane[triangle]] = True
        found.known[e] = True
    return found.sees[e, a]
