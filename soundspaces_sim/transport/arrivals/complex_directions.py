"""The coefficient D of a wedge for plane waves of complex directions, at the nodes of a contour.

`double_wedge` integrates over directions phi + js, s from 0 to where the integrand decays, s = x - j psi tanh x.
Real and imaginary parts are arrays of their own, and loops over nodes have no branches: so compilers do several
nodes at a time.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part

#: Panels of the contour, four Gauss points each: 0.06 dB down to kappa w = 0.02.
_BREAKS = np.array([0.0, 0.08, 0.45, 1.5, 4.5])
_TILT = 1.0  # rad, psi
_QUARTER = math.sqrt(0.5)  # cos and sin of pi / 4
_TERMS = 6


def _contour() -> tuple[np.ndarray, np.ndarray]:
    """(Nodes s, weights ds)."""
    x, w = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(_BREAKS)[:, None]
    real = (0.5 * (_BREAKS[1:] + _BREAKS[:-1])[:, None] + half * x).ravel()
    weight = (half * w).ravel()
    return real - 1j * _TILT * np.tanh(real), weight * (1.0 - 1j * _TILT / np.cosh(real) ** 2)


DIRECTIONS, WEIGHTS = _contour()
NODES = len(DIRECTIONS)


def _parts(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.ascontiguousarray(z.real), np.ascontiguousarray(z.imag)


_COSH_RE, _COSH_IM = _parts(np.cosh(0.5 * DIRECTIONS))
_SINH_RE, _SINH_IM = _parts(np.sinh(0.5 * DIRECTIONS))


def _faddeeva_terms() -> tuple[float, np.ndarray]:
    """Weideman (1994, Computation of the complex error function, SIAM J. Numer. Anal. 31): (L, coefficients)."""
    m = 2 * _TERMS
    scale = math.sqrt(_TERMS / math.sqrt(2.0))
    t = scale * np.tan(0.5 * np.arange(1 - m, m) * np.pi / m)
    f = np.concatenate([[0.0], np.exp(-(t**2)) * (scale**2 + t**2)])
    a = np.real(np.fft.fft(np.fft.fftshift(f))) / (2 * m)
    return scale, a[1 : _TERMS + 1].copy()


_SCALE, _COEFFICIENTS = _faddeeva_terms()
_ROOT_PI = 1.0 / math.sqrt(math.pi)
_FRONT = math.sqrt(math.pi) * _QUARTER


class EndTerms(NamedTuple):
    """The four terms of D about an edge at the nodes, for waves to or from another edge."""

    cot_re: np.ndarray  # (4, NODES)
    cot_im: np.ndarray
    root_re: np.ndarray  # (4, NODES): the root of a, times sqrt(2)
    root_im: np.ndarray
    spread: np.ndarray  # (4, NODES) cosh, sinh of s / 2n, re and im
    index: np.ndarray  # (1,) wedge index n of `spread`


class FieldScratch(NamedTuple):
    """What a thread works in, (NODES,) each."""

    f_re: np.ndarray
    f_im: np.ndarray
    sum_re: np.ndarray
    sum_im: np.ndarray


def make_end_terms() -> EndTerms:
    """Empty."""
    return EndTerms(*np.empty((4, 4, NODES)), np.empty((4, NODES)), np.zeros(1))


def make_field_scratch() -> FieldScratch:
    """Empty."""
    return FieldScratch(*np.empty((4, NODES)))


@part(error_model="numpy")
def transitions(
    count: int, size: float, re: np.ndarray, im: np.ndarray, out_re: np.ndarray, out_im: np.ndarray
) -> None:
    """F(z²) of Kouyoumjian & Pathak for `count` complex roots z = `size` (re + j im), continued from Re z > 0.

    F(z²) = sqrt(pi) e^(j pi / 4) z w(zeta), zeta = e^(3j pi / 4) z; Weideman's rational function is w(zeta) for
    Im zeta >= 0, and below w(zeta) = 2 e^(-zeta²) - w(-zeta).
    """
    for i in range(count):
        x, y = size * re[i], size * im[i]
        sign = math.copysign(1.0, x - y)
        a, b = -_QUARTER * sign * (x + y), _QUARTER * sign * (x - y)  # zeta or -zeta
        over = 1.0 / ((_SCALE + b) * (_SCALE + b) + a * a)
        inverse_re, inverse_im = (_SCALE + b) * over, a * over  # 1 / (L - j zeta)
        t_re = (_SCALE - b) * inverse_re - a * inverse_im  # (L + j zeta) / (L - j zeta)
        t_im = (_SCALE - b) * inverse_im + a * inverse_re
        p_re, p_im = 0.0, 0.0
        for n in range(_TERMS):
            p_re, p_im = (
                p_re * t_re - p_im * t_im + _COEFFICIENTS[_TERMS - 1 - n],
                p_re * t_im + p_im * t_re,
            )
        u_re = 2.0 * (p_re * inverse_re - p_im * inverse_im) + _ROOT_PI
        u_im = 2.0 * (p_re * inverse_im + p_im * inverse_re)
        w_re, w_im = inverse_re * u_re - inverse_im * u_im, inverse_re * u_im + inverse_im * u_re
        front_re, front_im = sign * _FRONT * (x - y), sign * _FRONT * (x + y)
        out_re[i] = front_re * w_re - front_im * w_im
        out_im[i] = front_re * w_im + front_im * w_re
    for i in range(count):
        x, y = size * re[i], size * im[i]
        if x < y:
            z = complex(x, y)
            wave = 2.0 * _FRONT * complex(x - y, x + y) * cmath.exp(1j * z * z)
            out_re[i] += wave.real
            out_im[i] += wave.imag


@part(forceinline=True)
def _trigonometry(n: float, phi: float, towards: float, term: int) -> tuple[float, float, float, float]:
    """(cos, sin) of a term's x in cot(x + jy), and of its a."""
    sign = 1.0 if term % 2 == 0 else -1.0
    angle = towards - phi if term < 2 else towards + phi
    x = (math.pi + sign * angle) / (2.0 * n)
    m = math.floor((sign * math.pi + angle) / (2.0 * math.pi * n) + 0.5)
    a = math.pi * n * m - 0.5 * angle
    return math.cos(x), math.sin(x), math.cos(a), math.sin(a)


@part
def _set_spread(n: float, out: EndTerms) -> None:
    for i in range(NODES):
        spread = cmath.exp(DIRECTIONS[i] / (2.0 * n))
        back = 1.0 / spread
        cosh, sinh = 0.5 * (spread + back), 0.5 * (spread - back)
        out.spread[0, i], out.spread[1, i] = cosh.real, cosh.imag
        out.spread[2, i], out.spread[3, i] = sinh.real, sinh.imag
    out.index[0] = n


@part(error_model="numpy")
def _set_term(of_term: tuple[float, float, float, float], turn: float, t: int, out: EndTerms) -> None:
    """A term for a complex angle that grows with `turn` times js."""
    c, s, c_a, s_a = of_term
    towards = turn if t % 2 == 0 else -turn
    sign = 1.0 if c_a >= 0.0 else -1.0
    cot_re, cot_im, root_re, root_im = (
        out.cot_re[t],
        out.cot_im[t],
        out.root_re[t],
        out.root_im[t],
    )
    for i in range(NODES):
        cosh_re, cosh_im = out.spread[0, i], out.spread[1, i]
        y_re, y_im = -towards * out.spread[3, i], towards * out.spread[2, i]  # j sinh
        # cot(x + j y), y = towards s / 2n
        over_re, over_im = c * cosh_re - s * y_re, c * cosh_im - s * y_im
        by_re, by_im = s * cosh_re + c * y_re, s * cosh_im + c * y_im
        size = 1.0 / (by_re * by_re + by_im * by_im)
        cot_re[i] = (over_re * by_re + over_im * by_im) * size
        cot_im[i] = (over_im * by_re - over_re * by_im) * size
        root_re[i] = sign * (c_a * _COSH_RE[i] - turn * s_a * _SINH_IM[i])
        root_im[i] = sign * (c_a * _COSH_IM[i] + turn * s_a * _SINH_RE[i])


@part
def set_terms(n: float, phi: float, towards: float, sense: float, out: EndTerms) -> None:
    """Terms of an end at the angle `phi` about a wedge whose other edge is at `towards`; the complex angle grows
    with `sense` times js."""
    if out.index[0] != n:
        _set_spread(n, out)
    for t in range(4):
        _set_term(_trigonometry(n, phi, towards, t), sense, t, out)


@part
def set_field(
    n: float,
    r: float,
    kappa: float,
    terms: EndTerms,
    count: int,
    scratch: FieldScratch,
    field: np.ndarray,
) -> None:
    """D sqrt(2 pi kappa) / sqrt(r) at the first nodes, into `field` (NODES,)."""
    size, scale = math.sqrt(2.0 * kappa * r), -_QUARTER / (2.0 * n * math.sqrt(r))
    f_re, f_im, sum_re, sum_im = scratch
    for i in range(count):
        sum_re[i] = sum_im[i] = 0.0
    for t in range(4):
        transitions(count, size, terms.root_re[t], terms.root_im[t], f_re, f_im)
        cot_re, cot_im = terms.cot_re[t], terms.cot_im[t]
        for i in range(count):
            sum_re[i] += cot_re[i] * f_re[i] - cot_im[i] * f_im[i]
            sum_im[i] += cot_re[i] * f_im[i] + cot_im[i] * f_re[i]
    for i in range(count):  # times e^(-j pi / 4)
        field[i] = scale * complex(sum_re[i] + sum_im[i], sum_im[i] - sum_re[i])
