"""Paths by two parallel edges of one face, as those of walls, jambs and furniture: their geometry, and their field.

The path is the shortest one by way of both lines, and its field is exact (`double_wedge`, T34). An end may be in
the light of the edge that is farther from it: then the field adds to that of the path by one edge, and both
together are continuous where it comes into the shadow.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, cross, distance, dot, row
from soundspaces_sim.transport.arrivals.double_wedge import (
    DoubleWedgeScratch,
    Ends,
    double_wedge_field,
    set_terms,
)
from soundspaces_sim.transport.arrivals.field import (
    EdgePath,
    Spectrum,
    beyond_end,
    detours_of_ends,
    field_at,
    front_of,
    of_end,
    terms_of,
)
from soundspaces_sim.transport.arrivals.wedges import (
    BOUNDARY_OFFSET,
    ON_FACE,
    Wedges,
    cosine_taper,
    cuts_of,
    edge_point,
    line_coordinates,
    on_face,
    wedge_coordinates,
)

MIN_RADIUS = 1e-6  # m, of a point about a wedge
_FALLS = 0.5  # of what is heard
BEYOND = 0.2  # m, most detour by the end beyond which an apex lies


class TwoEdgePath(NamedTuple):
    """The shortest path from p by the edges e and f to q; angles in rad, as in `WedgeCoordinates`."""

    e: int
    f: int
    p: Vec3
    q: Vec3
    z_e: float  # m along e
    z_f: float  # m along f
    at_e: Vec3
    at_f: Vec3
    d_p: float  # m, from p to e
    d_ef: float  # m
    d_q: float  # m, from f to q
    r_p: float  # m, of p about e
    r_q: float  # m, of q about f
    phi_p: float  # of p about e
    phi_f: float  # of the apex on f about e
    phi_e: float  # of the apex on e about f
    phi_q: float  # of q about f
    lit_p: bool  # p is in the light of f, past e
    lit_q: bool  # q is in the light of e, past f
    taper: float  # of the energy: 1 where both apexes are on their edges, down to 0 beyond their ends


@part(forceinline=True)
def path_length(path: TwoEdgePath) -> float:
    """m"""
    return path.d_p + path.d_ef + path.d_q


@part(forceinline=True)
def _off_boundary(phi: float, towards: float, open_to: bool) -> tuple[bool, float]:
    """Whether an end at `phi` is in the light of what is at `towards`, which needs it in that edge's open sector;
    `phi`, off the boundary of the shadow."""
    turn = phi - towards
    lit = abs(turn) <= math.pi and open_to
    if abs(abs(turn) - math.pi) < BOUNDARY_OFFSET:
        lit = open_to  # on the plane of a face rounding may have it either way, about both edges alike
        turn = math.copysign(math.pi - BOUNDARY_OFFSET if lit else math.pi + BOUNDARY_OFFSET, turn)
    return lit, towards + turn


@part(forceinline=True)
def _no_path(e: int, f: int, p: Vec3, q: Vec3) -> TwoEdgePath:
    x = math.nan
    return TwoEdgePath(e, f, p, q, x, x, p, q, x, x, x, x, x, x, x, x, x, False, False, 0.0)


@part(forceinline=True)
def _snapped(phi: float, sector: float, near: float) -> float:
    """The angle of a face for a point so `near` to it, rad, on whichever side."""
    if phi < near or phi > 2.0 * math.pi - near:
        return 0.0 if sector < 2.0 * math.pi - ON_FACE or phi < near else sector
    return sector if abs(phi - sector) < near else phi


@part(forceinline=True)
def _on_a_face(phi: float, sector: float) -> bool:
    return phi <= 0.0 or phi >= sector


@part(forceinline=True)
def _on_faces(phi: tuple[float, float], sectors: tuple[float, float]) -> bool:
    """Whether the leg between two edges is on a face of both: its angles about them and their sectors, rad."""
    return _on_a_face(phi[0], sectors[0]) and _on_a_face(phi[1], sectors[1])


@part(forceinline=True)
def face_normal(wedges: Wedges, e: int, phi: float) -> Vec3:
    """Normal, into the open sector, of the face of a wedge at phi = 0, or else of the other one."""
    f, t = wedges.face[e], wedges.normal[e]
    if phi <= 0.0:
        return t[0], t[1], t[2]
    c, d = math.cos(math.pi * wedges.n[e]), math.sin(math.pi * wedges.n[e])
    return d * f[0] - c * t[0], d * f[1] - c * t[1], d * f[2] - c * t[2]


@part
def _on_one_side(
    wedges: Wedges, edges: tuple[int, int], along: tuple[float, float], ends: tuple[float, float]
) -> tuple[float, float]:
    """Angles of the leg between two edges about both. A thin plate has both its faces in that direction: the leg is
    on the side of the other edge's face or, along a plate with two free edges, on that with the smaller turns."""
    sector_e, sector_f = math.pi * wedges.n[edges[0]], math.pi * wedges.n[edges[1]]
    plate_e, plate_f = sector_e > 2.0 * math.pi - ON_FACE, sector_f > 2.0 * math.pi - ON_FACE
    if not ((plate_e or plate_f) and _on_faces(along, (sector_e, sector_f))):
        return along
    best, least = along, math.inf
    for i in range(2):
        for j in range(2):
            tried = (sector_e * i if plate_e else along[0]), (sector_f * j if plate_f else along[1])
            first, second = (
                face_normal(wedges, edges[0], tried[0]),
                face_normal(wedges, edges[1], tried[1]),
            )
            turns = abs(ends[0] - tried[0]) + abs(ends[1] - tried[1])
            if dot(first, second) > 0.0 and turns < least:
                best, least = tried, turns
    return best


@part
def _detours_of_ends(
    wedges: Wedges, e: int, f: int, ends: tuple[Vec3, Vec3], at: tuple[Vec3, Vec3]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Of the ways from p to q by the ends of e, and by those of f, over the path that meets them `at` two places,
    m. The edges are in line once the way across them is unfolded."""
    (p, q), (at_e, at_f) = ends, at
    (z_pe, r_p), (z_qe, _) = line_coordinates(wedges, e, p), line_coordinates(wedges, e, q)
    (z_pf, _), (z_qf, r_q) = line_coordinates(wedges, f, p), line_coordinates(wedges, f, q)
    total = distance(p, at_e) + distance(at_e, at_f) + distance(at_f, q)
    w = line_coordinates(wedges, e, at_f)[1]
    return (
        detours_of_ends(wedges.length[e], (r_p, w + r_q), (z_pe, z_qe), total),
        detours_of_ends(wedges.length[f], (r_p + w, r_q), (z_pf, z_qf), total),
    )


class Shares(NamedTuple):
    """What decides how much of endless edges' field comes from between the ends of both."""

    e: tuple[float, float]  # m, detours by the ends of e; infinite where it goes on
    f: tuple[float, float]
    sign_e: tuple[float, float]  # -1 of an end beyond which the apex lies, else 1
    sign_f: tuple[float, float]
    boundary: float  # m, detour of the path over the straight one
    of_e: float  # of the turns that the path takes, as detours, that at e
    of_f: float
    together: float  # 1: sound that passes one edge passes the other; 0: that says nothing


@part(forceinline=True)
def meets_both(wedges: Wedges, x: TwoEdgePath) -> bool:
    """Whether the apexes are on their edges."""
    return 0.0 < x.z_e < wedges.length[x.e] and 0.0 < x.z_f < wedges.length[x.f]


@part(forceinline=True)
def _taper(wedges: Wedges, e: int, apex: float, detours: tuple[float, float]) -> float:
    """1 of an apex on its edge; down to 0 as the detour by the end beyond which it is grows up to `BEYOND`."""
    if apex < 0.0:
        return cosine_taper(detours[0] / BEYOND)
    return cosine_taper(detours[1] / BEYOND) if apex > wedges.length[e] else 1.0


@part
def shortest_path(wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3) -> tuple[float, float]:
    """(z on edge e, z on edge f) m, of the shortest path by two parallel lines: straight once it is unfolded."""
    z_p, r_p = line_coordinates(wedges, e, p)
    r_q, w = line_coordinates(wedges, f, q)[1], line_coordinates(wedges, e, row(wedges.start, f))[1]
    z_q = line_coordinates(wedges, e, q)[0]
    step = (z_q - z_p) / max(r_p + w + r_q, MIN_RADIUS)
    at_f = edge_point(wedges, e, z_p + step * (r_p + w))
    return z_p + step * r_p, line_coordinates(wedges, f, at_f)[0]


@part
def two_edge_path(wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3) -> tuple[bool, TwoEdgePath]:
    """The path; whether its apexes are on their edges or a little beyond, and its legs in the open sectors of both
    wedges."""
    z_e, z_f = shortest_path(wedges, e, f, p, q)
    at_e, at_f, taper = edge_point(wedges, e, z_e), edge_point(wedges, f, z_f), 1.0
    if not (0.0 < z_e < wedges.length[e] and 0.0 < z_f < wedges.length[f]):
        by_e, by_f = _detours_of_ends(wedges, e, f, (p, q), (at_e, at_f))
        taper = _taper(wedges, e, z_e, by_e) * _taper(wedges, f, z_f, by_f)
        if taper <= 0.0:
            return False, _no_path(e, f, p, q)
    p_e, f_e = wedge_coordinates(wedges, e, p), wedge_coordinates(wedges, e, at_f)
    q_f, e_f = wedge_coordinates(wedges, f, q), wedge_coordinates(wedges, f, at_e)
    sector_e, sector_f = math.pi * wedges.n[e], math.pi * wedges.n[f]
    near = on_face(wedges, e, f, max(min(f_e.r, e_f.r), MIN_RADIUS))
    along = _snapped(f_e.phi, sector_e, near), _snapped(e_f.phi, sector_f, near)
    phi_f, phi_e = _on_one_side(wedges, (e, f), along, (p_e.phi, q_f.phi))
    inside = max(p_e.phi, phi_f) <= sector_e and max(q_f.phi, phi_e) <= sector_f
    inside &= min(p_e.r, f_e.r, q_f.r, e_f.r) >= MIN_RADIUS
    p_open = wedge_coordinates(wedges, f, p).phi <= sector_f
    q_open = wedge_coordinates(wedges, e, q).phi <= sector_e
    lit_p, phi_p = _off_boundary(p_e.phi, phi_f, p_open)
    lit_q, phi_q = _off_boundary(q_f.phi, phi_e, q_open)
    return inside, TwoEdgePath(
        e=e,
        f=f,
        p=p,
        q=q,
        z_e=z_e,
        z_f=z_f,
        at_e=at_e,
        at_f=at_f,
        d_p=distance(p, at_e),
        d_ef=distance(at_e, at_f),
        d_q=distance(at_f, q),
        r_p=p_e.r,
        r_q=q_f.r,
        phi_p=phi_p,
        phi_f=phi_f,
        phi_e=phi_e,
        phi_q=phi_q,
        lit_p=lit_p,
        lit_q=lit_q,
        taper=taper,
    )


@part(forceinline=True)
def _ends_of(
    wedges: Wedges, e: int, apex: float, z: tuple[float, float], detours: tuple[float, float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """(Detours by the ends of an edge, infinite where it goes on; the signs of both)."""
    start, end = cuts_of(wedges, e, z[0], z[1])
    by = detours[0] if start > 0.0 else math.inf, detours[1] if end > 0.0 else math.inf
    return by, (-1.0 if apex < 0.0 else 1.0, -1.0 if apex > wedges.length[e] else 1.0)


@part
def shares_of(wedges: Wedges, x: TwoEdgePath) -> Shares:
    """(T33b)"""
    by_e, by_f = _detours_of_ends(wedges, x.e, x.f, (x.p, x.q), (x.at_e, x.at_f))
    z_e = line_coordinates(wedges, x.e, x.p)[0], line_coordinates(wedges, x.e, x.q)[0]
    z_f = line_coordinates(wedges, x.f, x.p)[0], line_coordinates(wedges, x.f, x.q)[0]
    e, sign_e = _ends_of(wedges, x.e, x.z_e, z_e, by_e)
    f, sign_f = _ends_of(wedges, x.f, x.z_f, z_f, by_f)
    turn_e = max(x.d_p + x.d_ef - distance(x.p, x.at_f), 0.0)
    turn_f = max(x.d_ef + x.d_q - distance(x.at_e, x.q), 0.0)
    both, w = max(turn_e + turn_f, MIN_RADIUS**2), line_coordinates(wedges, x.e, x.at_f)[1]
    coupled = 2.0 / math.pi * math.asin(math.sqrt(x.r_p * x.r_q / ((x.r_p + w) * (w + x.r_q))))
    together = 1.0 - (1.0 - coupled) * 4.0 * turn_e * turn_f / (both * both)
    boundary = max(path_length(x) - distance(x.p, x.q), 0.0)
    return Shares(e, f, sign_e, sign_f, boundary, turn_e / both, turn_f / both, together)


@part(forceinline=True)
def _share_of(
    k: float, detours: tuple[float, float], sign: tuple[float, float], boundary: float
) -> complex:
    start = sign[0] * of_end(beyond_end(k, detours[0]), detours[0], boundary)
    return 0.5 * (start + sign[1] * of_end(beyond_end(k, detours[1]), detours[1], boundary))


@part(forceinline=True)
def _share(s: Shares, k: float) -> complex:
    """Part of the field of endless edges that comes from between the ends of both (T33b)."""
    e, f = _share_of(k, s.e, s.sign_e, s.boundary), _share_of(k, s.f, s.sign_f, s.boundary)
    return (1.0 - s.together) * e * f + s.together * (s.of_e * e + s.of_f * f)


@part
def two_edge_field(
    wedges: Wedges,
    x: TwoEdgePath,
    shares: Shares,
    spectrum: Spectrum,
    least: np.ndarray,
    scratch: DoubleWedgeScratch,
    field: np.ndarray,
) -> bool:
    """Field of a path, 1/m, into `field` (b, g), without the phase of its length; at most twice the free field.
    Whether it has at least `least` (b,) of |p|² in some band; it falls with frequency, so the lowest band tells."""
    total, ends, wave, weight = path_length(x), _across(wedges, x), scratch.wave, math.sqrt(x.taper)
    across, known, loud = ends.p_e + ends.w + ends.q_f, 0, False
    _set_ends(wedges, x, ends, scratch)
    for b in range(field.shape[0]):
        first, count = spectrum.first[b], spectrum.between.shape[2]
        while known < first + count:
            k = spectrum.node[known]
            u = double_wedge_field(ends, k * across / total, scratch)
            wave[known] = u * math.sqrt(across) / total
            if known == 0 and _squared(wave[0] * weight * _share(shares, k)) < _FALLS * least[0]:
                return False
            known += 1
        for g in range(field.shape[1]):
            u = 0j
            for n in range(count):
                u += spectrum.between[b, g, n] * wave[first + n]
            u *= weight * _share(shares, spectrum.k[b, g])
            size = 0.5 * total * math.sqrt(_squared(u))
            field[b, g] = u / size if size > 1.0 else u
        own = _squared(field[b, 0])
        loud = loud or own > least[b]
        if not loud and own < _FALLS * least[b]:
            return False
    return loud


@part(forceinline=True)
def _squared(u: complex) -> float:
    return u.real * u.real + u.imag * u.imag


@part
def estimate(wedges: Wedges, x: TwoEdgePath, shares: Shares, k: float) -> float:
    """Of |p|² of a path at a wave number, 1/m²: by the product of coefficients, within some dB, with 3 dB to
    spare."""
    return 2.0 * x.taper * _squared(_share(shares, k)) * _squared(_product_field(wedges, x, k))


@part
def _across(wedges: Wedges, x: TwoEdgePath) -> Ends:
    """The path across parallel edges."""
    p_f = line_coordinates(wedges, x.f, x.p)[1] if x.lit_p else 0.0
    q_e = line_coordinates(wedges, x.e, x.q)[1] if x.lit_q else 0.0
    w = line_coordinates(wedges, x.e, x.at_f)[1]
    return Ends(wedges.n[x.e], wedges.n[x.f], x.r_p, x.r_q, p_f, q_e, w)


@part(forceinline=True)
def sense_of(wedges: Wedges, e: int, axis: Vec3) -> float:
    """1 where phi about an edge grows counterclockwise about an axis, else -1."""
    return math.copysign(1.0, dot(cross(row(wedges.face, e), row(wedges.normal, e)), axis))


@part
def _set_ends(wedges: Wedges, x: TwoEdgePath, ends: Ends, scratch: DoubleWedgeScratch) -> None:
    """The terms of both ends about both edges."""
    axis = row(wedges.along, x.e)
    sense_e, sense_f = sense_of(wedges, x.e, axis), sense_of(wedges, x.f, axis)
    set_terms(ends.n_e, x.phi_p, x.phi_f, sense_e, scratch.p_e)
    set_terms(ends.n_f, x.phi_q, x.phi_e, sense_f, scratch.q_f)
    if ends.p_f > 0.0 and ends.q_e == 0.0:
        phi = wedge_coordinates(wedges, x.f, x.p).phi
        set_terms(ends.n_f, phi, x.phi_e, sense_f, scratch.p_f)
    if ends.q_e > 0.0:
        phi = wedge_coordinates(wedges, x.e, x.q).phi
        set_terms(ends.n_e, phi, x.phi_f, sense_e, scratch.q_e)


@part
def _coefficient(
    n: float, phi: tuple[float, float], legs: tuple[float, float], sin_beta: float, k: float
) -> complex:
    minus, plus, on = abs(phi[0] - phi[1]), phi[0] + phi[1], math.inf
    other = 2.0 * math.pi * n - plus
    path = EdgePath(n, minus, plus, other, legs[0], legs[1], sin_beta, 0.5, 1.0, on, on, 1.0)
    return field_at(path, front_of(path, terms_of(path)), k, (1.0, 1.0))


@part
def _product_field(wedges: Wedges, x: TwoEdgePath, k: float) -> complex:
    """The product of two coefficients, within some dB of the field (Pierce 1974, Diffraction of sound around
    corners and over wide barriers, JASA 55 (5)): that which deflects the path more has all of it for its
    distances."""
    about_e, about_f = (x.phi_p, x.phi_f), (x.phi_e, x.phi_q)
    beyond_e, beyond_f = abs(x.phi_f - x.phi_p) - math.pi, abs(x.phi_q - x.phi_e) - math.pi
    if beyond_e * x.r_p >= beyond_f * x.r_q:
        legs_e, legs_f, scale = (x.d_p, x.d_ef + x.d_q), (x.d_ef, x.d_q), x.d_ef + x.d_q
    else:
        legs_e, legs_f, scale = (x.d_p, x.d_ef), (x.d_p + x.d_ef, x.d_q), x.d_p + x.d_ef
    first = _coefficient(wedges.n[x.e], about_e, legs_e, x.r_p / x.d_p, k)
    second = _coefficient(wedges.n[x.f], about_f, legs_f, x.r_q / x.d_q, k)
    return 0.5 * scale * first * second
