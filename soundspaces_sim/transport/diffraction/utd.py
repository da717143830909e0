"""Diffraction at a rigid wedge: the uniform theory (Kouyoumjian & Pathak 1974), and edges that end.

Pressures are complex amplitudes e^(-jkr)/r, as in free field; what is computed leaves e^(-jk(d_S + d_R)) out.
The sector that is open to sound spans `n` pi; a source at the angle `ts` and a receiver at `tr` > `ts` from one
face, `rs` and `rr` m from the edge, `dz` m apart along it.

An edge that ends takes the part of the infinite one's field that comes from between its ends: with u^2 = k times
the detour by way of an end, over that by the apex, the complementary Fresnel integral from -u_1 to u_2. It is the
stationary-phase form of the edge integral (Svensson et al. 1999), and makes the field slide, not step, where the
apex runs off the edge.
"""

import math

import numpy as np
from scipy.special import wofz

from soundspaces_sim.core.numerics.bands import log_edges
from soundspaces_sim.core.numerics.kernel import part

_STEP = 0.01
_END = 8.0  # of the table of `_tail`; further on its asymptotic series is exact to 1e-6
_TURN = np.exp(1j * np.pi / 4.0)
_GRID = np.arange(0.0, _END + 2.5 * _STEP, _STEP)
#: e^(ju²) times the integral of e^(-jt²) from u on
_TABLE = np.sqrt(np.pi) / 2.0 / _TURN * wofz(1j * _TURN * _GRID)
_FADED = 4.0 * np.pi
_TOO_NEAR = 1e-9  # of a shadow boundary, rad


def wave_numbers(bands: tuple[float, ...], points: int, c: float) -> np.ndarray:
    """(B, points) 1/m: Gauss points in log f of every band; a band from 0 Hz is taken as an octave."""
    edges = log_edges(bands)
    if bands[0] == 0.0:
        edges[0] = 0.5 * edges[1]  # lower, waves are longer than the walls that the edges are of
    x = np.polynomial.legendre.leggauss(points)[0]
    middle, half = 0.5 * np.log(edges[1:] * edges[:-1]), 0.5 * np.log(edges[1:] / edges[:-1])
    return np.asarray(2.0 * np.pi / c * np.exp(middle[:, None] + half[:, None] * x))


def band_weights(points: int) -> np.ndarray:
    """(points,) weights of `wave_numbers`, which sum to one."""
    return np.asarray(0.5 * np.polynomial.legendre.leggauss(points)[1])


@part(forceinline=True)
def _tail(u):
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
def _term(n, kl, angle, sign):
    """cot((pi ± angle) / 2n) F(k L a±)."""
    x = (math.pi + sign * angle) / (2.0 * n)
    s = math.sin(x)
    if abs(s) < _TOO_NEAR:
        x += _TOO_NEAR
        angle += sign * 2.0 * n * _TOO_NEAR
        s = math.sin(x)
    m = math.floor((sign * math.pi + angle) / (2.0 * math.pi * n) + 0.5)
    a = math.cos(math.pi * n * m - 0.5 * angle)
    root = math.sqrt(2.0 * kl) * abs(a)
    return math.cos(x) / s * 2j * root * _tail(root)


@part(forceinline=True)
def _scale(n, ds, dr, sin_beta, k):
    """(What the terms are multiplied by, k L)."""
    kl = k * sin_beta * sin_beta * ds * dr / (ds + dr)
    scale = math.sqrt(1.0 / (ds * dr * (ds + dr))) / (2.0 * n * math.sqrt(2.0 * math.pi * k) * sin_beta)
    return -complex(math.sqrt(0.5), -math.sqrt(0.5)) * scale, kl


@part
def wedge(n, ts, tr, ds, dr, sin_beta, k):
    """Field of an infinite edge over e^(-jk(d_S + d_R)): the terms of the incident wave, and of its mirror image.

    `ds`, `dr`: legs, m; `sin_beta` of the angle between edge and legs.
    """
    factor, kl = _scale(n, ds, dr, sin_beta, k)
    near, far = tr - ts, tr + ts
    return (
        factor * (_term(n, kl, near, 1.0) + _term(n, kl, near, -1.0)),
        factor * (_term(n, kl, far, 1.0) + _term(n, kl, far, -1.0)),
    )


@part
def image_term(n, ts, tr, ds, dr, sin_beta, k):
    """The second of `wedge` alone."""
    factor, kl = _scale(n, ds, dr, sin_beta, k)
    return factor * (_term(n, kl, tr + ts, 1.0) + _term(n, kl, tr + ts, -1.0))


@part(forceinline=True)
def beyond(k, detour):
    """Part of the infinite edge's field that comes from beyond an end with this detour, m.

    It fades where it is small and its phase turns too often for a few points per band to tell its mean, nought.
    """
    phase = k * detour
    if phase >= _FADED:
        return 0j
    u = math.sqrt(phase)
    share = 1.0 if phase < 0.5 * _FADED else math.cos(math.pi * (phase / _FADED - 0.5)) ** 2
    turn = complex(math.cos(0.25 * math.pi - phase), math.sin(0.25 * math.pi - phase))
    return share / math.sqrt(math.pi) * turn * _tail(u)


@part
def finite(k, apex, length, low, high):
    """Part of the infinite edge's field that an edge from 0 to `length` m has, its apex at `apex` m.

    `low`, `high`: detours by way of the ends, m, over the path by the apex.
    """
    first, second = beyond(k, low), beyond(k, high)
    if apex < 0.0:
        return first - second
    if apex > length:
        return second - first
    return 1.0 - first - second
