"""The field of two parallel edges of one face against its limits, which are known in closed form."""

import numpy as np
from scipy.special import wofz

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.transport.arrivals.complex_directions import set_terms, transitions
from soundspaces_sim.transport.arrivals.double_wedge import (
    DoubleWedgeScratch,
    Ends,
    double_wedge_field,
    make_double_wedge_scratch,
)
from tests.transport.test_utd import endless, found_fields


@kernel
def _transitions(re: np.ndarray, im: np.ndarray, out_re: np.ndarray, out_im: np.ndarray) -> None:
    transitions(1.0, re, im, out_re, out_im)


@kernel
def _fields(cases: np.ndarray, scratch: DoubleWedgeScratch, out: np.ndarray) -> None:
    """Rows of n_e, n_f, r_p, r_q, w, kappa, phi_p, phi_q: the field of the path, the other edge at phi = 0."""
    for i in range(len(cases)):
        n_e, n_f, r_p, r_q, w, kappa, phi_p, phi_q = cases[i]
        set_terms(n_e, phi_p, 0.0, 1.0, True, scratch.p_e)
        set_terms(n_f, phi_q, 0.0, 1.0, True, scratch.q_f)
        out[i] = double_wedge_field(Ends(n_e, n_f, r_p, r_q, 0.0, 0.0, w, True), kappa, scratch)


def _found(cases: np.ndarray) -> np.ndarray:
    out = np.empty(len(cases), complex)
    _fields(cases, make_double_wedge_scratch(), out)
    return out


def _random_cases(count: int, w: tuple[float, float]) -> np.ndarray:
    """Right-angled edges, both ends in the shadow of the other edge."""
    rng = np.random.default_rng(3)
    return np.column_stack(
        [
            np.full((count, 2), 1.5),
            rng.uniform(0.5, 4.0, (count, 2)),
            rng.uniform(*w, count),
            rng.uniform(1.6, 40.0, count),
            rng.uniform(1.02, 1.48, (count, 2)) * np.pi,
        ]
    )


def test_the_transition_function_of_complex_arguments() -> None:
    """F(z²) = sqrt(pi) j z e^(-j pi/4) w(e^(3j pi/4) z), by scipy's Faddeeva function."""
    rng = np.random.default_rng(1)
    z = rng.uniform(0.0, 12.0, 400) * np.exp(1j * rng.uniform(-0.5 * np.pi, np.pi, 400))
    z = z[np.abs(np.exp(1j * z**2)) < 1e6]
    expected = 1j * np.sqrt(np.pi) * z * np.exp(-0.25j * np.pi) * wofz(np.exp(0.75j * np.pi) * z)
    re, im = np.empty((2, len(z)))
    _transitions(z.real.copy(), z.imag.copy(), re, im)
    out = re + 1j * im
    assert len(z) > 200 and (np.abs(out - expected) < 1e-3 * np.maximum(np.abs(expected), 1.0)).all()


def test_source_and_receiver_may_change_places() -> None:
    cases = _random_cases(50, (0.01, 1.0))
    np.testing.assert_allclose(_found(cases), _found(cases[:, [1, 0, 3, 2, 4, 5, 7, 6]]), rtol=1e-6)


def test_a_thin_wall_is_a_screen() -> None:
    """kappa w from 0.02 to 0.08: the half-plane's field, within 1.5 %, without a rule for thin walls."""
    cases = _random_cases(50, (0.001, 0.001))
    cases[:, 4] = np.random.default_rng(6).uniform(0.02, 0.03, 50) / cases[:, 5]
    phi = np.column_stack([1.5 * np.pi - cases[:, 6], 0.5 * np.pi + cases[:, 7]])
    rows = np.column_stack(
        [np.full(len(cases), 2.0), phi, cases[:, 2:4], np.ones(len(cases)), cases[:, 5]]
    )
    screens = found_fields(endless(rows))
    # a point source's field over a line source's of the same path
    total = cases[:, 2] + cases[:, 3]
    off = np.abs(_found(cases) / np.sqrt(total) / screens)
    np.testing.assert_allclose(20.0 * np.log10(off), 0.0, atol=0.2)


def test_a_wide_wall_is_two_edges_on_end() -> None:
    """kappa w of 200 and more: half the product of both coefficients, each far from its shadow boundary."""
    cases = _random_cases(50, (30.0, 60.0))
    cases[:, 5], cases[:, 6:] = 40.0, np.random.default_rng(7).uniform(1.3, 1.45, (50, 2)) * np.pi
    found, k = _found(cases), 40.0
    factor = -np.exp(-0.25j * np.pi) / (2.0 * 1.5 * np.sqrt(2.0 * np.pi * k))

    def keller(phi: np.ndarray) -> np.ndarray:
        terms = 1.0 / np.tan((np.pi + phi) / 3.0) + 1.0 / np.tan((np.pi - phi) / 3.0)
        return np.asarray(2.0 * factor * terms)

    expected = 0.5 * keller(cases[:, 6]) * keller(cases[:, 7])
    expected = expected / np.sqrt(cases[:, 2] * cases[:, 3] * cases[:, 4])
    np.testing.assert_allclose(20.0 * np.log10(np.abs(found / expected)), 0.0, atol=0.4)
