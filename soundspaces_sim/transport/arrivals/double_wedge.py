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

`complex_directions` has D and the contour of s.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport.arrivals.complex_directions import (
    DIRECTIONS,
    NODES,
    WEIGHTS,
    EndTerms,
    FieldScratch,
    make_end_terms,
    make_field_scratch,
    set_field,
)

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
