"""The shortest path by way of the lines of two edges."""

import math

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, dot, length, row
from soundspaces_sim.transport.diffraction.wedges import Wedges

_MAX_STEPS = 12  # of Newton's method; it ends sooner
_MAX_STEP = 2.0  # m
_MIN_LENGTH = 1e-6  # m, of a leg


@part
def shortest_path(wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3) -> tuple[float, float]:
    """(z on edge e, z on edge f) of the shortest path from p to q by way of the lines of both, NaN if there is
    none; Newton's method on the length, which is convex."""
    s, a, t, b = row(wedges.start, e), row(wedges.along, e), row(wedges.start, f), row(wedges.along, f)
    x, y = 0.5 * wedges.length[e], 0.5 * wedges.length[f]
    ab = dot(a, b)
    for _ in range(_MAX_STEPS):
        u = (s[0] + x * a[0] - p[0], s[1] + x * a[1] - p[1], s[2] + x * a[2] - p[2])
        v = (t[0] + y * b[0] - q[0], t[1] + y * b[1] - q[1], t[2] + y * b[2] - q[2])
        w = (
            t[0] + y * b[0] - s[0] - x * a[0],
            t[1] + y * b[1] - s[1] - x * a[1],
            t[2] + y * b[2] - s[2] - x * a[2],
        )
        d_p, d_q, d_ef = length(u), length(v), length(w)
        if d_p < _MIN_LENGTH or d_q < _MIN_LENGTH or d_ef < _MIN_LENGTH:
            return math.nan, math.nan
        # cosines of the legs with the edges; with them the gradient and the Hessian
        ua, vb, wa, wb = dot(u, a) / d_p, dot(v, b) / d_q, dot(w, a) / d_ef, dot(w, b) / d_ef
        gx, gy = ua - wa, vb + wb
        xx = (1.0 - ua * ua) / d_p + (1.0 - wa * wa) / d_ef
        yy = (1.0 - vb * vb) / d_q + (1.0 - wb * wb) / d_ef
        xy = -(ab - wa * wb) / d_ef
        det = xx * yy - xy * xy
        if det < 1e-12:
            return math.nan, math.nan
        dx, dy = (gx * yy - gy * xy) / det, (gy * xx - gx * xy) / det
        far = max(abs(dx), abs(dy))
        scale = min(1.0, _MAX_STEP / far) if far > 0.0 else 1.0
        x, y = x - scale * dx, y - scale * dy
        if far < 1e-7:
            break
    return x, y
