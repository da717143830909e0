"""The field of a path by one edge, at the wave numbers of all bands: the uniform theory of diffraction (T30), for
edges that end (T33).

Source: Kouyoumjian & Pathak (1974), A uniform geometrical theory of diffraction for an edge in a perfectly
conducting surface, Proc. IEEE 62 (11), eqs. (25) to (28). The source is at the angle phi_s, the receiver at
phi_r >= phi_s, both from the first face; the legs d_s and d_r make the angle beta with the edge. Fields are
those of a source of e^(-jkr) / r, without the phase e^(-jk(d_s + d_r)).

Of the four terms two make the sum with the direct sound continuous at the boundary of its shadow, and one each that
with the reflections off both faces. All four stay one wave.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import wofz

from soundspaces_sim.core.numerics.bands import log_edges
from soundspaces_sim.core.numerics.kernel import part

POINTS = 4  # wave numbers per band
_NODES = 3  # wave numbers between which the fields of two edges are interpolated
_STEP = 0.01
_END = 8.0  # of the table of `_fresnel_tail`; beyond it the series' first missing term is 15 / (2u²)³ < 1e-5
_ROOT_J = np.exp(1j * np.pi / 4.0)
_GRID = np.arange(0.0, _END + 2.5 * _STEP, _STEP)
#: e^(ju²) times the integral of e^(-jt²) from u on
_TABLE = np.sqrt(np.pi) / 2.0 / _ROOT_J * wofz(1j * _ROOT_J * _GRID)
_ROOT_PI = math.sqrt(math.pi)
_QUARTER = math.sqrt(0.5)  # cos and sin of pi / 4
_TAPERED = 4.0 * math.pi  # phase of a detour from which on the part beyond an end counts as nothing
_MIN_SINE = 1e-9  # nearer to a shadow boundary, rad, the cotangent is taken beside it
_EXACT = 1e-4  # sine of a term's angle; below it a boundary is near, and angles are taken as they are
_TINY = 1e-30  # m
#: most that an edge of finite length has of an endless one's field (a slit: 1.34)
MOST_SHARE = 1.35
_OVER = 0.506  # |B| is at most 0.506 / sqrt(1 + pi k detour)


class Spectrum(NamedTuple):
    """Gauss-Legendre points of every band in log frequency: n of them are exact for polynomials of degree 2n -
    1."""

    k: np.ndarray  # (b, g) wave numbers, 1/m
    weight: np.ndarray  # (g,) which sum to one
    centre: np.ndarray  # (b,) geometric mean of each band's edges, 1/m
    node: np.ndarray  # (n,) bands' edges, the wave numbers at which two edges are computed, 1/m
    first: np.ndarray  # (b,) first of the nodes from which a band has their field
    between: np.ndarray  # (b, g, m) factors by which it has it at `k` from m nodes


@lru_cache(maxsize=8)
def make_spectrum(bands: tuple[float, ...], c: float) -> Spectrum:
    """Points in `bands`, their edges in Hz, at a speed of sound in m/s; a band from 0 Hz is taken as an octave.

    Fields of two edges, but for the phase of their path, change slowly, between not at all and as one over the wave
    number: times its root they are interpolated in log frequency, by polynomials through the bands' edges.
    """
    edges = log_edges(bands)
    if bands[0] == 0.0:
        edges[0] = 0.5 * edges[1]  # lower, waves are longer than the walls that the edges are of
    x, weight = np.polynomial.legendre.leggauss(POINTS)
    log = np.log(edges * (2.0 * np.pi / c))
    at = 0.5 * (log[1:] + log[:-1])[:, None] + 0.5 * np.diff(log)[:, None] * x
    count = min(_NODES, len(log))
    first = np.minimum(np.arange(len(at)), len(log) - count)
    near = log[first[:, None] + np.arange(count)]
    apart = near[:, :, None] - near[:, None, :] + np.eye(count)
    over = at[:, :, None, None] - near[:, None, None, :]  # (b, g, m, others)
    own = np.where(np.eye(count, dtype=bool), 1.0, over / apart[:, None]).prod(axis=3)
    between = own * np.exp(0.5 * (near[:, None, :] - at[:, :, None]))
    centre = np.exp(0.5 * (log[1:] + log[:-1]))
    return Spectrum(np.exp(at), 0.5 * weight, centre, np.exp(log), first, np.ascontiguousarray(between))


class EdgePath(NamedTuple):
    """The path by one edge between two ends about it, that of the smaller angle first."""

    n: float  # wedge index
    minus: float  # phi_r - phi_s, rad: pi is the boundary of the shadow
    plus: float  # phi_r + phi_s, rad: pi is the boundary of the reflection off the first face
    other: float  # 2 pi n - (phi_r + phi_s), rad: the same of the second face
    d_s: float  # m
    d_r: float  # m
    sin_beta: float
    apex: float  # m along the edge
    length: float  # m, of the edge
    start: (
        float  # m, detour by the start of the edge over the path by the apex; infinite where it goes on
    )
    end: float  # m, the same by its end
    taper: float  # 1; down to 0 where the apex lies beyond an end


class Terms(NamedTuple):
    """What the four terms are at all wave numbers: those of the incident wave, of the first face, of the second."""

    cot: tuple[float, float, float, float]
    root: tuple[float, float, float, float]  # sqrt(a± / 2)


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


@part(forceinline=True)
def _term(n: float, psi: float, sign: float) -> tuple[float, float]:
    """(cot((pi ± psi) / 2n), sqrt(a±(psi) / 2)), eqs. (27) and (28)."""
    x = (math.pi + sign * psi) / (2.0 * n)
    s = math.sin(x)
    if abs(s) < _MIN_SINE:
        x += _MIN_SINE
        psi += sign * 2.0 * n * _MIN_SINE
        s = math.sin(x)
    m = math.floor((sign * math.pi + psi) / (2.0 * math.pi * n) + 0.5)
    return math.cos(x) / s, abs(math.cos(math.pi * n * m - 0.5 * psi))


@part
def terms_of(path: EdgePath) -> Terms:
    """Of a path. The second face's term is the first one's of angles from the second face."""
    a, b = _term(path.n, path.minus, 1.0), _term(path.n, path.minus, -1.0)
    c, d = _term(path.n, path.plus, -1.0), _term(path.n, path.other, -1.0)
    return Terms((a[0], b[0], c[0], d[0]), (a[1], b[1], c[1], d[1]))


class Turn(NamedTuple):
    """An angle by cosine and sine of its parts."""

    cos: float  # of the angle over 2n
    sin: float
    half_cos: float  # of half of the angle
    half_sin: float


@part(forceinline=True)
def _sum_of(a: Turn, b: Turn, sign: float) -> Turn:
    """b + a, or b - a by a sign of -1."""
    return Turn(
        b.cos * a.cos - sign * b.sin * a.sin,
        b.sin * a.cos + sign * b.cos * a.sin,
        b.half_cos * a.half_cos - sign * b.half_sin * a.half_sin,
        b.half_sin * a.half_cos + sign * b.half_cos * a.half_sin,
    )


@part(forceinline=True)
def terms_by_turns(path: EdgePath, s: Turn, r: Turn, edge: Turn) -> tuple[bool, Terms]:
    """`terms_of` without trigonometry, from tables of both ends' angles, and of pi (`cos`, `sin`) and 2 pi n
    (`half_cos`, `half_sin`); whether they are exact, as they are but near boundaries."""
    minus, plus, sector = _sum_of(s, r, -1.0), _sum_of(s, r, 1.0), math.pi * path.n
    of = (
        edge.sin * minus.cos + edge.cos * minus.sin,
        edge.sin * minus.cos - edge.cos * minus.sin,
        edge.sin * plus.cos - edge.cos * plus.sin,
        edge.sin * plus.cos + edge.cos * plus.sin,
    )
    over = (
        edge.cos * minus.cos - edge.sin * minus.sin,
        edge.cos * minus.cos + edge.sin * minus.sin,
        edge.cos * plus.cos + edge.sin * plus.sin,
        edge.cos * plus.cos - edge.sin * plus.sin,
    )
    beyond_minus = abs(edge.half_cos * minus.half_cos + edge.half_sin * minus.half_sin)
    beyond_plus = abs(edge.half_cos * plus.half_cos + edge.half_sin * plus.half_sin)
    least = min(min(abs(of[0]), abs(of[1])), min(abs(of[2]), abs(of[3])))
    root = (
        beyond_minus if path.minus >= sector - math.pi else abs(minus.half_cos),
        abs(minus.half_cos),
        beyond_plus if path.plus >= sector + math.pi else abs(plus.half_cos),
        abs(plus.half_cos) if path.plus <= sector - math.pi else beyond_plus,
    )
    if least < _EXACT:
        return False, Terms(root, root)
    return True, Terms((over[0] / of[0], over[1] / of[1], over[2] / of[2], over[3] / of[3]), root)


@part(forceinline=True)
def _spread(path: EdgePath) -> tuple[float, float]:
    """(L, what stands before the sum of eq. (25) but for e^(-j pi/4) / sqrt(k), with the spreading of the wave)."""
    between = path.d_s * path.d_r / (path.d_s + path.d_r)
    size = math.sqrt(1.0 / (path.d_s * path.d_r * (path.d_s + path.d_r)))
    return path.sin_beta**2 * between, -size / (2.0 * path.n * math.sqrt(2.0 * math.pi) * path.sin_beta)


@part(forceinline=True)
def detours_of_ends(
    length: float, legs: tuple[float, float], z: tuple[float, float], total: float
) -> tuple[float, float]:
    """Of the ways by the ends of an edge from 0 to `length` m, over one of `total` m, between two points: their
    distances from its line, and where they are along it, m."""
    start = math.sqrt(legs[0] ** 2 + z[0] ** 2) + math.sqrt(legs[1] ** 2 + z[1] ** 2)
    end = math.sqrt(legs[0] ** 2 + (length - z[0]) ** 2) + math.sqrt(legs[1] ** 2 + (length - z[1]) ** 2)
    return max(start - total, 0.0), max(end - total, 0.0)


@part(forceinline=True)
def _most_beyond(k: float, detour: float) -> float:
    """Bound of |B| of `beyond_end`, at most 1.13 times as large."""
    phase = k * detour
    return _OVER / math.sqrt(1.0 + math.pi * phase) if phase < _TAPERED else 0.0


@part(forceinline=True)
def most_share(k: float, ends: tuple[float, float], beyond: bool) -> float:
    """Bound of the part of an endless edge's field that comes from between ends with these detours, m; `beyond`:
    the apex is not between them."""
    most = _most_beyond(k, ends[0]) + _most_beyond(k, ends[1]) if beyond else MOST_SHARE
    return min(most, math.sqrt(k) * (math.sqrt(ends[0]) + math.sqrt(ends[1])) / _ROOT_PI)


@part(forceinline=True)
def most_of_edge(path: EdgePath, terms: Terms, k: float, mirror: tuple[float, float]) -> float:
    """Bound of a field at the wave number k and above it, 1/m, `mirror` as in `field_at`. |F(x)| is at most 1 and
    sqrt(pi x), so a term is at most |cot| and half of the geometrical wave; far from boundaries terms cancel, as
    |F(x) - 1| is at most 1 / 2x."""
    l, size = _spread(path)
    most, near, far, rest = path.n * math.sqrt(2.0 * math.pi * k * l), 0.0, 0.0, 0.0
    beyond = not 0.0 <= path.apex <= path.length
    by_ends = max(path.start, path.end)
    for t in range(4):
        left = mirror[t - 2] if t >= 2 else 1.0
        cot, detour = left * abs(terms.cot[t]), 2.0 * l * terms.root[t] ** 2
        differs = 0.5 / (k * detour + _TINY)
        if beyond:  # by its own share of B too: 1 - m of (T33a)
            differs += 1.0 - detour * detour / (detour * detour + by_ends * by_ends + _TINY)
        near += min(most, cot)
        far += left * terms.cot[t]
        rest += cot * min(1.0, differs)
    total = min(near, abs(far) + rest) * most_share(k, (path.start, path.end), beyond)
    return abs(size) / math.sqrt(k) * total * math.sqrt(path.taper)


@part(forceinline=True)
def beyond_end(k: float, detour: float) -> complex:
    """B(detour) of (T33): what half a plane beyond a line takes of sound that passes it by this detour, m.

    It is tapered where it is small and its phase varies too fast for a few points per band to tell its mean, zero.
    """
    phase = k * detour
    if phase >= _TAPERED:
        return 0j
    taper = 1.0 if phase < 0.5 * _TAPERED else math.cos(math.pi * (phase / _TAPERED - 0.5)) ** 2
    turned = complex(math.cos(0.25 * math.pi - phase), math.sin(0.25 * math.pi - phase))
    return taper / _ROOT_PI * turned * _fresnel_tail(math.sqrt(phase))


@part(forceinline=True)
def of_end(beyond: complex, detour: float, boundary: float) -> complex:
    """Part of half a term that one end leaves: 1 - 2 m B, m = b² / (b² + detour²), b the detour at which the term's
    boundary is (T33a). At the boundary nothing is lost, as the wave must be continuous there, far from it all of
    B."""
    weight = boundary * boundary / (boundary * boundary + detour * detour + _TINY)
    return 1.0 - 2.0 * weight * beyond


@part(forceinline=True)
def off_reflection(path: EdgePath, angle: float) -> float:
    """1 - h of (T32), of an image's term whose boundary is at `angle` = pi: 0 there, 1 in the shadow."""
    to_shadow, to_reflection = math.pi - path.minus, angle - math.pi
    if to_shadow <= 0.0:
        return 1.0
    x = max(to_shadow - abs(to_reflection), 0.0) / (to_shadow + abs(to_reflection))
    return 1.0 - x * x * (3.0 - 2.0 * x)


class Front(NamedTuple):
    """What a path's field has in common at all wave numbers."""

    terms: Terms
    l: float  # L of eq. (25), m
    size: float  # what stands before the sum, times sqrt(k)
    most: float  # twice the free field, 1/m: a rigid face doubles it
    first: float  # -1 where the apex lies before the edge's start, else 1
    second: float  # the same beyond its end


@part
def front_of(path: EdgePath, terms: Terms) -> Front:
    """Of a path."""
    l, size = _spread(path)
    first, second = -1.0 if path.apex < 0.0 else 1.0, -1.0 if path.apex > path.length else 1.0
    return Front(terms, l, size * math.sqrt(path.taper), 2.0 / (path.d_s + path.d_r), first, second)


@part
def field_at(path: EdgePath, front: Front, k: float, mirror: tuple[float, float]) -> complex:
    """(T30) with (T33), (T33a) at a wave number, 1/m, no more than twice the free field. `mirror`: what both faces'
    images have of a rigid face's (T32)."""
    start, end, total = beyond_end(k, path.start), beyond_end(k, path.end), 0j
    for t in range(4):
        root = front.terms.root[t]
        u = math.sqrt(2.0 * k * front.l) * root  # sqrt(k L a±)
        of_term = front.terms.cot[t] * 2j * u * _fresnel_tail(u)  # eq. (26)
        boundary = 2.0 * front.l * root * root  # m
        share = front.first * of_end(start, path.start, boundary)
        share = 0.5 * (share + front.second * of_end(end, path.end, boundary))
        if t >= 2:
            share *= mirror[t - 2]
        total += of_term * share
    total *= front.size / math.sqrt(k) * complex(_QUARTER, -_QUARTER)
    size = math.sqrt(total.real**2 + total.imag**2)
    return total * (front.most / size) if size > front.most else total
