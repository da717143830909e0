"""A path by two edges: the shortest one by way of their lines, its angles, and its energy.

Theory: `double`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance, dot, length, row, subtract
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.diffraction.paths import DiffractedPath, edge_share, endless_field
from soundspaces_sim.transport.diffraction.spectrum import Quadrature
from soundspaces_sim.transport.diffraction.wedges import Wedges, edge_point, wedge_coordinates

_MAX_STEPS = 60  # of Newton's method; it ends sooner
_CONVERGED = 1e-7  # m, the last step
_LEAST_SHARE = 1e-9  # of a step
_ROUNDING = 1e-14  # of a length
_MIN_LENGTH = 1e-6  # m, of a leg
_MIN_RADIUS = 1e-6  # m, of a point about a wedge
_ON_FACE = 0.01  # rad: a point so near to a face is on it
_PARALLEL = 0.999  # cosine between edges
_THIN = 2.0  # k times thickness at which a wall's edges are half one, half two


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
def shortest_path(wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3) -> tuple[float, float]:
    """(z on edge e, z on edge f) of the shortest path from p to q by way of the lines of both, NaN where two of
    the four meet on it.

    Newton's method on the length, which is convex. A step that makes the path longer is halved; what rounding
    makes of the length does not count as longer.
    """
    z = 0.5 * wedges.length[e], 0.5 * wedges.length[f]
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


class Apexes(NamedTuple):
    """Where a path from p meets the edges e and f on its way to q."""

    z_e: float  # m along e
    z_f: float  # m along f
    at_e: Vec3
    at_f: Vec3
    d_p: float  # m, from p to e
    d_ef: float  # m
    d_q: float  # m, from f to q


class PathAngles(NamedTuple):
    """The path's coordinates about both wedges; angles in rad, as in `WedgeCoordinates`."""

    r_p: float  # m, of p about e
    r_q: float  # m, of q about f
    phi_p: float  # of p about e
    phi_f: float  # of the apex on f about e
    phi_e: float  # of the apex on e about f
    phi_q: float  # of q about f


class TwoEdges(NamedTuple):
    """The factors of the pressure: |first second| scale, or |single| where the wall between is thin."""

    first: DiffractedPath
    second: DiffractedPath
    scale: float
    may_be_thin: bool
    single: DiffractedPath
    thickness: float  # m


@part(forceinline=True)
def _snapped(phi: float, sector: float) -> float:
    """The angle of a face for a point on it, whichever side of the face rounding puts the point."""
    if phi < _ON_FACE or phi > 2.0 * math.pi - _ON_FACE:
        return 0.0 if sector < 2.0 * math.pi - _ON_FACE or phi < _ON_FACE else sector
    return sector if abs(phi - sector) < _ON_FACE else phi


@part
def path_angles(wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3, x: Apexes) -> tuple[bool, PathAngles]:
    """Whether the path goes through both open sectors into the shadow of both wedges; its angles."""
    p_e, f_e = wedge_coordinates(wedges, e, p), wedge_coordinates(wedges, e, x.at_f)
    q_f, e_f = wedge_coordinates(wedges, f, q), wedge_coordinates(wedges, f, x.at_e)
    sector_e, sector_f = math.pi * wedges.n[e], math.pi * wedges.n[f]
    phi_f, phi_e = _snapped(f_e.phi, sector_e), _snapped(e_f.phi, sector_f)
    inside = max(p_e.phi, phi_f) <= sector_e and max(q_f.phi, phi_e) <= sector_f
    shadow = abs(phi_f - p_e.phi) > math.pi and abs(q_f.phi - phi_e) > math.pi
    apart = min(p_e.r, f_e.r, q_f.r, e_f.r) >= _MIN_RADIUS
    return apart and inside and shadow, PathAngles(p_e.r, q_f.r, p_e.phi, phi_f, phi_e, q_f.phi)


class _Line(NamedTuple):
    """The path's two legs at one of its edges."""

    p: Vec3
    q: Vec3
    length: float  # m


@part(forceinline=True)
def _detour(wedges: Wedges, e: int, z: float, line: _Line) -> float:
    """By way of z on an edge, over the shortest path, m."""
    at = edge_point(wedges, e, z)
    return max(distance(line.p, at) + distance(at, line.q) - line.length, 0.0)


@part
def _at_edge(
    wedges: Wedges,
    e: int,
    z: float,
    line: _Line,
    phi: tuple[float, float],
    legs: tuple[float, float],
    sin_beta: float,
) -> DiffractedPath:
    """The path at one of its edges; `phi` of both ends, `legs` as the coefficient takes them."""
    edge_length = wedges.length[e]
    start, end = _detour(wedges, e, 0.0, line), _detour(wedges, e, edge_length, line)
    low, high = min(phi[0], phi[1]), max(phi[0], phi[1])
    return DiffractedPath(
        wedges.n[e], low, high, legs[0], legs[1], sin_beta, z, edge_length, start, end, 1.0
    )


@part(forceinline=True)
def _parallel(wedges: Wedges, e: int, f: int) -> bool:
    return abs(dot(row(wedges.along, e), row(wedges.along, f))) > _PARALLEL


@part(forceinline=True)
def _with_angles(
    path: DiffractedPath, n: float, phi: tuple[float, float], legs: tuple[float, float]
) -> DiffractedPath:
    """The same apex and edge, about a wedge of index n."""
    start, end = path.detour_start, path.detour_end
    sine, apex, length = path.sin_beta, path.apex, path.edge_length
    return DiffractedPath(n, phi[0], phi[1], legs[0], legs[1], sine, apex, length, start, end, 1.0)


@part
def two_edge_factors(
    wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3, x: Apexes, angles: PathAngles
) -> TwoEdges:
    """What the pressure of the path from p by e and f to q consists of."""
    sector_e, sector_f = math.pi * wedges.n[e], math.pi * wedges.n[f]
    about_e, about_f = (angles.phi_p, angles.phi_f), (angles.phi_e, angles.phi_q)
    beyond_e, beyond_f = abs(about_e[1] - about_e[0]) - math.pi, abs(about_f[1] - about_f[0]) - math.pi
    f_on_face = angles.phi_f <= 0.0 or angles.phi_f >= sector_e
    e_on_face = angles.phi_e <= 0.0 or angles.phi_e >= sector_f
    common = f_on_face and e_on_face
    half = 0.5 if common else 1.0
    if beyond_e * angles.r_p >= beyond_f * angles.r_q:
        legs_e, legs_f, scale = (x.d_p, x.d_ef + x.d_q), (x.d_ef, x.d_q), half * (x.d_ef + x.d_q)
    else:
        legs_e, legs_f, scale = (x.d_p, x.d_ef), (x.d_p + x.d_ef, x.d_q), half * (x.d_p + x.d_ef)
    line_e, line_f = _Line(p, x.at_f, x.d_p + x.d_ef), _Line(x.at_e, q, x.d_ef + x.d_q)
    first = _at_edge(wedges, e, x.z_e, line_e, about_e, legs_e, angles.r_p / x.d_p)
    second = _at_edge(wedges, f, x.z_f, line_f, about_f, legs_f, angles.r_q / x.d_q)
    # As one edge: a wedge that deflects the path as both do, each end at its angle from its own outer face.
    outer_p = angles.phi_p if angles.phi_f > angles.phi_p else sector_e - angles.phi_p
    outer_q = angles.phi_q if angles.phi_e > angles.phi_q else sector_f - angles.phi_q
    n = wedges.n[e] + wedges.n[f] - 1.0
    d_s, d_r = x.d_p + 0.5 * x.d_ef, x.d_q + 0.5 * x.d_ef
    single = _with_angles(first, n, (outer_p, math.pi * n - outer_q), (d_s, d_r))
    thin = common and _parallel(wedges, e, f) and n <= 2.0 + 1e-9
    return TwoEdges(first, second, scale, thin, single, x.d_ef)


@part
def two_edge_energy(two: TwoEdges, quadrature: Quadrature, energy: np.ndarray) -> float:
    """Energies (b,) of a path by two edges, J/m² for 1 J, without air; the largest of them."""
    most = 0.0
    for b in range(len(energy)):
        mean = 0.0
        for g in range(len(quadrature.weight)):
            k = quadrature.k[b, g]
            size = abs(endless_field(two.first, k, 1.0) * endless_field(two.second, k, 1.0) * two.scale)
            if two.may_be_thin:
                thick = k * two.thickness / (_THIN + k * two.thickness)
                size = thick * size + (1.0 - thick) * abs(endless_field(two.single, k, 1.0))
            size *= abs(edge_share(two.first, k) * edge_share(two.second, k))
            mean += quadrature.weight[g] * size * size
        energy[b] = mean * INV_4PI
        most = max(most, energy[b])
    return most
