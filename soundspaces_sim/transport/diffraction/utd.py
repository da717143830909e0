"""Diffraction at a rigid wedge: the uniform geometrical theory (UTD), and edges that end.

Source: Kouyoumjian & Pathak (1974), A uniform geometrical theory of diffraction for an edge in a perfectly
conducting surface, Proc. IEEE 62 (11). A rigid wedge is their hard one; their eq. (25) is

    D = -e^(-j pi/4) / (2 n sqrt(2 pi k) sin beta)
        sum over ± of { cot((pi ± (phi - phi')) / 2n) F(k L a±(phi - phi'))
                      + cot((pi ± (phi + phi')) / 2n) F(k L a±(phi + phi')) },

    F(X)    = 2j sqrt(X) e^(jX) int_sqrt(X)^oo e^(-jt²) dt                              (26)
    a±(psi) = 2 cos²((2 pi n N± - psi) / 2)                                              (27)
    N±: the integers that most nearly satisfy 2 pi n N± - psi = ± pi                     (28)
    L       = s s' sin² beta / (s + s')   for spherical waves,

and the diffracted pressure is D sqrt(1 / (s s' (s + s'))) e^(-jk(s + s')) for a source of e^(-jkr) / r. The
source is at the angle phi' (`phi_s`), the receiver at phi > phi' (`phi_r`), both from the first face; s' and s
(`d_s`, `d_r`) are the path's two legs and beta its angle with the edge. Functions here leave e^(-jk(s + s')) out.
The terms of phi - phi' make the field continuous at the shadow boundary of the incident wave, those of phi + phi'
at that of the reflection.

An edge that ends takes the part of the endless one's field that comes from between its ends: with u² = k times the
detour by way of an end over the path by the apex, the complementary Fresnel integral from -u_1 to u_2. It is the
form by stationary phase of the integral along the edge (Svensson, Fred & Vanderkooy 1999, An analytic secondary
source model of edge diffraction impulse responses, JASA 106 (5)). So the field is continuous where the apex leaves
the edge.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import wofz

from soundspaces_sim.core.numerics.kernel import part

_STEP = 0.01
_END = 8.0  # of the table of `_fresnel_tail`; beyond it the series' first missing term is 15 / (2u²)³ < 1e-5
_ROOT_J = np.exp(1j * np.pi / 4.0)
_GRID = np.arange(0.0, _END + 2.5 * _STEP, _STEP)
#: e^(ju²) times the integral of e^(-jt²) from u on
_TABLE = np.sqrt(np.pi) / 2.0 / _ROOT_J * wofz(1j * _ROOT_J * _GRID)
_TAPERED = 4.0 * np.pi  # phase of a detour from which on the part beyond an end counts as nothing
_MIN_SINE = 1e-9  # nearer to a shadow boundary, rad, the cotangent is taken beside it


@part(forceinline=True)
def _fresnel_tail(u: float) -> complex:
    """e^(ju²) times the integral of e^(-jt²) from u >= 0 to infinity."""
    if u < _END:
        i = int(u / _STEP)
        x = u / _STEP - i
        # quadratic through three entries: 1e-7
        a, b, c = _TABLE[i], _TABLE[i + 1], _TABLE[i + 2]
        return a + x * (b - a) + 0.5 * x * (x - 1.0) * (c - 2.0 * b + a)
    v = 0.5j / (u * u)  # integration by parts
    return (1.0 + v + 3.0 * v * v) / (2j * u)


class WedgeTerms(NamedTuple):
    """What the terms of eq. (25) are at all wave numbers: the two of the incident wave, then those of the waves
    that the first face reflects and that the second one does."""

    cot: tuple[float, float, float, float]
    root: tuple[float, float, float, float]  # sqrt(a± / 2)


@part(forceinline=True)
def _term(n: float, psi: float, sign: float) -> tuple[float, float]:
    """(cot((pi ± psi) / 2n), sqrt(a±(psi) / 2))."""
    x = (math.pi + sign * psi) / (2.0 * n)
    s = math.sin(x)
    if abs(s) < _MIN_SINE:
        x += _MIN_SINE
        psi += sign * 2.0 * n * _MIN_SINE
        s = math.sin(x)
    m = math.floor((sign * math.pi + psi) / (2.0 * math.pi * n) + 0.5)  # N±, eq. (28)
    return math.cos(x) / s, abs(math.cos(math.pi * n * m - 0.5 * psi))  # eq. (27)


@part
def wedge_terms(n: float, phi_s: float, phi_r: float) -> WedgeTerms:
    """Of two points about a wedge."""
    minus, plus = phi_r - phi_s, phi_r + phi_s
    first, second = _term(n, minus, 1.0), _term(n, minus, -1.0)
    third, fourth = _term(n, plus, -1.0), _term(n, plus, 1.0)
    return WedgeTerms(
        (first[0], second[0], third[0], fourth[0]), (first[1], second[1], third[1], fourth[1])
    )


@part(forceinline=True)
def _cot_transition(kl: float, cot: float, root: float) -> complex:
    """cot((pi ± psi) / 2n) F(k L a±(psi)), a term of eq. (25); `kl` is k L."""
    u = math.sqrt(2.0 * kl) * root  # sqrt(k L a±)
    return cot * 2j * u * _fresnel_tail(u)  # eq. (26)


@part(forceinline=True)
def _prefactor(n: float, d_s: float, d_r: float, sin_beta: float, k: float) -> tuple[complex, float]:
    """(What stands before the sum of eq. (25), times the spreading sqrt(1 / (s s' (s + s'))); k L)."""
    kl = k * sin_beta * sin_beta * d_s * d_r / (d_s + d_r)
    size = math.sqrt(1.0 / (d_s * d_r * (d_s + d_r)))
    size = size / (2.0 * n * math.sqrt(2.0 * math.pi * k) * sin_beta)
    return -complex(math.sqrt(0.5), -math.sqrt(0.5)) * size, kl


@part
def wedge_fields(
    n: float, terms: WedgeTerms, d_s: float, d_r: float, sin_beta: float, k: float
) -> tuple[complex, complex, complex]:
    """Field diffracted at an endless edge: the terms of the incident wave, and those of the waves that the first
    face reflects and that the second one does, 1/m."""
    factor, kl = _prefactor(n, d_s, d_r, sin_beta, k)
    cot, root = terms
    return (
        factor * (_cot_transition(kl, cot[0], root[0]) + _cot_transition(kl, cot[1], root[1])),
        factor * _cot_transition(kl, cot[2], root[2]),
        factor * _cot_transition(kl, cot[3], root[3]),
    )


@part(forceinline=True)
def most_of_wedge(
    n: float, terms: WedgeTerms, d_s: float, d_r: float, sin_beta: float, k: float
) -> float:
    """Bound of the sum of `wedge_fields`, 1/m: |F(x)| is at most 1 and sqrt(pi x), so that a term is at most
    |cot| and n sqrt(2 pi k L), half of the geometrical wave."""
    factor, kl = _prefactor(n, d_s, d_r, sin_beta, k)
    most, total = n * math.sqrt(2.0 * math.pi * kl), 0.0
    for t in range(4):
        total += min(most, abs(terms.cot[t]))
    return total * math.sqrt(factor.real**2 + factor.imag**2)


@part
def wedge_field(
    n: float, terms: WedgeTerms, d_s: float, d_r: float, sin_beta: float, k: float
) -> tuple[complex, complex]:
    """`wedge_fields` with those of the reflected waves together."""
    incident, first, second = wedge_fields(n, terms, d_s, d_r, sin_beta, k)
    return incident, first + second


@part
def reflected_fields(
    n: float, terms: WedgeTerms, d_s: float, d_r: float, sin_beta: float, k: float
) -> tuple[complex, complex]:
    """The last two of `wedge_fields` alone."""
    factor, kl = _prefactor(n, d_s, d_r, sin_beta, k)
    cot, root = terms
    return factor * _cot_transition(kl, cot[2], root[2]), factor * _cot_transition(kl, cot[3], root[3])


@part(forceinline=True)
def share_beyond_end(k: float, detour: float) -> complex:
    """Part of an endless edge's field that comes from beyond an end with this detour, m.

    It is tapered where it is small and its phase varies too fast for a few points per band to tell its mean, zero.
    """
    phase = k * detour
    if phase >= _TAPERED:
        return 0j
    u = math.sqrt(phase)
    taper = 1.0 if phase < 0.5 * _TAPERED else math.cos(math.pi * (phase / _TAPERED - 0.5)) ** 2
    rotation = complex(math.cos(0.25 * math.pi - phase), math.sin(0.25 * math.pi - phase))
    return taper / math.sqrt(math.pi) * rotation * _fresnel_tail(u)


@part
def share_of_edge(
    k: float, apex: float, length: float, detours: tuple[float, float], cuts: tuple[float, float]
) -> complex:
    """Part of an endless edge's field that an edge from 0 to `length` m has, its apex at `apex` m.

    `detours`: by way of the start and of the end, m, over the path by the apex. `cuts`: parts of what comes from
    beyond them that the edge lacks; 1 where it ends, 0 where it goes on.
    """
    share = 1.0 + 0j
    if cuts[0] > 0.0:
        beyond = share_beyond_end(k, detours[0])
        share -= cuts[0] * (1.0 - beyond if apex < 0.0 else beyond)
    if cuts[1] > 0.0:
        beyond = share_beyond_end(k, detours[1])
        share -= cuts[1] * (1.0 - beyond if apex > length else beyond)
    return share
