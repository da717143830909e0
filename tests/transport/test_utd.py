"""The uniform theory's kernels against its equations, written out with scipy's special functions."""

from typing import Any

import numpy as np
import pytest
from scipy import optimize
from scipy.special import fresnel

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.transport.arrivals.shortest_path import shortest_path
from soundspaces_sim.transport.diffraction.utd import (
    most_of_wedge,
    share_of_edge,
    wedge_field,
    wedge_terms,
)
from soundspaces_sim.transport.arrivals.wedges import Wedges


@kernel
def _wedge_fields(cases: np.ndarray, out: np.ndarray) -> None:
    for i in range(len(cases)):
        n, phi_s, phi_r, d_s, d_r, sin_beta, k = cases[i]
        out[i, 0], out[i, 1] = wedge_field(n, wedge_terms(n, phi_s, phi_r), d_s, d_r, sin_beta, k)


@kernel
def _bounds(cases: np.ndarray, out: np.ndarray) -> None:
    for i in range(len(cases)):
        n, phi_s, phi_r, d_s, d_r, sin_beta, k = cases[i]
        out[i] = most_of_wedge(n, wedge_terms(n, phi_s, phi_r), d_s, d_r, sin_beta, k)


@kernel
def _shares(cases: np.ndarray, out: np.ndarray) -> None:
    for i in range(len(cases)):
        k, apex, length, start, end = cases[i]
        out[i] = share_of_edge(k, apex, length, (start, end), (1.0, 1.0))


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


def test_the_coefficient_is_that_of_its_equations() -> None:
    cases = _cases(500)
    found = np.empty((len(cases), 2), complex)
    _wedge_fields(cases, found)
    terms = np.array([by_hand(*case) for case in cases.tolist()])
    off = np.abs(found - terms.sum(axis=2)) / np.abs(terms).sum(axis=2)
    assert (off < 1e-5).all(), off.max()  # what the asymptotic series leaves out of F


def test_source_and_receiver_may_change_places() -> None:
    """From the other face: phi -> n pi - phi."""
    cases = _cases(200)
    swapped = cases[:, [0, 2, 1, 4, 3, 5, 6]]
    swapped[:, 1:3] = (np.pi * cases[:, :1]) - swapped[:, 1:3]
    one, other = np.empty((2, len(cases), 2), complex)
    _wedge_fields(cases, one)
    _wedge_fields(swapped, other)
    np.testing.assert_allclose(one.sum(axis=1), other.sum(axis=1), rtol=1e-5)


def test_no_field_is_above_its_bound() -> None:
    """(T36a), in light and shadow and on their boundary; far from it the bound is near the field. No share of an edge
    is above 1.5."""
    cases = _cases(2000)
    cases[:300, 2] = np.minimum(cases[:300, 1] + np.pi + 1e-6, np.pi * cases[:300, 0])
    found, bound = np.empty((len(cases), 2), complex), np.empty(len(cases))
    _wedge_fields(cases, found)
    _bounds(cases, bound)
    ratio = np.abs(found.sum(axis=1)) / bound
    assert (ratio <= 1.0 + 1e-6).all() and np.quantile(ratio, 0.9) > 0.5
    rng = np.random.default_rng(9)
    k, apex = rng.uniform(1.0, 100.0, 3000), rng.choice([-1.0, 0.5, 2.0], 3000)
    shares = np.empty(3000, complex)
    _shares(
        np.column_stack([k, apex, np.ones(3000), rng.uniform(0.0, 14.0, (3000, 2)) / k[:, None]]), shares
    )
    assert np.abs(shares).max() <= 1.5


def test_an_edges_share_is_fresnels_integral_between_its_ends() -> None:
    """Where nothing is tapered: u below sqrt(2 pi)."""
    rng = np.random.default_rng(4)
    k, u = rng.uniform(1.0, 100.0, 300), rng.uniform(0.0, np.sqrt(2.0 * np.pi), (300, 2))
    apex = rng.choice([-1.0, 0.5, 2.0], 300)
    cases = np.column_stack([k, apex, np.ones(300), u**2 / k[:, None]])
    found = np.empty(300, complex)
    _shares(cases, found)
    for value, (_, at, *_), (start, end) in zip(found, cases, u, strict=True):
        low = start if at < 0.0 else -start
        high = -end if at > 1.0 else end
        integral = (_to_infinity(low) - _to_infinity(high)) * np.exp(0.25j * np.pi) / np.sqrt(np.pi)
        assert value == pytest.approx(integral, abs=1e-5)


@kernel
def _shortest(wedges: Wedges, p: np.ndarray, q: np.ndarray, out: np.ndarray) -> None:
    out[0], out[1] = shortest_path(wedges, 0, 1, (p[0], p[1], p[2]), (q[0], q[1], q[2]))


_FINE = {"xatol": 1e-10, "fatol": 1e-14}


def _length(z: np.ndarray, start: np.ndarray, along: np.ndarray, p: np.ndarray, q: np.ndarray) -> float:
    """Of the path from p by places z on two lines to q."""
    x = start + np.asarray(z)[:, None] * along
    return float(sum(np.linalg.norm(leg) for leg in (p - x[0], x[0] - x[1], x[1] - q)))


def test_the_shortest_path_by_two_lines() -> None:
    """Against a general minimizer of its length."""
    rng = np.random.default_rng(2)
    for _ in range(40):
        start, along = rng.uniform(-2.0, 2.0, (2, 3)), rng.normal(size=(2, 3))
        along /= np.linalg.norm(along, axis=1)[:, None]
        p, q = rng.uniform(-3.0, 3.0, (2, 3))
        blank, ones = np.zeros((2, 3)), np.ones(2)
        found = np.empty(2)
        _shortest(
            Wedges(
                start,
                along,
                2.0 * ones,
                blank,
                blank,
                2.0 * ones,
                blank,
                np.zeros((2, 2), bool),
                np.full((2, 2, 2), -1),
            ),
            p,
            q,
            found,
        )

        minimize: Any = optimize.minimize
        best = minimize(_length, [1.0, 1.0], (start, along, p, q), "Nelder-Mead", options=_FINE)
        assert _length(found, start, along, p, q) <= best.fun + 1e-9
        np.testing.assert_allclose(found, best.x, atol=1e-4)
