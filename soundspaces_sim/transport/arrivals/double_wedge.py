"""The field that goes by one of two parallel edges of a face and then by the other, exact in two dimensions.

Between two parallel edges a wave is a spectrum of plane waves of complex directions: with s from -oo to oo,

    u(r) = integral of g(js) e^(-j kappa r cosh s) ds,  kappa = k sin beta.

What a wedge makes of a plane wave from a complex direction is Sommerfeld's solution at that angle, so the path
from p by the edges e and f to q brings (docs/theory.md, Two edges; `two_edges` makes it a point source's)

    u = 1/2 sqrt(j kappa / 2 pi) e^(-j kappa (r_p + r_q)) / sqrt(r_p r_q)
        * integral of D_e(phi_p, phi_f + js; r_p) D_f(phi_e + js, phi_q; r_q) e^(-j kappa w cosh s) ds

with D the coefficient of (T30) for L = r_p and L = r_q, and w between the edges; half, as D holds the image in
the face already, and the integrand is even. As the poles of D_e and D_f at the shadow boundaries are in the
integrand, u is continuous with the path by one edge alone, whichever of both ends crosses the plane of the face.
Along the face waves go to and fro between the edges; with K the response of an edge to a wave from the other one,

    K(t, s) = -1 / (4 pi n) sum over ±, ± of cot((pi ± (jt ± js)) / 2n),

what leaves e, a_e = g_e + K_e a_f, and a_f = g_f + K_f a_e, is a Fredholm equation of the second kind, which is
solved. So thin walls need no rule of their own.

D is had at the nodes of a contour of complex directions phi + js, s from 0 to where the integrand decays,
s = x - j psi tanh x. Real and imaginary parts are arrays of their own, and loops over nodes have no branches: so
compilers do several nodes at a time.
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


_RANK = 3  # of K: with more, fields change by less than 0.01 %
_CLASSES = 51  # of wedge indices from 1 to 2, for K
_MAX_COUPLED = 8.0  # kappa w, beyond which a wave that came to and fro is below 0.03 dB
_NEGLIGIBLE = 7.0  # e^-7: of the integrand


def _response(n: float, s: np.ndarray) -> np.ndarray:
    """K(t, s) of a wedge at the nodes."""
    t, both = 1j * s[:, None], 1j * s[None, :]
    angles = (t + both, t - both, -t + both, -t - both)
    return np.asarray(-sum(1.0 / np.tan((np.pi + x) / (2.0 * n)) for x in angles) / (4.0 * np.pi * n))


def _factors() -> tuple[np.ndarray, np.ndarray]:
    """(classes, nodes, rank) twice: K of each class of wedges as a product."""
    u, size, v = np.linalg.svd(
        np.array([_response(n, DIRECTIONS) for n in np.linspace(1.0, 2.0, _CLASSES)])
    )
    left = u[:, :, :_RANK] * size[:, None, :_RANK]
    return np.ascontiguousarray(left), np.ascontiguousarray(v[:, :_RANK].transpose(0, 2, 1))


_RISE = np.cosh(DIRECTIONS) - 1.0
_LEFT, _RIGHT = _factors()


class DoubleWedgeScratch(NamedTuple):
    """What a thread works in: terms of p about e and f, of q about f and e, and their fields."""

    p_e: EndTerms
    p_f: EndTerms
    q_f: EndTerms
    q_e: EndTerms
    field: np.ndarray  # (4, NODES) complex
    weight: np.ndarray  # (NODES,) complex, of the integral
    right: np.ndarray  # (2, NODES, _RANK) complex, R W of both edges
    inner: np.ndarray  # (3, _RANK) complex
    matrix: np.ndarray  # (3, _RANK, _RANK) complex
    wave: np.ndarray  # (n,) complex, u at wave numbers
    nodes: FieldScratch


def make_double_wedge_scratch(wave_numbers: int) -> DoubleWedgeScratch:
    """Empty, for so many of them."""
    p_e, p_f, q_f, q_e = (make_end_terms() for _ in range(4))
    field, inner = np.empty((4, NODES), np.complex128), np.empty((3, _RANK), np.complex128)
    matrix, weight = np.empty((3, _RANK, _RANK), np.complex128), np.empty(NODES, np.complex128)
    right, wave = np.empty((2, NODES, _RANK), np.complex128), np.empty(wave_numbers, np.complex128)
    return DoubleWedgeScratch(
        p_e, p_f, q_f, q_e, field, weight, right, inner, matrix, wave, make_field_scratch()
    )


class Ends(NamedTuple):
    """What two parallel edges and both ends are to each other; lengths across the edges, m."""

    n_e: float
    n_f: float
    p_e: float  # m, from p to e
    q_f: float
    p_f: float  # m, 0: p does not see f
    q_e: float  # m, 0: q does not see e
    w: float  # m, between the edges


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
    being set, with all that goes to and fro and leaves by f."""
    count, field, weight = _active(kappa * ends.w), scratch.field, scratch.weight
    for i in range(count):
        phase = kappa * ends.w * _RISE[i].real
        wave = complex(math.cos(phase), -math.sin(phase))
        weight[i] = math.exp(kappa * ends.w * _RISE[i].imag) * wave * WEIGHTS[i]
    scale = 1.0 / (2.0 * math.pi * kappa) * cmath.sqrt(1j * kappa / (2.0 * math.pi))
    total = 0j
    set_field(ends.n_e, ends.p_e, kappa, scratch.p_e, count, scratch.nodes, field[0])
    set_field(ends.n_f, ends.q_f, kappa, scratch.q_f, count, scratch.nodes, field[1])
    for i in range(count):
        total += weight[i] * field[0, i] * field[1, i]
    if kappa * ends.w < _MAX_COUPLED:
        total += _to_and_fro(ends, kappa, count, scratch)
    return scale * total


@part
def _class_of(n: float) -> int:
    return min(max(int((n - 1.0) * (_CLASSES - 1) + 0.5), 0), _CLASSES - 1)


@part
def _project(count: int, right: np.ndarray, field: np.ndarray, out: np.ndarray) -> None:
    """What a wedge takes of a field, R W of its K at hand."""
    for r in range(_RANK):
        total = 0j
        for i in range(count):
            total += right[i, r] * field[i]
        out[r] = total


@part
def _weighted(d: int, count: int, right: np.ndarray, out: np.ndarray) -> None:
    """R W of a wedge at hand, times L_d of a class."""
    for r in range(_RANK):
        for t in range(_RANK):
            total = 0j
            for i in range(count):
                total += right[i, r] * _LEFT[d, i, t]
            out[r, t] = total


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
    field, inner, matrix, right = scratch.field, scratch.inner, scratch.matrix, scratch.right
    weight, b_e, b_f, c = scratch.weight, inner[0], inner[1], inner[2]
    across = cmath.exp(-1j * kappa * ends.w)
    for i in range(count):
        weight[i] *= across
        for r in range(_RANK):
            right[0, i, r] = _RIGHT[e, i, r] * weight[i]
            right[1, i, r] = _RIGHT[f, i, r] * weight[i]
    _project(count, right[1], field[0], b_f)
    _weighted(f, count, right[0], matrix[0])
    _weighted(e, count, right[1], matrix[1])
    b_e[:] = 0j
    if ends.p_f > 0.0 and ends.q_e == 0.0:
        set_field(ends.n_f, ends.p_f, kappa, scratch.p_f, count, scratch.nodes, field[2])
        _project(count, right[0], field[2], b_e)
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
        set_field(ends.n_e, ends.q_e, kappa, scratch.q_e, count, scratch.nodes, field[3])
        phase = cmath.exp(-1j * kappa * (ends.q_e - ends.q_f))
        total += phase * _leaving(f, count, weight, b_f, field[3])
    return total / across
