"""Algebra of vectors (x, y, z), inlined into the kernels that use it.

A vector is a tuple of three floats, in whatever unit its caller uses; `row` reads one from an array. Sums run over
x, y, z in this order, and nothing is fused, so that a kernel written with these gives the bits of the same formula
written out. Lengths are Euclidean. Nothing is checked: `normalize` of a vector without length divides by zero.
"""

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import part

Vec3 = tuple[float, float, float]


@part(forceinline=True)
def row(array: np.ndarray, i: int) -> Vec3:
    """Row i of an (n, 3) array."""
    return array[i, 0], array[i, 1], array[i, 2]


@part(forceinline=True)
def put(array: np.ndarray, i: int, a: Vec3) -> None:
    """Write a to row i of an (n, 3) array."""
    array[i, 0], array[i, 1], array[i, 2] = a


@part(forceinline=True)
def add(a: Vec3, b: Vec3) -> Vec3:
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@part(forceinline=True)
def subtract(a: Vec3, b: Vec3) -> Vec3:
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@part(forceinline=True)
def scale(s: float, a: Vec3) -> Vec3:
    """s a."""
    return s * a[0], s * a[1], s * a[2]


@part(forceinline=True)
def divide(a: Vec3, s: float) -> Vec3:
    """a / s, rounded once (`scale(1 / s, a)` rounds twice)."""
    return a[0] / s, a[1] / s, a[2] / s


@part(forceinline=True)
def negate(a: Vec3) -> Vec3:
    """-a."""
    return -a[0], -a[1], -a[2]


@part(forceinline=True)
def along(origin: Vec3, t: float, direction: Vec3) -> Vec3:
    """origin + t direction: the point of a ray at its parameter t."""
    return origin[0] + t * direction[0], origin[1] + t * direction[1], origin[2] + t * direction[2]


@part(forceinline=True)
def dot(a: Vec3, b: Vec3) -> float:
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part(forceinline=True)
def cross(a: Vec3, b: Vec3) -> Vec3:
    """a × b, right-handed."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@part(forceinline=True)
def length(a: Vec3) -> float:
    """|a|."""
    return math.sqrt(dot(a, a))


@part(forceinline=True)
def distance(a: Vec3, b: Vec3) -> float:
    """|a - b|."""
    return length(subtract(a, b))


@part(forceinline=True)
def normalize(a: Vec3) -> Vec3:
    """a / |a|."""
    return divide(a, length(a))


@part(forceinline=True)
def reflect(d: Vec3, n: Vec3) -> Vec3:
    """d - 2 (d · n) n: direction d after a mirror of unit normal n."""
    k = 2.0 * dot(d, n)
    return d[0] - k * n[0], d[1] - k * n[1], d[2] - k * n[2]


@part(forceinline=True)
def orthonormal_frame(n: Vec3) -> tuple[Vec3, Vec3]:
    """Unit vectors s, t with s × t = n, of a unit vector n.

    Source: Duff et al. (2017), Building an orthonormal basis, revisited, JCGT 6 (1), listing 3.
    """
    sign = math.copysign(1.0, n[2])
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    s = (1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0])
    return s, (b, sign + n[1] * n[1] * a, -n[1])
