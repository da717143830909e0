"""The field of a path by two edges (`two_edge_path`).

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
from soundspaces_sim.transport.arrivals.field import of_end, beyond_end, most_share
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.diffraction.complex_directions import set_terms
from soundspaces_sim.transport.diffraction.double_wedge import (
    DoubleWedgeScratch,
    Ends,
    double_wedge_field,
)
from soundspaces_sim.transport.diffraction.paths import cosine_taper, cuts_of, faded_in
from soundspaces_sim.transport.diffraction.spectrum import Quadrature
from soundspaces_sim.transport.diffraction.two_edge_ends import detours_of_ends
from soundspaces_sim.transport.diffraction.two_edge_path import (
    TwoEdgePath,
    is_strip,
    path_length,
)
from soundspaces_sim.transport.diffraction.utd import (
    share_of_edge,
    wedge_field,
    wedge_terms,
)
from soundspaces_sim.transport.diffraction.wedges import (
    Wedges,
    line_coordinates,
    parallel,
    wedge_coordinates,
)

_LEAST_SHARE = 1e-30  # of squares of squares
_ESTIMATE = 2.0  # times the energy by a product of coefficients
_ESTIMATE_STRIP, _SHARP = 1.0, 1.45  # the same across a face between edges of this wedge index or more


class _Shares(NamedTuple):
    """What decides how much of endless edges' field comes from between the ends of both."""

    detours_e: tuple[float, float]
    detours_f: tuple[float, float]
    first_e: float
    second_e: float
    first_f: float
    second_f: float
    boundary: float
    of_e: float
    of_f: float
    together: float


@part
def _shares(wedges: Wedges, x: TwoEdgePath) -> _Shares:
    (es, ee), (fs, fe) = detours_of_ends(wedges, x.e, x.f, (x.p, x.q), (x.at_e, x.at_f))
    p_e, q_e = line_coordinates(wedges, x.e, x.p)[0], line_coordinates(wedges, x.e, x.q)[0]
    p_f, q_f = line_coordinates(wedges, x.f, x.p)[0], line_coordinates(wedges, x.f, x.q)[0]
    a, b = cuts_of(wedges, x.e, p_e, q_e)
    c, d = cuts_of(wedges, x.f, p_f, q_f)
    turn_e = max(x.d_p + x.d_ef - distance(x.p, x.at_f), 0.0)
    turn_f = max(x.d_ef + x.d_q - distance(x.at_e, x.q), 0.0)
    both = max(turn_e + turn_f, 1e-12)
    coupled = 0.0
    if parallel(wedges, x.e, x.f):
        w = line_coordinates(wedges, x.e, x.at_f)[1]
        coupled = 2.0 / math.pi * math.asin(math.sqrt(x.r_p * x.r_q / ((x.r_p + w) * (w + x.r_q))))
    alike = 4.0 * turn_e * turn_f / (both * both)
    return _Shares(
        (es if a > 0.0 else math.inf, ee if b > 0.0 else math.inf),
        (fs if c > 0.0 else math.inf, fe if d > 0.0 else math.inf),
        -1.0 if x.z_e < 0.0 else 1.0, -1.0 if x.z_e > wedges.length[x.e] else 1.0,
        -1.0 if x.z_f < 0.0 else 1.0, -1.0 if x.z_f > wedges.length[x.f] else 1.0,
        max(path_length(x) - distance(x.p, x.q), 0.0), turn_e / both, turn_f / both,
        1.0 - (1.0 - coupled) * alike,
    )


@part(forceinline=True)
def _share(wedges: Wedges, x: TwoEdgePath, s: _Shares, k: float) -> complex:
    e = 0.5 * (
        s.first_e * of_end(beyond_end(k, s.detours_e[0]), s.detours_e[0], s.boundary)
        + s.second_e * of_end(beyond_end(k, s.detours_e[1]), s.detours_e[1], s.boundary)
    )
    f = 0.5 * (
        s.first_f * of_end(beyond_end(k, s.detours_f[0]), s.detours_f[0], s.boundary)
        + s.second_f * of_end(beyond_end(k, s.detours_f[1]), s.detours_f[1], s.boundary)
    )
    return (1.0 - s.together) * e * f + s.together * (s.of_e * e + s.of_f * f)


@part
def most_energy(wedges: Wedges, x: TwoEdgePath, k: float) -> float:
    """J/m² for 1 J at a wave number: a path by two edges has no more."""
    u, sharp = product_field(wedges, x, k), min(wedges.n[x.e], wedges.n[x.f]) >= _SHARP
    times = _ESTIMATE_STRIP if sharp and is_strip(wedges, x) else _ESTIMATE
    (start, end), (begin, stop) = detours_of_ends(wedges, x.e, x.f, (x.p, x.q), (x.at_e, x.at_f))
    share = min(most_share(k, start, end), most_share(k, begin, stop))
    times *= share * share
    return times * x.taper * (u.real * u.real + u.imag * u.imag) * INV_4PI


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
    shares, total, exact = _shares(wedges, x), path_length(x), parallel(wedges, x.e, x.f)
    ends, k, wave = _ends(wedges, x, sees), quadrature.k, scratch.wave
    weight = math.sqrt(x.taper)
    across = ends.p_e + ends.w + ends.q_f
    if exact:
        _set_ends(wedges, x, ends, scratch)
    counts = 0.0
    field[:, :] = 0j
    for b in range(field.shape[0]):
        if phase_taper(k[b, 0] * detour) <= 0.0:
            break  # the more so in higher bands
        for n in range(quadrature.node.shape[1]):
            if exact:
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
            taper *= weight
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
