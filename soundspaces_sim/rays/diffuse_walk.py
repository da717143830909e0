"""How closed the surroundings of a point are (the seed paper's pruning rule), and what lies below."""

import math

import numpy as np
from numba import prange

from soundspaces_sim.base.kernel import kernel
from soundspaces_sim.base.rng import combine, uniform
from soundspaces_sim.rays.directions import sample_cosine, sample_sphere
from soundspaces_sim.rays.geometry import cast, hit_point


@kernel(parallel=True)
def measure_closedness(geometry, points, keys, rays, bounces):
    """(N,) closed-ness and (N,) shortest initial ray of every point."""
    closed = np.zeros(len(points))
    nearest = np.full(len(points), math.inf)
    for i in prange(len(points)):
        hits = 0
        for k in range(rays):
            stream = combine(keys[i], k)
            stream, u = uniform(stream)
            stream, v = uniform(stream)
            dx, dy, dz = sample_sphere(u, v)
            ox, oy, oz = points[i]
            for bounce in range(bounces):
                t, triangle = cast(geometry, ox, oy, oz, dx, dy, dz, math.inf)
                if triangle < 0:
                    break
                hits += 1
                if bounce == 0:
                    nearest[i] = min(nearest[i], t)
                x, y, z, nx, ny, nz = hit_point(geometry, triangle, ox, oy, oz, dx, dy, dz, t)
                stream, u = uniform(stream)
                stream, v = uniform(stream)
                dx, dy, dz = sample_cosine(nx, ny, nz, u, v)
                e = geometry.epsilon
                ox, oy, oz = x + e * nx, y + e * ny, z + e * nz
        closed[i] = hits / (rays * bounces)
    return closed, nearest


@kernel
def drop(geometry, points):
    """(N,) height of the first surface straight below each point, -inf if there is none."""
    heights = np.empty(len(points))
    for i in range(len(points)):
        t, _ = cast(geometry, points[i, 0], points[i, 1], points[i, 2], 0.0, 0.0, -1.0, math.inf)
        heights[i] = points[i, 2] - t
    return heights


@kernel(parallel=True)
def blocked(geometry, points, directions):
    """(N, D) whether anything lies in each of the directions (D, 3) from each point."""
    out = np.zeros((len(points), len(directions)), np.bool_)
    for i in prange(len(points)):
        for k in range(len(directions)):
            x, y, z = points[i]
            dx, dy, dz = directions[k]
            _, triangle = cast(geometry, x, y, z, dx, dy, dz, math.inf)
            out[i, k] = triangle >= 0
    return out


@kernel(parallel=True)
def survey(geometry, points, keys, rays, bounces, materials):
    """What diffuse walks meet: hits per point and material (N, materials), rays that escaped (N,), and
    their summed length between hits (N,) m and its number (N,), the first ray of each walk left out."""
    hits = np.zeros((len(points), materials), np.int64)
    escaped = np.zeros(len(points), np.int64)
    length, count = np.zeros(len(points)), np.zeros(len(points), np.int64)
    for i in prange(len(points)):
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
                if bounce > 0:
                    length[i] += t
                    count[i] += 1
                x, y, z, nx, ny, nz = hit_point(geometry, triangle, ox, oy, oz, dx, dy, dz, t)
                stream, u = uniform(stream)
                stream, v = uniform(stream)
                dx, dy, dz = sample_cosine(nx, ny, nz, u, v)
                e = geometry.epsilon
                ox, oy, oz = x + e * nx, y + e * ny, z + e * nz
    return hits, escaped, length, count
