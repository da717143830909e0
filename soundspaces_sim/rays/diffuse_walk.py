"""The diffuse walk that geometry alone decides (closed-ness, survey), and what lies below or around."""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.base.kernel import kernel, over_rows
from soundspaces_sim.base.rng import combine, uniform
from soundspaces_sim.rays.directions import sample_cosine, sample_sphere
from soundspaces_sim.rays.geometry import cast, hit_point


class DiffuseWalks(NamedTuple):
    """What walks from N points met; `rays` walks per point, of up to `bounces` reflections each."""

    hits: np.ndarray  # (N, materials) reflections per material
    escaped: np.ndarray  # (N,) walks that left the mesh
    length: np.ndarray  # (N,) m, summed over all segments but the first of each walk
    count: np.ndarray  # (N,) their number
    nearest: np.ndarray  # (N,) m, shortest initial ray; inf where none met anything


def diffuse_walks(geometry, points, keys, rays, bounces, materials):
    """Walks from (N, 3) points that leave in uniform directions and are reflected by Lambert's law:
    `DiffuseWalks`. `materials`: number of rows that `geometry.material` refers to."""
    n = len(points)
    walks = DiffuseWalks(
        np.zeros((n, materials), np.int64), np.zeros(n, np.int64), np.zeros(n), np.zeros(n, np.int64),
        np.full(n, math.inf),
    )  # fmt: skip
    over_rows(_walk, n, geometry, points, keys, rays, bounces, walks)
    return walks


@kernel
def _walk(first, last, geometry, points, keys, rays, bounces, walks):
    hits, escaped, length, count, nearest = walks
    for i in range(first, last):
        for k in range(rays):
            stream = combine(keys[i], k)
            stream, u = uniform(stream)
            stream, v = uniform(stream)
            dx, dy, dz = sample_sphere(u, v)
            ox, oy, oz = points[i]
            for bounce in range(bounces):
                t, triangle = cast(geometry, ox, oy, oz, dx, dy, dz, math.inf)
                if triangle < 0:
                    escaped[i] += 1
                    break
                hits[i, geometry.material[triangle]] += 1
                if bounce == 0:
                    nearest[i] = min(nearest[i], t)
                else:
                    length[i] += t
                    count[i] += 1
                x, y, z, nx, ny, nz = hit_point(geometry, triangle, ox, oy, oz, dx, dy, dz, t)
                stream, u = uniform(stream)
                stream, v = uniform(stream)
                dx, dy, dz = sample_cosine(nx, ny, nz, u, v)
                e = geometry.epsilon
                ox, oy, oz = x + e * nx, y + e * ny, z + e * nz


@kernel
def drop(geometry, points):
    """(N,) height of the first surface straight below each point, -inf if there is none."""
    heights = np.empty(len(points))
    for i in range(len(points)):
        t, _ = cast(geometry, points[i, 0], points[i, 1], points[i, 2], 0.0, 0.0, -1.0, math.inf)
        heights[i] = points[i, 2] - t
    return heights


def blocked(geometry, points, directions):
    """(N, D) whether anything lies in each of the directions (D, 3) from each point."""
    out = np.zeros((len(points), len(directions)), np.bool_)
    over_rows(_look, len(points), geometry, points, directions, out)
    return out


@kernel
def _look(first, last, geometry, points, directions, out):
    for i in range(first, last):
        for k in range(len(directions)):
            x, y, z = points[i]
            dx, dy, dz = directions[k]
            _, triangle = cast(geometry, x, y, z, dx, dy, dz, math.inf)
            out[i, k] = triangle >= 0
