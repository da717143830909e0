"""Diffusely reflected paths that geometry alone decides, and what lies below and around points.

They measure whether a mesh is closed, its mean free path (4 V / S; Kuttruff, Room Acoustics, 5.2) and which
materials are met, before any acoustics: every reflection is Lambert's, nothing is absorbed.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.rng import combine, uniform
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.scene.rays.directions import sample_cosine_hemisphere, sample_sphere
from soundspaces_sim.scene.rays.geometry import Geometry, before, cast_ray, intersect


class DiffuseWalks(NamedTuple):
    """What `rays` paths from each of N points met, of up to `bounces` reflections each."""

    hits: np.ndarray  # (N, materials) reflections per material
    escaped: np.ndarray  # (N,) paths that left the mesh
    length: np.ndarray  # (N,) m, summed over all segments but the first of each path
    count: np.ndarray  # (N,) their number
    nearest: np.ndarray  # (N,) m, shortest initial ray; inf where none met anything


class _Paths(NamedTuple):
    """How many paths leave every point, and how often each is reflected."""

    rays: int
    bounces: int


@kernel
def _diffuse_walks(
    first: int,
    last: int,
    geometry: Geometry,
    points: np.ndarray,
    keys: np.ndarray,
    paths: _Paths,
    out: DiffuseWalks,
) -> None:
    """Fill rows `first` to `last` of `out` from (N, 3) points and the (N,) keys of their random streams."""
    for i in range(first, last):
        escaped, total, segments, nearest = 0, 0.0, 0, math.inf
        for k in range(paths.rays):
            stream = combine(keys[i], k)
            stream, u = uniform(stream)
            stream, v = uniform(stream)
            direction = sample_sphere(u, v)
            origin = row(points, i)
            for bounce in range(paths.bounces):
                hit = intersect(geometry, origin, direction, math.inf)
                if hit.triangle < 0:
                    escaped += 1
                    break
                out.hits[i, hit.material] += 1
                if bounce == 0:
                    nearest = min(nearest, hit.distance)
                else:
                    total += hit.distance
                    segments += 1
                stream, u = uniform(stream)
                stream, v = uniform(stream)
                origin = before(geometry, hit, direction)
                direction = sample_cosine_hemisphere(hit.normal, u, v)
        out.escaped[i], out.length[i], out.count[i], out.nearest[i] = escaped, total, segments, nearest


def diffuse_walks(
    geometry: Geometry, points: np.ndarray, keys: np.ndarray, rays: int, bounces: int, materials: int
) -> DiffuseWalks:
    """Paths from (N, 3) points that leave in uniform directions and are reflected by Lambert's law.

    `materials`: number of rows that `geometry.material` refers to.
    """
    n = len(points)
    out = DiffuseWalks(
        hits=np.zeros((n, materials), np.int64),
        escaped=np.zeros(n, np.int64),
        length=np.zeros(n),
        count=np.zeros(n, np.int64),
        nearest=np.full(n, np.inf),
    )
    over_rows(_diffuse_walks, n, geometry, points, keys, _Paths(rays, bounces), out)
    return out


@kernel
def _drop(first: int, last: int, geometry: Geometry, points: np.ndarray, heights: np.ndarray) -> None:
    for i in range(first, last):
        t, _ = cast_ray(geometry, row(points, i), (0.0, 0.0, -1.0), math.inf)
        heights[i] = points[i, 2] - t


def drop(geometry: Geometry, points: np.ndarray) -> np.ndarray:
    """(N,) height of the first surface straight below each point, -inf if there is none."""
    heights = np.empty(len(points))
    over_rows(_drop, len(points), geometry, points, heights)
    return heights


@kernel
def _blocked(
    first: int,
    last: int,
    geometry: Geometry,
    points: np.ndarray,
    directions: np.ndarray,
    out: np.ndarray,
) -> None:
    for i in range(first, last):
        for k in range(len(directions)):
            _, triangle = cast_ray(geometry, row(points, i), row(directions, k), math.inf)
            out[i, k] = triangle >= 0


def blocked(geometry: Geometry, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(N, D) whether anything lies in each of the directions (D, 3) from each point."""
    out = np.zeros((len(points), len(directions)), np.bool_)
    over_rows(_blocked, len(points), geometry, points, directions, out)
    return out
