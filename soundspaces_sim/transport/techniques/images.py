"""Early mirror reflections: paths of one or two mirrors at grouped planes, one arrival each.

The sequences of planes worth trying for a point are those that a dense, deterministic set of rays from
it really meets; for a pair, the sequences seen from either end. Each is then solved by images, checked
by real rays, and recorded with its exact delay and direction. Specular walks leave exactly this class of
paths out, so nothing is counted twice.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from soundspaces_sim.base.kernel import kernel
from soundspaces_sim.rays.directions import INV_4PI, reflect, sample_sphere
from soundspaces_sim.rays.geometry import cast, hit_point, visible
from soundspaces_sim.transport.surface import MIRROR

ORDER = 2  # longer mirror paths are left to `specular`
_RAYS = 8192
_GOLDEN = 0.6180339887498949


class Mirrors(NamedTuple):
    """The planes as kernels see them, relative to the scene's centre."""

    normal: np.ndarray  # (P, 3)
    offset: np.ndarray  # (P,) m
    margin: np.ndarray  # (P,) m


@kernel
def _mirror_plane(geometry, surfaces, triangle):
    """Plane of a triangle that mirrors sound in any band, else -1."""
    material = geometry.material[triangle]
    for band in range(surfaces.energy.shape[2]):
        if surfaces.energy[material, MIRROR, band] > 0.0:
            return geometry.plane[triangle]
    return -1


@kernel(parallel=True)
def find_sequences(geometry, surfaces, mirrors, points):
    """(N, P, P + 1) flags: from point i, rays meet plane a alone ([a, P]) or a and then b ([a, b])."""
    planes = len(mirrors.offset)
    seen = np.zeros((len(points), planes, planes + 1), np.bool_)
    for i in prange(len(points)):
        if planes == 0:
            continue
        px, py, pz = points[i]
        for k in range(_RAYS):
            v = k * _GOLDEN
            dx, dy, dz = sample_sphere((k + 0.5) / _RAYS, v - math.floor(v))
            t, triangle = cast(geometry, px, py, pz, dx, dy, dz, math.inf)
            if triangle < 0:
                continue
            a = _mirror_plane(geometry, surfaces, triangle)
            if a < 0:
                continue
            seen[i, a, planes] = True
            x, y, z, nx, ny, nz = hit_point(geometry, triangle, px, py, pz, dx, dy, dz, t)
            lift = geometry.epsilon + mirrors.margin[a]
            x, y, z = x + lift * nx, y + lift * ny, z + lift * nz
            nx, ny, nz = mirrors.normal[a]
            dx, dy, dz = reflect(dx, dy, dz, nx, ny, nz)
            t, triangle = cast(geometry, x, y, z, dx, dy, dz, math.inf)
            if triangle < 0:
                continue
            b = _mirror_plane(geometry, surfaces, triangle)
            if b >= 0 and b != a:
                seen[i, a, b] = True
    return seen


@kernel
def _side(mirrors, a, x, y, z):
    n = mirrors.normal[a]
    return n[0] * x + n[1] * y + n[2] * z - mirrors.offset[a]


@kernel
def _image(mirrors, a, x, y, z):
    k = 2.0 * _side(mirrors, a, x, y, z)
    n = mirrors.normal[a]
    return x - k * n[0], y - k * n[1], z - k * n[2]


@kernel
def _crossing(mirrors, a, image, q):
    """Point of plane a on the line from an image to q, or a negative first value if not between."""
    s_image, s_q = -_side(mirrors, a, *image), _side(mirrors, a, *q)
    if s_image * s_q <= 0.0:  # the image lies on the far side, so equal signs mean the same side
        return False, (0.0, 0.0, 0.0)
    t = s_image / (s_image + s_q)
    return True, (
        image[0] + t * (q[0] - image[0]),
        image[1] + t * (q[1] - image[1]),
        image[2] + t * (q[2] - image[2]),
    )


@kernel
def _bounce(geometry, mirrors, a, origin, target):
    """Cast a ray at a reflection point: (triangle, point lifted off the plane) if plane a is there."""
    dx, dy, dz = target[0] - origin[0], target[1] - origin[1], target[2] - origin[2]
    r = math.sqrt(dx * dx + dy * dy + dz * dz)
    if r <= 0.0:
        return -1, target
    dx, dy, dz = dx / r, dy / r, dz / r
    t, triangle = cast(geometry, origin[0], origin[1], origin[2], dx, dy, dz, math.inf)
    if triangle < 0 or geometry.plane[triangle] != a:
        return -1, target
    x, y, z, nx, ny, nz = hit_point(geometry, triangle, *origin, dx, dy, dz, t)
    lift = geometry.epsilon + mirrors.margin[a]
    return triangle, (x + lift * nx, y + lift * ny, z + lift * nz)


@kernel
def solve(geometry, surfaces, mirrors, a, b, p, q, row):
    """One sequence for one pair: True and `row` filled if the path exists.

    `row`: length, direction of arrival at q, at p (unit vectors from the end outward), energy per band
    without air. b = -1 for a single mirror.
    """
    image = _image(mirrors, a, *p)
    if b < 0:
        last = image
        ok, x = _crossing(mirrors, a, image, q)
        if not ok:
            return False
        y = x
    else:
        last = _image(mirrors, b, *image)
        ok, y = _crossing(mirrors, b, last, q)
        if not ok:
            return False
        ok, x = _crossing(mirrors, a, image, y)
        if not ok:
            return False
    triangle_a, lifted = _bounce(geometry, mirrors, a, p, x)
    if triangle_a < 0:
        return False
    triangle_b = triangle_a
    if b >= 0:
        triangle_b, lifted = _bounce(geometry, mirrors, b, lifted, y)
        if triangle_b < 0:
            return False
    if not visible(geometry, lifted[0], lifted[1], lifted[2], q[0], q[1], q[2]):
        return False

    length2 = (last[0] - q[0]) ** 2 + (last[1] - q[1]) ** 2 + (last[2] - q[2]) ** 2
    row[0] = math.sqrt(length2)
    to_y = math.sqrt((y[0] - q[0]) ** 2 + (y[1] - q[1]) ** 2 + (y[2] - q[2]) ** 2)
    to_x = math.sqrt((x[0] - p[0]) ** 2 + (x[1] - p[1]) ** 2 + (x[2] - p[2]) ** 2)
    for axis in range(3):
        row[1 + axis] = (y[axis] - q[axis]) / to_y
        row[4 + axis] = (x[axis] - p[axis]) / to_x
    for band in range(surfaces.energy.shape[2]):
        energy = surfaces.energy[geometry.material[triangle_a], MIRROR, band]
        if b >= 0:
            energy *= surfaces.energy[geometry.material[triangle_b], MIRROR, band]
        row[7 + band] = energy * INV_4PI / length2
    return True


@kernel(parallel=True)
def mirror_paths(
    geometry,
    surfaces,
    mirrors,
    p,
    p_sequences,
    p_seen,
    points,
    partners,
    q_start,
    q_sequences,
    swap,
):
    """Early mirror paths from one point to several.

    `p_sequences` (K, 2) of the point, `p_seen` its flags; rows q_start[j]:q_start[j + 1] of
    `q_sequences` belong to point j. `swap[k]`: solve from the partner's side, so that a pair gives the
    same bits whichever end is asked.
    Returns rows (partners, slots, 9 + b) and flags (partners, slots): planes as seen from p, then
    the columns of `solve` with q the partner.
    """
    slots = 0
    for k in range(len(partners)):
        j = partners[k]
        slots = max(slots, len(p_sequences) + q_start[j + 1] - q_start[j])
    bands = surfaces.energy.shape[2]
    rows = np.empty((len(partners), slots, 9 + bands))
    found = np.zeros((len(partners), slots), np.bool_)
    planes = len(mirrors.offset)
    for k in prange(len(partners)):
        j = partners[k]
        q = (points[j, 0], points[j, 1], points[j, 2])
        own = len(p_sequences)
        for s in range(own + q_start[j + 1] - q_start[j]):
            if s < own:
                a, b = p_sequences[s]
            else:
                first, second = q_sequences[q_start[j] + s - own]
                a, b = (first, -1) if second < 0 else (second, first)
                if p_seen[a, b if b >= 0 else planes]:
                    continue  # already tried from p's own list
            row = rows[k, s]
            row[0], row[1] = a, b
            if swap[k]:
                c, d = (a, b) if b < 0 else (b, a)
                found[k, s] = solve(geometry, surfaces, mirrors, c, d, q, p, row[2:])
                for axis in range(3):  # arrival at q and at p change places
                    row[3 + axis], row[6 + axis] = row[6 + axis], row[3 + axis]
            else:
                found[k, s] = solve(geometry, surfaces, mirrors, a, b, p, q, row[2:])
    return rows, found
