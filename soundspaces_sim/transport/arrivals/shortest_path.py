"""The shortest path from a point to another by way of two lines."""

from __future__ import annotations

import math

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, dot, length, row, subtract
from soundspaces_sim.transport.arrivals.wedges import Wedges, edge_point, line_coordinates, parallel

_MAX_STEPS = 60  # of Newton's method; it ends sooner
_CONVERGED = 1e-7  # m, the last step
_LEAST_SHARE = 1e-9  # of a step
_ROUNDING = 1e-14  # of a length
_MIN_LENGTH = 1e-6  # m, of a leg
_SWEEPS = 2  # by which the path is first found roughly, one edge after the other
_FAR = 1.0  # m and a length, beyond an end: a path that is there roughly is left out


@part(forceinline=True)
def _length_by(wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3, z: tuple[float, float]) -> float:
    """Of the path from p by z[0] on the line of e and z[1] on that of f to q, m."""
    at_e, at_f = edge_point(wedges, e, z[0]), edge_point(wedges, f, z[1])
    return distance(p, at_e) + distance(at_e, at_f) + distance(at_f, q)


@part
def _newton_step(
    wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3, z: tuple[float, float]
) -> tuple[float, float]:
    """Newton's step towards the least length, NaN where the length has no second derivative."""
    a, b = row(wedges.along, e), row(wedges.along, f)
    at_e, at_f = edge_point(wedges, e, z[0]), edge_point(wedges, f, z[1])
    u, v, w = subtract(at_e, p), subtract(at_f, q), subtract(at_f, at_e)
    d_p, d_q, d_ef = length(u), length(v), length(w)
    if d_p < _MIN_LENGTH or d_q < _MIN_LENGTH or d_ef < _MIN_LENGTH:
        return math.nan, math.nan
    # cosines of the legs with the edges; with them the gradient and the Hessian
    ua, vb, wa, wb = dot(u, a) / d_p, dot(v, b) / d_q, dot(w, a) / d_ef, dot(w, b) / d_ef
    gx, gy = ua - wa, vb + wb
    xx = (1.0 - ua * ua) / d_p + (1.0 - wa * wa) / d_ef
    yy = (1.0 - vb * vb) / d_q + (1.0 - wb * wb) / d_ef
    xy = -(dot(a, b) - wa * wb) / d_ef
    det = xx * yy - xy * xy
    if det < 1e-12 * xx * yy:
        return math.nan, math.nan
    return (gy * xy - gx * yy) / det, (gx * xy - gy * xx) / det


@part
def _start(wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3) -> tuple[float, float]:
    """Where to begin: on parallel lines the path is straight once it is unfolded."""
    a, b = row(wedges.along, e), row(wedges.along, f)
    if not parallel(wedges, e, f):
        return 0.5 * wedges.length[e], 0.5 * wedges.length[f]
    z_p, r_p = line_coordinates(wedges, e, p)
    r_q, w = line_coordinates(wedges, f, q)[1], line_coordinates(wedges, e, row(wedges.start, f))[1]
    z_q = dot(subtract(q, row(wedges.start, e)), a)
    step = (z_q - z_p) / max(r_p + w + r_q, _MIN_LENGTH)
    at_f = edge_point(wedges, e, z_p + step * (r_p + w))
    return z_p + step * r_p, dot(subtract(at_f, row(wedges.start, f)), b)


@part(forceinline=True)
def _keller(wedges: Wedges, e: int, p: Vec3, q: Vec3) -> float:
    """z of the shortest path between two points by way of a line."""
    (z_p, r_p), (z_q, r_q) = line_coordinates(wedges, e, p), line_coordinates(wedges, e, q)
    return z_p + (z_q - z_p) * r_p / max(r_p + r_q, _MIN_LENGTH)


@part(forceinline=True)
def _near(length: float, z: float) -> bool:
    """Whether a place is on an edge, or not far beyond its ends."""
    return -_FAR - length < z < length + _FAR + length


@part
def shortest_path(wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3) -> tuple[float, float]:
    """(z on edge e, z on edge f) of the shortest path from p to q by way of the lines of both, NaN where two of the
    four meet on it, or where it is far beyond an end of an edge.

    Newton's method on the length, which is convex. A step that makes the path longer is halved; what rounding makes
    of the length does not count as longer.
    """
    z = _start(wedges, e, f, p, q)
    if parallel(wedges, e, f):
        return z
    for _ in range(_SWEEPS):
        z = _keller(wedges, e, p, edge_point(wedges, f, z[1])), z[1]
        z = z[0], _keller(wedges, f, edge_point(wedges, e, z[0]), q)
    if not (_near(wedges.length[e], z[0]) and _near(wedges.length[f], z[1])):
        return math.nan, math.nan
    best = _length_by(wedges, e, f, p, q, z)
    for _ in range(_MAX_STEPS):
        dx, dy = _newton_step(wedges, e, f, p, q, z)
        if not (abs(dx) < math.inf and abs(dy) < math.inf):
            return math.nan, math.nan
        if max(abs(dx), abs(dy)) < _CONVERGED:
            return z[0] + dx, z[1] + dy
        share = 1.0
        while share > _LEAST_SHARE:
            tried = z[0] + share * dx, z[1] + share * dy
            total = _length_by(wedges, e, f, p, q, tried)
            if total <= best * (1.0 + _ROUNDING):
                break
            share *= 0.5
        z, best = tried, total
    return math.nan, math.nan
