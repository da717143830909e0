"""The field by an edge against the equations of the uniform theory, written out with scipy's special functions."""

from typing import Any

import numpy as np
from scipy import optimize
from scipy.special import fresnel

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.transport.arrivals.field import (
    EdgePath,
    beyond_end,
    field_at,
    front_of,
    most_of_edge,
    of_end,
    terms_of,
)
from soundspaces_sim.transport.arrivals.two_edges import shortest_path
from soundspaces_sim.transport.arrivals.wedges import Wedges


@kernel
def edge_fields(cases: np.ndarray, fields: np.ndarray, bounds: np.ndarray) -> None:
    """Rows of n, phi_s, phi_r, d_s, d_r, sin_beta, k, apex, length, start, end, and the amplitudes that both faces
    reflect: the field and its bound."""
    for i in range(len(cases)):
        n, phi_s, phi_r, d_s, d_r, sin_beta, k, apex, length, start, end, one, two = cases[i]
        plus = phi_r + phi_s
        other = 2.0 * np.pi * n - plus
        path = EdgePath(
            n, phi_r - phi_s, plus, other, d_s, d_r, sin_beta, apex, length, start, end, 1.0
        )  # fmt: skip
        terms = terms_of(path)
        fields[i] = field_at(path, front_of(path, terms), k, (one, two))
        bounds[i] = most_of_edge(path, terms, k, (one, two))


def endless(cases: np.ndarray) -> np.ndarray:
    """Rows of `edge_fields` of edges without end between rigid faces, of their first seven columns."""
    rest = [0.5, 1.0, np.inf, np.inf, 1.0, 1.0]
    return np.column_stack([cases, np.tile(rest, (len(cases), 1))])


def found_fields(cases: np.ndarray) -> np.ndarray:
    """(m,) of rows of `edge_fields`."""
    out = np.empty(len(cases), complex)
    edge_fields(np.ascontiguousarray(cases), out, np.empty(len(cases)))
    return out


@kernel
def end_parts(cases: np.ndarray, out: np.ndarray) -> None:
    """Rows of k, detour, boundary: `beyond_end` and what `of_end` leaves of it."""
    for i in range(len(cases)):
        k, detour, boundary = cases[i]
        out[i, 0] = beyond_end(k, detour)
        out[i, 1] = of_end(out[i, 0], detour, boundary)


def _to_infinity(u: float) -> complex:
    """The integral of e^(-jt²) from u to infinity."""
    s, c = fresnel(u * np.sqrt(2.0 / np.pi))
    return complex(np.sqrt(np.pi / 2.0) * ((0.5 - c) - 1j * (0.5 - s)))


def _transition(x: float) -> complex:
    """F(X): Kouyoumjian & Pathak 1974, eq. (26)."""
    return complex(2j * np.sqrt(x) * np.exp(1j * x) * _to_infinity(np.sqrt(x)))


def _terms(n: float, psi: float, kl: float) -> list[complex]:
    """Both terms of eq. (25) for one angle psi = phi ∓ phi'."""
    terms = []
    for sign in (1, -1):
        whole = min(range(-3, 4), key=lambda m: abs(2.0 * np.pi * n * m - psi - sign * np.pi))  # (28)
        a = 2.0 * np.cos((2.0 * np.pi * n * whole - psi) / 2.0) ** 2  # (27)
        terms.append(_transition(kl * a) / np.tan((np.pi + sign * psi) / (2.0 * n)))
    return terms


def by_hand(
    n: float, phi_s: float, phi_r: float, d_s: float, d_r: float, sin_beta: float, k: float
) -> list[list[complex]]:
    """The terms of eq. (25), times the spreading: the incident wave's two, and the reflected one's."""
    kl = k * d_s * d_r / (d_s + d_r) * sin_beta**2
    factor = -np.exp(-0.25j * np.pi) / (2.0 * n * np.sqrt(2.0 * np.pi * k) * sin_beta)
    factor *= np.sqrt(1.0 / (d_s * d_r * (d_s + d_r)))
    return [[factor * term for term in _terms(n, psi, kl)] for psi in (phi_r - phi_s, phi_r + phi_s)]


def _cases(count: int) -> np.ndarray:
    rng = np.random.default_rng(8)
    n = rng.uniform(1.05, 2.0, count)
    phi = np.sort(rng.uniform(0.02, 0.98, (count, 2)), axis=1) * (n * np.pi)[:, None]
    return np.column_stack(
        [
            n,
            phi,
            rng.uniform(0.2, 8.0, (count, 2)),
            rng.uniform(0.3, 1.0, count),
            rng.uniform(1.0, 300.0, count),
        ]
    )


def _weaker_than_free(
    cases: np.ndarray, terms: np.ndarray, field: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    weak = np.abs(field) * (cases[:, 3] + cases[:, 4]) < 2.0
    return cases[weak], terms[weak], field[weak]


def test_the_field_is_that_of_its_equations() -> None:
    """(T30): the sum of four terms, where that is not more than twice the free field."""
    cases = _cases(500)
    terms = np.array([by_hand(*case) for case in cases.tolist()])
    expected = terms.sum(axis=(1, 2))
    cases, terms, expected = _weaker_than_free(cases, terms, expected)
    assert len(cases) > 300
    off = np.abs(found_fields(endless(cases)) - expected) / np.abs(terms).sum(axis=(1, 2))
    assert (off < 1e-5).all(), off.max()  # what the asymptotic series leaves out of F


def test_faces_take_of_the_terms_of_their_reflection() -> None:
    """In light and shadow alike, each its own: by_hand has the term of pi + psi first, which is the second face's."""
    cases, rng = _cases(400), np.random.default_rng(12)
    mirror = rng.uniform(0.0, 1.0, (400, 2))
    rows = endless(cases)
    rows[:, -2:] = mirror
    incident, reflected = np.moveaxis(np.array([by_hand(*c) for c in cases.tolist()]), 1, 0)
    to_shadow = np.pi - (cases[:, 2] - cases[:, 1])
    total = incident.sum(axis=1) + (reflected * mirror[:, ::-1]).sum(axis=1)
    sizes = np.abs(incident).sum(axis=1) + np.abs(reflected).sum(axis=1)
    weak = np.abs(total) * (cases[:, 3] + cases[:, 4]) < 2.0
    assert (to_shadow[weak] < 0.0).sum() > 20 and (to_shadow[weak] > 0.0).sum() > 200
    assert (np.abs(found_fields(rows) - total) < 1e-5 * sizes)[weak].all()


def test_source_and_receiver_may_change_places() -> None:
    """From the other face: phi -> n pi - phi."""
    cases = _cases(200)
    swapped = cases[:, [0, 2, 1, 4, 3, 5, 6]]
    swapped[:, 1:3] = (np.pi * cases[:, :1]) - swapped[:, 1:3]
    np.testing.assert_allclose(found_fields(endless(cases)), found_fields(endless(swapped)), rtol=1e-5)


def test_no_field_is_above_its_bound() -> None:
    """In light and shadow and on their boundary, of edges with ends and without; far from it the bound is near the
    field. Beyond an end, where both ends are tapered to nothing, both are nothing."""
    cases, rng = _cases(2000), np.random.default_rng(9)
    cases[:300, 2] = np.minimum(cases[:300, 1] + np.pi + 1e-6, np.pi * cases[:300, 0])
    rows = endless(cases)
    rows[::2, 7] = rng.choice([-1.0, 0.5, 2.0], 1000)
    rows[::2, 9:11] = rng.uniform(0.0, 14.0, (1000, 2)) / cases[::2, 6:7]
    rows[::3, -2:] = rng.uniform(0.0, 1.0, (667, 2))
    field, bound = np.empty(2000, complex), np.empty(2000)
    edge_fields(rows, field, bound)
    nothing = bound == 0.0
    assert np.isfinite(bound).all() and (field[nothing] == 0.0).all() and 0 < nothing.sum() < 200
    ratio = np.abs(field) / np.where(nothing, 1.0, bound)
    assert np.isfinite(ratio).all()
    assert (ratio <= 1.0 + 1e-6).all() and np.quantile(ratio[1::2], 0.9) > 0.5


def test_what_lies_beyond_an_end_is_fresnels_integral() -> None:
    """(T33), where nothing is tapered: u below sqrt(2 pi); and tapered to nothing from twice that phase on."""
    rng = np.random.default_rng(4)
    k, u = rng.uniform(1.0, 100.0, 300), rng.uniform(0.0, np.sqrt(2.0 * np.pi), 300)
    found = np.empty((300, 2), complex)
    end_parts(np.column_stack([k, u**2 / k, np.full(300, 1e9)]), found)
    expected = np.array([_to_infinity(x) for x in u]) * np.exp(0.25j * np.pi) / np.sqrt(np.pi)
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-5)
    end_parts(np.column_stack([k, 4.001 * np.pi / k, np.full(300, 1e9)]), found)
    assert (found[:, 0] == 0.0).all() and (found[:, 1] == 1.0).all()


def test_between_its_ends_an_edge_has_fresnels_integral() -> None:
    """At the boundary of a shadow, where m is 1 for every end that is off the path: half of both ends' parts."""
    rng = np.random.default_rng(5)
    k, u = rng.uniform(1.0, 100.0, 200), rng.uniform(0.2, np.sqrt(2.0 * np.pi), (200, 2))
    sign = np.where(rng.uniform(size=200) < 0.3, -1.0, 1.0)  # of the start: the apex is before it
    out = np.empty((2, 200, 2), complex)
    for n in range(2):
        end_parts(np.column_stack([k, u[:, n] ** 2 / k, np.full(200, 1e9)]), out[n])
    share = 0.5 * (sign * out[0, :, 1] + out[1, :, 1])
    expected = [
        (_to_infinity(-s * a) - _to_infinity(b)) * np.exp(0.25j * np.pi) / np.sqrt(np.pi)
        for s, (a, b) in zip(sign, u, strict=True)
    ]
    np.testing.assert_allclose(share, expected, atol=2e-5)


@kernel
def _shortest(wedges: Wedges, p: np.ndarray, q: np.ndarray, out: np.ndarray) -> None:
    out[0], out[1] = shortest_path(wedges, 0, 1, (p[0], p[1], p[2]), (q[0], q[1], q[2]))


def test_the_shortest_path_by_two_parallel_lines() -> None:
    """Against a general minimizer of its length."""
    rng, minimize = np.random.default_rng(2), optimize.minimize
    for turn in (1.0, -1.0) * 10:
        start, along = rng.uniform(-2.0, 2.0, (2, 3)), np.tile(rng.normal(size=3), (2, 1))
        along /= np.linalg.norm(along, axis=1)[:, None]
        along[1] *= turn
        face = np.cross(along, rng.normal(size=3))
        face /= np.linalg.norm(face, axis=1)[:, None]
        two, p, q = np.full(2, 2.0), *rng.uniform(-3.0, 3.0, (2, 3))
        lines = Wedges(
            start,
            along,
            two,
            face,
            np.cross(along, face),
            two,
            0.0 * start,
            0.0 * start,
            np.zeros((2, 2), bool),
        )
        found = np.empty(2)
        _shortest(lines, p, q, found)

        def length(z: np.ndarray, at: Any = start, to: Any = along, ends: Any = (p, q)) -> float:
            x = at + z[:, None] * to
            return float(
                sum(np.linalg.norm(leg) for leg in (ends[0] - x[0], x[0] - x[1], x[1] - ends[1]))
            )

        best: Any = minimize(
            length, [1.0, 1.0], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-14}
        )
        np.testing.assert_allclose(found, best.x, atol=1e-4)
