"""The diffuse walk that geometry alone decides (closed-ness, survey), and what lies below or around."""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.rng import combine, uniform
from soundspaces_sim.scene.rays.directions import sample_cosine, sample_sphere
from soundspaces_sim.scene.rays.geometry import Geometry, cast, hit_point


class DiffuseWalks(NamedTuple):
    """What walks from N points met; `rays` walks per point, of up to `bounces` reflections each."""

    hits: np.ndarray  # (N, materials) reflections per material
    escaped: np.ndarray  # (N,) walks that left the mesh
    length: np.ndarray  # (N,) m, summed over all segments but the first of each walk
    count: np.ndarray  # (N,) their number
    nearest: np.ndarray  # (N,) m, shortest initial ray; inf where none met anything


@kernel
def _diffuse_walks(first, last, geometry, points, keys, rays, bounces, out):
    hits, escaped, length, count, nearest = out
    for i in range(first, last):
        left, total, legs, shortest = 0, 0.0, 0, math.inf
        for k in range(rays):
            stream = combine(keys[i], k)
            stream, u = uniform(stream)
            stream, v = uniform(stream)
            dx, dy, dz = sample_sphere(u, v)
            ox, oy, oz = points[i, 0], points[i, 1], points[i, 2]
            for bounce in range(bounces):
                t, triangle = cast(geometry, ox, oy, oz, dx, dy, dz, math.inf)
                if triangle < 0:
                    left += 1
                    break
                hits[i, geometry.material[triangle]] += 1
                if bounce == 0:
                    shortest = min(shortest, t)
                else:
                    total += t
                    legs += 1
                x, y, z, nx, ny, nz = hit_point(geometry, triangle, ox, oy, oz, dx, dy, dz, t)
                stream, u = uniform(stream)
                stream, v = uniform(stream)
                dx, dy, dz = sample_cosine(nx, ny, nz, u, v)
                e = geometry.epsilon
                ox, oy, oz = x + e * nx, y + e * ny, z + e * nz
        escaped[i], length[i], count[i], nearest[i] = left, total, legs, shortest


def diffuse_walks(
    geometry: Geometry, points: np.ndarray, keys: np.ndarray, rays: int, bounces: int, materials: int
) -> DiffuseWalks:
    """Walks from (N, 3) points that leave in uniform directions and are reflected by Lambert's law.

    `materials`: number of rows that `geometry.material` refers to.
    """
    n = len(points)
    out = DiffuseWalks(
        np.zeros((n, materials), np.int64), np.zeros(n, np.int64), np.zeros(n), np.zeros(n, np.int64),
        np.full(n, np.inf),
    )  # fmt: skip
    over_rows(_diffuse_walks, n, geometry, points, keys, rays, bounces, out)
    return out


@kernel
def _drop(first, last, geometry, points, heights):
    for i in range(first, last):
        t, _ = cast(geometry, points[i, 0], points[i, 1], points[i, 2], 0.0, 0.0, -1.0, math.inf)
        heights[i] = points[i, 2] - t


def drop(geometry: Geometry, points: np.ndarray) -> np.ndarray:
    """(N,) height of the first surface straight below each point, -inf if there is none."""
    heights = np.empty(len(points))
    over_rows(_drop, len(points), geometry, points, heights)
    return heights


@kernel
def _blocked(first, last, geometry, points, directions, out):
    for i in range(first, last):
        for k in range(len(directions)):
            _, triangle = cast(
                geometry, points[i, 0], points[i, 1], points[i, 2], directions[k, 0], directions[k, 1],
                directions[k, 2], math.inf,
            )  # fmt: skip
            out[i, k] = triangle >= 0


def blocked(geometry: Geometry, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(N, D) whether anything lies in each of the directions (D, 3) from each point."""
    out = np.zeros((len(points), len(directions)), np.bool_)
    over_rows(_blocked, len(points), geometry, points, directions, out)
    return out
