"""A path by two edges: the shortest one by way of their lines, its angles, and its field.

Between parallel edges the field is exact (`double_wedge`). Otherwise it is a product of two coefficients (`utd`),
that which deflects the path more with the whole path for its distances, the other with its own legs (Pierce 1974,
Diffraction of sound around corners and over wide barriers, JASA 55 (5)); along a common face it is halved, for the
face's image is in both coefficients.

An end may be in the light of the edge that is farther from it: then the field adds to that of the path by one edge,
and both together are continuous where it comes into the shadow.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, cross, distance, dot, row
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.diffraction.complex_directions import set_terms
from soundspaces_sim.transport.diffraction.double_wedge import (
    DoubleWedgeScratch,
    Ends,
    double_wedge_field,
)
from soundspaces_sim.transport.diffraction.paths import (
    BOUNDARY_OFFSET,
    cosine_taper,
    cuts_of,
    faded_in,
)
from soundspaces_sim.transport.diffraction.shortest_path import shortest_path
from soundspaces_sim.transport.diffraction.sides_of_faces import on_faces, on_one_side, snapped
from soundspaces_sim.transport.diffraction.spectrum import Quadrature
from soundspaces_sim.transport.diffraction.utd import share_of_edge, wedge_field, wedge_terms
from soundspaces_sim.transport.diffraction.wedges import (
    Wedges,
    edge_point,
    line_coordinates,
    wedge_coordinates,
)

_MIN_RADIUS = 1e-6  # m, of a point about a wedge
_PARALLEL = 0.999  # cosine between edges
_ESTIMATE = 8.0  # times the energy by a product of coefficients
_ESTIMATE_STRIP, _SHARP = 2.0, 1.45  # the same across a face between edges of this wedge index or more


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
    common: bool  # a face connects both edges
    lit_p: bool  # p is in the light of f, past e
    lit_q: bool  # q is in the light of e, past f


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
    return TwoEdgePath(e, f, p, q, x, x, p, q, x, x, x, x, x, x, x, x, x, False, False, False)


@part
def two_edge_path(
    wedges: Wedges, e: int, f: int, p: Vec3, q: Vec3, by: tuple[float, float]
) -> tuple[bool, TwoEdgePath]:
    """The path; whether both apexes are inside their edges and its legs in the open sectors of both wedges. `by`:
    see `sides_of_faces.on_one_side`, `BY_BOTH` for a path that neither end sees the other edge of."""
    z_e, z_f = shortest_path(wedges, e, f, p, q)
    if not (0.0 < z_e < wedges.length[e] and 0.0 < z_f < wedges.length[f]):
        return False, _no_path(e, f, p, q)
    at_e, at_f = edge_point(wedges, e, z_e), edge_point(wedges, f, z_f)
    p_e, f_e = wedge_coordinates(wedges, e, p), wedge_coordinates(wedges, e, at_f)
    q_f, e_f = wedge_coordinates(wedges, f, q), wedge_coordinates(wedges, f, at_e)
    sector_e, sector_f = math.pi * wedges.n[e], math.pi * wedges.n[f]
    phi_f, phi_e = on_one_side(
        wedges,
        (e, f),
        (snapped(f_e.phi, sector_e), snapped(e_f.phi, sector_f)),
        (p_e.phi, q_f.phi),
        by,
    )
    inside = max(p_e.phi, phi_f) <= sector_e and max(q_f.phi, phi_e) <= sector_f
    inside &= min(p_e.r, f_e.r, q_f.r, e_f.r) >= _MIN_RADIUS
    common = on_faces((phi_f, phi_e), (sector_e, sector_f))
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
        common=common,
        lit_p=lit_p,
        lit_q=lit_q,
    )


@part(forceinline=True)
def _parallel(wedges: Wedges, e: int, f: int) -> bool:
    return abs(dot(row(wedges.along, e), row(wedges.along, f))) > _PARALLEL


@part(forceinline=True)
def _detour(wedges: Wedges, e: int, z: float, p: Vec3, q: Vec3, straight: float) -> float:
    """Of the way from p by z on an edge to q, over one of length `straight`, m."""
    at = edge_point(wedges, e, z)
    return max(distance(p, at) + distance(at, q) - straight, 0.0)


class _Shares(NamedTuple):
    """Of both edges of a path, as `share_of_edge` has them."""

    detours_e: tuple[float, float]
    detours_f: tuple[float, float]
    cuts_e: tuple[float, float]
    cuts_f: tuple[float, float]


@part
def _shares(wedges: Wedges, x: TwoEdgePath) -> _Shares:
    by_e, by_f = x.d_p + x.d_ef, x.d_ef + x.d_q
    p_e, q_e = line_coordinates(wedges, x.e, x.p)[0], line_coordinates(wedges, x.e, x.q)[0]
    p_f, q_f = line_coordinates(wedges, x.f, x.p)[0], line_coordinates(wedges, x.f, x.q)[0]
    return _Shares(
        (
            _detour(wedges, x.e, 0.0, x.p, x.at_f, by_e),
            _detour(wedges, x.e, wedges.length[x.e], x.p, x.at_f, by_e),
        ),
        (
            _detour(wedges, x.f, 0.0, x.at_e, x.q, by_f),
            _detour(wedges, x.f, wedges.length[x.f], x.at_e, x.q, by_f),
        ),
        cuts_of(wedges, x.e, p_e, q_e),
        cuts_of(wedges, x.f, p_f, q_f),
    )


@part(forceinline=True)
def _share(wedges: Wedges, x: TwoEdgePath, shares: _Shares, k: float) -> complex:
    """Part of the field of endless edges that comes from between the ends of both."""
    first = share_of_edge(k, x.z_e, wedges.length[x.e], shares.detours_e, shares.cuts_e)
    return first * share_of_edge(k, x.z_f, wedges.length[x.f], shares.detours_f, shares.cuts_f)


@part(forceinline=True)
def is_strip(wedges: Wedges, x: TwoEdgePath) -> bool:
    """Whether a face connects both edges, which are parallel."""
    return x.common and _parallel(wedges, x.e, x.f)


@part
def most_energy(wedges: Wedges, x: TwoEdgePath, k: float) -> float:
    """J/m² for 1 J at a wave number: a path by two edges has no more."""
    u, sharp = product_field(wedges, x, k), min(wedges.n[x.e], wedges.n[x.f]) >= _SHARP
    times = _ESTIMATE_STRIP if sharp and is_strip(wedges, x) else _ESTIMATE
    return times * (u.real * u.real + u.imag * u.imag) * INV_4PI


@part(forceinline=True)
def phase_taper(phase: float) -> float:
    """1 up to a phase of pi over another path, down to 0 at 2 pi: beyond, a few points per band cannot tell the
    interference of both, whose mean is none."""
    return cosine_taper(2.0 * max(phase / (2.0 * math.pi) - 0.5, 0.0))


@part
def two_edge_field(
    wedges: Wedges,
    x: TwoEdgePath,
    sees: tuple[bool, bool],
    detour: float,
    least: float,
    quadrature: Quadrature,
    scratch: DoubleWedgeScratch,
    field: np.ndarray,
) -> float:
    """Field, 1/m, into `field` (b, g), without the phase of a path that is shorter by `detour` m, tapered with the
    phase over that. How much of it counts: the energy of endless edges in the lowest band fades in from `least`,
    J/m². Where nothing counts, the field is 0.

    `sees`: whether p sees f as well, and q sees e.
    """
    shares, total, parallel = _shares(wedges, x), path_length(x), _parallel(wedges, x.e, x.f)
    ends, k, wave = _ends(wedges, x, sees), quadrature.k, scratch.wave
    across = ends.p_e + ends.w + ends.q_f
    if parallel:
        _set_ends(wedges, x, ends, scratch)
    counts = 0.0
    field[:, :] = 0j
    for b in range(field.shape[0]):
        if phase_taper(k[b, 0] * detour) <= 0.0:
            break  # the more so in higher bands
        for n in range(quadrature.node.shape[1]):
            if parallel:
                wave[n] = double_wedge_field(ends, quadrature.node[b, n] * across / total, scratch)
                wave[n] *= math.sqrt(across) / total
            else:
                wave[n] = product_field(wedges, x, quadrature.node[b, n])
        if b == 0:
            counts = faded_in(_mean_square(wave) * INV_4PI, least)
            if counts <= 0.0:
                break
        for g in range(k.shape[1]):
            phase = k[b, g] * detour
            taper = phase_taper(phase)
            if taper <= 0.0:
                continue
            u = 0j
            for n in range(quadrature.node.shape[1]):
                u += quadrature.between[b, g, n] * wave[n]
            turned = complex(taper * math.cos(phase), -taper * math.sin(phase))
            field[b, g] = u * turned * _share(wedges, x, shares, k[b, g])
    return counts


@part(forceinline=True)
def _mean_square(wave: np.ndarray) -> float:
    """Of a wave (n,) at a band's nodes, which have equal weights."""
    total = 0.0
    for n in range(len(wave)):
        total += wave[n].real * wave[n].real + wave[n].imag * wave[n].imag
    return total / len(wave)


@part
def _ends(wedges: Wedges, x: TwoEdgePath, sees: tuple[bool, bool]) -> Ends:
    """The path across parallel edges."""
    p_f = line_coordinates(wedges, x.f, x.p)[1] if sees[0] else 0.0
    q_e = line_coordinates(wedges, x.e, x.q)[1] if sees[1] else 0.0
    w = line_coordinates(wedges, x.e, x.at_f)[1]
    return Ends(wedges.n[x.e], wedges.n[x.f], x.r_p, x.r_q, p_f, q_e, w, x.common)


@part(forceinline=True)
def _sense(wedges: Wedges, e: int, axis: Vec3) -> float:
    """1 where phi about an edge grows counterclockwise about an axis, else -1."""
    return math.copysign(1.0, dot(cross(row(wedges.face, e), row(wedges.normal, e)), axis))


@part
def _set_ends(wedges: Wedges, x: TwoEdgePath, ends: Ends, scratch: DoubleWedgeScratch) -> None:
    """The terms of both ends about both edges."""
    axis = row(wedges.along, x.e)
    sense_e, sense_f = _sense(wedges, x.e, axis), _sense(wedges, x.f, axis)
    set_terms(ends.n_e, x.phi_p, x.phi_f, sense_e, x.common, scratch.p_e)
    set_terms(ends.n_f, x.phi_q, x.phi_e, sense_f, x.common, scratch.q_f)
    if not x.common:
        return
    if ends.p_f > 0.0 and ends.q_e == 0.0:
        phi = wedge_coordinates(wedges, x.f, x.p).phi
        set_terms(ends.n_f, phi, x.phi_e, sense_f, True, scratch.p_f)
    if ends.q_e > 0.0:
        phi = wedge_coordinates(wedges, x.e, x.q).phi
        set_terms(ends.n_e, phi, x.phi_f, sense_e, True, scratch.q_e)


@part
def _coefficient(
    n: float, phi: tuple[float, float], legs: tuple[float, float], sin_beta: float, k: float
) -> complex:
    low, high = min(phi[0], phi[1]), max(phi[0], phi[1])
    incident, reflected = wedge_field(n, wedge_terms(n, low, high), legs[0], legs[1], sin_beta, k)
    return incident + reflected


@part
def product_field(wedges: Wedges, x: TwoEdgePath, k: float) -> complex:
    """The field of edges that are not parallel and have no ends."""
    about_e, about_f = (x.phi_p, x.phi_f), (x.phi_e, x.phi_q)
    beyond_e, beyond_f = abs(x.phi_f - x.phi_p) - math.pi, abs(x.phi_q - x.phi_e) - math.pi
    if beyond_e * x.r_p >= beyond_f * x.r_q:
        legs_e, legs_f, scale = (x.d_p, x.d_ef + x.d_q), (x.d_ef, x.d_q), x.d_ef + x.d_q
    else:
        legs_e, legs_f, scale = (x.d_p, x.d_ef), (x.d_p + x.d_ef, x.d_q), x.d_p + x.d_ef
    first = _coefficient(wedges.n[x.e], about_e, legs_e, x.r_p / x.d_p, k)
    second = _coefficient(wedges.n[x.f], about_f, legs_f, x.r_q / x.d_q, k)
    return (0.5 if x.common else 1.0) * scale * first * second
