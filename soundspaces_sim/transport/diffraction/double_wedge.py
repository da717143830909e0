"""The field that goes by one of two parallel edges and then by the other, exact in two dimensions.

Between two parallel edges a wave is a spectrum of plane waves of complex directions: with s from -oo to oo,

    u(r) = integral of g(js) e^(-j kappa r cosh s) ds,  kappa = k sin beta.

What a wedge makes of a plane wave from a complex direction is Sommerfeld's solution at that angle, so the path
from p by the edges e and f to q brings (docs/theory.md, Two edges; `two_edges` makes it a point source's)

    u = h sqrt(j kappa / 2 pi) e^(-j kappa (r_p + r_q)) / sqrt(r_p r_q)
        * integral of D_e(phi_p, phi_f + js; r_p) D_f(phi_e ± js, phi_q; r_q) e^(-j kappa w cosh s) ds

with D the coefficient of `utd` for L = r_p and L = r_q, w between the edges, and h = 1/2 where a face connects
them: there the integrand is even, for D holds the image in the face already. As the poles of D_e and D_f at the
shadow boundaries are in the integrand, u is continuous with the path by one edge alone, whichever of both ends
crosses the plane of the face. Along a common face waves go to and fro between the edges; with K the response of an
edge to a wave from the other one,

    K(t, s) = -1 / (4 pi n) sum over ±, ± of cot((pi ± (jt ± js)) / 2n),

what leaves e, a_e = g_e + K_e a_f, and a_f = g_f + K_f a_e, is a Fredholm equation of the second kind, which is
solved. So thin walls need no rule of their own.

The contour runs from 0 to where the integrand decays, s = x - j psi tanh x.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport.diffraction import spectrum

#: Panels of the contour, four Gauss points each: 0.06 dB down to kappa w = 0.02.
_BREAKS = np.array([0.0, 0.08, 0.45, 1.5, 4.5])
_TILT = 1.0  # rad, psi
_RANK = 3  # of K: with more, fields change by less than 0.01 %
_CLASSES = 51  # of wedge indices from 1 to 2, for K
_MAX_COUPLED = 8.0  # kappa w, beyond which a wave that came to and fro is below 0.03 dB
_NEGLIGIBLE = 7.0  # e^-7: of the integrand
_FAR = 12.0  # |z|², from which on F(z²) is its series
_MIN_SINE = 1e-12
_QUARTER = complex(math.sqrt(0.5), math.sqrt(0.5))  # e^(j pi / 4)
_FRONT = 1j * math.sqrt(math.pi) / _QUARTER
_ROOT_PI = 1.0 / math.sqrt(math.pi)


def _contour() -> tuple[np.ndarray, np.ndarray]:
    """(Nodes s, weights ds)."""
    x, w = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(_BREAKS)[:, None]
    real = (0.5 * (_BREAKS[1:] + _BREAKS[:-1])[:, None] + half * x).ravel()
    weight = (half * w).ravel()
    return real - 1j * _TILT * np.tanh(real), weight * (1.0 - 1j * _TILT / np.cosh(real) ** 2)


def _response(n: float, s: np.ndarray) -> np.ndarray:
    """K(t, s) of a wedge at the nodes."""
    t, both = 1j * s[:, None], 1j * s[None, :]
    angles = (t + both, t - both, -t + both, -t - both)
    return np.asarray(-sum(1.0 / np.tan((np.pi + x) / (2.0 * n)) for x in angles) / (4.0 * np.pi * n))


def _factors() -> tuple[np.ndarray, np.ndarray]:
    """(classes, nodes, rank) twice: K of each class of wedges as a product."""
    u, size, v = np.linalg.svd(np.array([_response(n, _NODES) for n in np.linspace(1.0, 2.0, _CLASSES)]))
    left = u[:, :, :_RANK] * size[:, None, :_RANK]
    return np.ascontiguousarray(left), np.ascontiguousarray(v[:, :_RANK].transpose(0, 2, 1))


_NODES, _WEIGHTS = _contour()
NODES = len(_NODES)
_RISE = np.cosh(_NODES) - 1.0
_COSH_HALF, _SINH_HALF = np.cosh(0.5 * _NODES), np.sinh(0.5 * _NODES)
_LEFT, _RIGHT = _factors()
_TERMS = 8


def _faddeeva_terms() -> tuple[float, np.ndarray]:
    """Weideman (1994, Computation of the complex error function, SIAM J. Numer. Anal. 31): (L, coefficients)."""
    m = 2 * _TERMS
    scale = math.sqrt(_TERMS / math.sqrt(2.0))
    t = scale * np.tan(0.5 * np.arange(1 - m, m) * np.pi / m)
    f = np.concatenate([[0.0], np.exp(-(t**2)) * (scale**2 + t**2)])
    a = np.real(np.fft.fft(np.fft.fftshift(f))) / (2 * m)
    return scale, a[1 : _TERMS + 1].copy()


_SCALE, _COEFFICIENTS = _faddeeva_terms()


@part(forceinline=True)
def reciprocal(z: complex) -> complex:
    """1 / z, without the care for overflow that a division takes."""
    size = 1.0 / (z.real * z.real + z.imag * z.imag)
    return complex(z.real * size, -z.imag * size)


@part(forceinline=True)
def _upper_faddeeva(z: complex) -> complex:
    """w(z) = e^(-z²) erfc(-jz) for Im z >= 0."""
    inverse = reciprocal(_SCALE - 1j * z)
    x, p = (_SCALE + 1j * z) * inverse, 0j
    for i in range(_TERMS - 1, -1, -1):
        p = p * x + _COEFFICIENTS[i]
    return inverse * (2.0 * p * inverse + _ROOT_PI)


@part
def transition(z: complex) -> complex:
    """F(z²) of Kouyoumjian & Pathak for a complex root z, continued from Re z > 0."""
    zeta = 1j * _QUARTER * z
    squared = z * z
    if zeta.imag >= 0.0:
        if squared.real * squared.real + squared.imag * squared.imag > _FAR * _FAR:
            v = 0.5j * reciprocal(squared)
            return 1.0 + v * (1.0 + v * (3.0 + 15.0 * v))
        w = _upper_faddeeva(zeta)
    else:
        w = 2.0 * cmath.exp(1j * squared) - _upper_faddeeva(-zeta)
    return _FRONT * z * w


class EndTerms(NamedTuple):
    """The four terms of D about an edge at the nodes, for waves to or from the other edge; the second half of the
    rows is for -s."""

    cot: np.ndarray  # (2 NODES, 4) complex
    root: np.ndarray  # (2 NODES, 4) complex: the root of a, times sqrt(2)


class DoubleWedgeScratch(NamedTuple):
    """What a thread works in: terms of p about e and f, of q about f and e, and their fields."""

    p_e: EndTerms
    p_f: EndTerms
    q_f: EndTerms
    q_e: EndTerms
    field: np.ndarray  # (4, 2 NODES) complex
    inner: np.ndarray  # (8, _RANK) complex
    matrix: np.ndarray  # (3, _RANK, _RANK) complex
    wave: np.ndarray  # (n,) complex, u at wave numbers


def make_double_wedge_scratch() -> DoubleWedgeScratch:
    """Empty."""

    def terms() -> EndTerms:
        return EndTerms(*np.empty((2, 2 * NODES, 4), np.complex128))

    field, inner = np.empty((4, 2 * NODES), np.complex128), np.empty((8, _RANK), np.complex128)
    matrix = np.empty((3, _RANK, _RANK), np.complex128)
    wave = np.empty(spectrum.NODES, np.complex128)
    return DoubleWedgeScratch(terms(), terms(), terms(), terms(), field, inner, matrix, wave)


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
def set_terms(n: float, phi: float, towards: float, sense: float, even: bool, out: EndTerms) -> None:
    """Terms of an end at the angle `phi` about a wedge whose other edge is at `towards`; the complex angle grows
    with `sense` times js. `even`: only s > 0."""
    first, second = _trigonometry(n, phi, towards, 0), _trigonometry(n, phi, towards, 1)
    third, fourth = _trigonometry(n, phi, towards, 2), _trigonometry(n, phi, towards, 3)
    of_terms = (first, second, third, fourth)
    for i in range(NODES):
        spread = cmath.exp(_NODES[i] / (2.0 * n))
        cosh, sinh = 0.5 * (spread + reciprocal(spread)), 0.5 * (spread - reciprocal(spread))
        for half in range(1 if even else 2):
            turn = sense if half == 0 else -sense
            for t in range(4):
                c, s, c_a, s_a = of_terms[t]
                # cot(x + j y), y = sign turn s / 2n
                y = 1j * (turn if t % 2 == 0 else -turn) * sinh
                out.cot[half * NODES + i, t] = (c * cosh - s * y) * reciprocal(s * cosh + c * y)
                root = c_a * _COSH_HALF[i] + 1j * turn * s_a * _SINH_HALF[i]
                out.root[half * NODES + i, t] = root if c_a >= 0.0 else -root


@part
def _set_field(n: float, r: float, kappa: float, terms: EndTerms, rows: int, field: np.ndarray) -> None:
    """D sqrt(2 pi kappa) / sqrt(r) at so many rows."""
    size, scale = math.sqrt(2.0 * kappa * r), -1.0 / (2.0 * n * math.sqrt(r)) / _QUARTER
    for i in range(rows):
        total = 0j
        for t in range(4):
            total += terms.cot[i, t] * transition(size * terms.root[i, t])
        field[i] = scale * total


class Ends(NamedTuple):
    """What two parallel edges and both ends are to each other; lengths across the edges, m."""

    n_e: float
    n_f: float
    p_e: float  # m, from p to e
    q_f: float
    p_f: float  # m, 0: p does not see f
    q_e: float  # m, 0: q does not see e
    w: float  # m, between the edges
    common: bool  # a face connects them


@part
def _active(kappa_w: float) -> int:
    """How many nodes count."""
    last = 0
    for i in range(NODES):
        if kappa_w * -_RISE[i].imag < _NEGLIGIBLE:
            last = i + 1
    return last


@part
def double_wedge_field(ends: Ends, kappa: float, scratch: DoubleWedgeScratch) -> complex:
    """u of the path p, e, f, q without its phase e^(-j kappa (r_p + w + r_q)), free field 1 / sqrt(r), the terms
    being set; along a common face with all that goes to and fro and leaves by f."""
    count, field = _active(kappa * ends.w), scratch.field
    _set_field(ends.n_e, ends.p_e, kappa, scratch.p_e, count, field[0])
    _set_field(ends.n_f, ends.q_f, kappa, scratch.q_f, count, field[1])
    scale = 1.0 / (2.0 * math.pi * kappa) * cmath.sqrt(1j * kappa / (2.0 * math.pi))
    total = 0j
    for i in range(count):
        total += _WEIGHTS[i] * cmath.exp(-1j * kappa * ends.w * _RISE[i]) * field[0, i] * field[1, i]
    if ends.common:
        if kappa * ends.w < _MAX_COUPLED:
            total += _to_and_fro(ends, kappa, count, scratch)
        return scale * total
    for half in range(2):
        end = scratch.p_e if half == 0 else scratch.q_f
        n, r = (ends.n_e, ends.p_e) if half == 0 else (ends.n_f, ends.q_f)
        other = EndTerms(end.cot[NODES:], end.root[NODES:])
        _set_field(n, r, kappa, other, count, field[half])
    for i in range(count):
        total += _WEIGHTS[i] * cmath.exp(-1j * kappa * ends.w * _RISE[i]) * field[0, i] * field[1, i]
    return scale * total


@part
def _class_of(n: float) -> int:
    return min(max(int((n - 1.0) * (_CLASSES - 1) + 0.5), 0), _CLASSES - 1)


@part
def _project(c: int, count: int, weight: np.ndarray, field: np.ndarray, out: np.ndarray) -> None:
    """What K of class c takes of a field."""
    for r in range(_RANK):
        out[r] = 0j
        for i in range(count):
            out[r] += _RIGHT[c, i, r] * weight[i] * field[i]


@part
def _weighted(c: int, d: int, count: int, weight: np.ndarray, out: np.ndarray) -> None:
    """R_c W L_d of two classes."""
    for r in range(_RANK):
        for t in range(_RANK):
            out[r, t] = 0j
            for i in range(count):
                out[r, t] += _RIGHT[c, i, r] * weight[i] * _LEFT[d, i, t]


@part
def _solve(matrix: np.ndarray, x: np.ndarray) -> None:
    """x <- matrix^-1 x by Gauss's elimination with pivots, in place."""
    for c in range(_RANK):
        best = c
        for r in range(c + 1, _RANK):
            if abs(matrix[r, c]) > abs(matrix[best, c]):
                best = r
        for t in range(c, _RANK):
            matrix[c, t], matrix[best, t] = matrix[best, t], matrix[c, t]
        x[c], x[best] = x[best], x[c]
        for r in range(c + 1, _RANK):
            share = matrix[r, c] / matrix[c, c]
            for t in range(c, _RANK):
                matrix[r, t] -= share * matrix[c, t]
            x[r] -= share * x[c]
    for c in range(_RANK - 1, -1, -1):
        for t in range(c + 1, _RANK):
            x[c] -= matrix[c, t] * x[t]
        x[c] /= matrix[c, c]


@part
def _leaving(c: int, count: int, weight: np.ndarray, b: np.ndarray, field: np.ndarray) -> complex:
    """The integral of L b, times what an end takes of it."""
    total = 0j
    for i in range(count):
        wave = 0j
        for r in range(_RANK):
            wave += _LEFT[c, i, r] * b[r]
        total += weight[i] * wave * field[i]
    return total


@part
def _to_and_fro(ends: Ends, kappa: float, count: int, scratch: DoubleWedgeScratch) -> complex:
    """What the path takes on by waves that go to and fro between the edges: with K = L R, W the integral's weights,
    b_e = R_e W a_f and b_f = R_f W a_e, a = g + L b.

    Waves that leave p towards f count where q does not see e, else they are a path of their own; waves that leave
    by e where q sees it.
    """
    e, f = _class_of(ends.n_e), _class_of(ends.n_f)
    field, inner, matrix = scratch.field, scratch.inner, scratch.matrix
    weight, b_e, b_f, c = field[0, NODES:], inner[0], inner[1], inner[2]
    across = cmath.exp(-1j * kappa * ends.w)
    for i in range(count):
        weight[i] = _WEIGHTS[i] * cmath.exp(-1j * kappa * ends.w * _RISE[i]) * across
    _project(f, count, weight, field[0], b_f)
    _weighted(e, f, count, weight, matrix[0])
    _weighted(f, e, count, weight, matrix[1])
    b_e[:] = 0j
    if ends.p_f > 0.0 and ends.q_e == 0.0:
        _set_field(ends.n_f, ends.p_f, kappa, scratch.p_f, count, field[2])
        _project(e, count, weight, field[2], b_e)
        b_e *= cmath.exp(-1j * kappa * (ends.p_f - ends.p_e))
    for r in range(_RANK):
        c[r] = b_e[r]
        for t in range(_RANK):
            c[r] += matrix[0, r, t] * b_f[t]
            matrix[2, r, t] = 1.0 if r == t else 0.0
            for m in range(_RANK):
                matrix[2, r, t] -= matrix[0, r, m] * matrix[1, m, t]
    _solve(matrix[2], c)
    total = _leaving(e, count, weight, c, field[1])
    if ends.q_e > 0.0:
        for r in range(_RANK):
            for t in range(_RANK):
                b_f[r] += matrix[1, r, t] * c[t]
        _set_field(ends.n_e, ends.q_e, kappa, scratch.q_e, count, field[3])
        phase = cmath.exp(-1j * kappa * (ends.q_e - ends.q_f))
        total += phase * _leaving(f, count, weight, b_f, field[3])
    return total / across
