"""Directions: each `sample_x` has its `pdf_x` (per steradian) beside it."""

import math

from soundspaces_sim.core.numerics.kernel import part

INV_4PI = 1.0 / (4.0 * math.pi)
INV_PI = 1.0 / math.pi

# Plastic-number sequence (Roberts 2018): a low-discrepancy additive recurrence in two dimensions.
_R2_1 = 0.7548776662466927
_R2_2 = 0.5698402909980532


@part
def sample_sphere(u, v):
    """Uniform direction on the unit sphere from two uniform numbers."""
    z = 1.0 - 2.0 * u
    r = math.sqrt(max(0.0, 1.0 - z * z))
    phi = 2.0 * math.pi * v
    return r * math.cos(phi), r * math.sin(phi), z


@part
def pdf_sphere():
    return INV_4PI


@part
def stratified_pair(index, shift_u, shift_v):
    """Point `index` of the R2 sequence under a random shift modulo 1 (each point is uniform)."""
    u = shift_u + (index + 1) * _R2_1
    v = shift_v + (index + 1) * _R2_2
    return u - math.floor(u), v - math.floor(v)


@part(forceinline=True)
def frame(nx, ny, nz):
    """Two unit tangents of a unit normal (Duff et al. 2017)."""
    sign = math.copysign(1.0, nz)
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    return (1.0 + sign * nx * nx * a, sign * b, -sign * nx), (b, sign + ny * ny * a, -ny)


@part(forceinline=True)
def sample_cosine(nx, ny, nz, u, v):
    """Cosine-weighted direction about the unit normal `n` (Lambert)."""
    r = math.sqrt(u)
    phi = 2.0 * math.pi * v
    x, y, z = r * math.cos(phi), r * math.sin(phi), math.sqrt(max(0.0, 1.0 - u))
    (sx, sy, sz), (tx, ty, tz) = frame(nx, ny, nz)
    return x * sx + y * tx + z * nx, x * sy + y * ty + z * ny, x * sz + y * tz + z * nz


@part
def pdf_cosine(cos_theta):
    return max(0.0, cos_theta) * INV_PI


@part(forceinline=True)
def reflect(dx, dy, dz, nx, ny, nz):
    """Mirror direction of an incoming direction `d` at a plane of unit normal `n`."""
    k = 2.0 * (dx * nx + dy * ny + dz * nz)
    return dx - k * nx, dy - k * ny, dz - k * nz
