"""Ambisonics of order 3 to 7: arrivals have their harmonics, reverberation the stored moments and no others."""

from dataclasses import replace

import numpy as np
import pytest

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.axes import spherical_harmonics
from soundspaces_sim.echogram.echogram import Arrivals
from soundspaces_sim.rendering.ambisonics import ambisonic_rir
from soundspaces_sim.rendering.harmonics import harmonics_n3d, n3d_gains
from soundspaces_sim.rendering.higher_orders import WAVES, higher_order_rir
from soundspaces_sim.rendering.waves import lattice
from tests.marks import ci_slow
from tests.rendering.test_waves import BANDS, DIFFUSE, RATE, tail
from tests.stats import assert_mean

CHANNELS = {order: (order + 1) ** 2 for order in range(3, 8)}


def legendre(n: int, m: int, z: float) -> float:
    """Associated Legendre function without the Condon-Shortley sign, by its recurrences (Abramowitz & Stegun 8.5)."""
    value = 1.0
    for k in range(1, m + 1):
        value *= (2 * k - 1) * np.sqrt(1.0 - z * z)
    below, here = 0.0, value
    for k in range(m + 1, n + 1):
        below, here = here, ((2 * k - 1) * z * here - (k + m - 1) * below) / (k - m)
    return float(here)


def slow_harmonics(d: np.ndarray, order: int) -> np.ndarray:
    """(C,) of a direction, N3D, from the definition: Zotter & Frank 2019, eq. A.35."""
    out, phi = [], np.arctan2(d[1], d[0])
    for n in range(order + 1):
        for m in range(-n, n + 1):
            k = abs(m)
            ratio = np.prod([1.0 / i for i in range(n - k + 1, n + k + 1)])
            norm = np.sqrt((2 * n + 1) * (1 if m == 0 else 2) * ratio)
            out.append(norm * legendre(n, k, d[2]) * (np.cos(k * phi) if m >= 0 else np.sin(k * phi)))
    return np.array(out)


def test_harmonics_are_those_of_the_definition() -> None:
    d = np.random.default_rng(4).normal(size=(12, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    expected = np.array([slow_harmonics(one, 7) for one in d])
    np.testing.assert_allclose(harmonics_n3d(d, 7), expected, atol=1e-9)


@pytest.mark.parametrize("order", [3, 7])
def test_an_arrival_has_the_harmonics_of_its_direction(order: int) -> None:
    """Direct sound and reflections alone: each channel is the pressure times a number, that of the direction."""
    d = np.array([[0.48, -0.6, 0.64], [-0.8, 0.0, 0.6]])
    bands = len(BANDS) - 1
    early = Arrivals(np.array([0.01, 0.03]), np.full((2, bands), 0.25), d, np.zeros((2, 2), int))
    sound = replace(tail(0.0 * DIFFUSE), early=early)
    got = higher_order_rir(sound, RATE, 0, order)
    assert got.shape[0] == CHANNELS[order] and got.dtype == np.float32
    split = round(0.02 * RATE)
    for i, piece in enumerate((got[:, :split], got[:, split:])):
        expected = slow_harmonics(d[i], order) / n3d_gains(order)
        np.testing.assert_allclose(piece, expected[:, None] * piece[:1], atol=2e-6)
        assert np.abs(piece[0]).max() > 0.3
    np.testing.assert_allclose(got[:9], ambisonic_rir(sound, RATE, 0), atol=2e-6)


@ci_slow
def test_a_diffuse_field_has_channels_of_equal_energy_with_nothing_in_common() -> None:
    """N3D covariance of order 7: the identity, to the lattice's 1 % and the noise of 6 draws of 8,000 samples."""
    runs = 6
    held = np.zeros((runs, 64, 64))
    for seed in range(runs):
        signal = higher_order_rir(tail(DIFFUSE), RATE, seed, 7) * n3d_gains(7)[:, None]
        held[seed] = signal.astype(float) @ signal.T
    mean, error = held.mean(axis=0), held.std(axis=0, ddof=1) / np.sqrt(runs)
    y = harmonics_n3d(lattice(WAVES), 7)
    assert np.abs(y.T @ y / WAVES - np.eye(64)).max() < 0.01
    z = (mean - np.eye(64)) / np.hypot(error, 0.01)
    assert np.abs(z).max() < 6.0 and (z**2).mean() < 1.5  # 2,080 numbers, errors of 5 degrees of freedom
    assert error.max() < 0.09


def test_the_first_nine_channels_have_the_stored_energy_and_moments() -> None:
    """Sound more from one side and less from above: energy, products with the pressure, and of the channels of
    order 1 with one another, which the moments of order 2 determine."""
    d = lattice(2000)
    weight = np.exp(1.2 * d[:, 0] - 1.5 * d[:, 2] ** 2 + 0.8 * d[:, 0] * d[:, 1])
    weight /= weight.sum()
    moments = weight @ spherical_harmonics(d)
    turned = d[:, [1, 2, 0]]  # Y, Z, X
    pairs = np.triu_indices(3)
    expected = np.append(moments, ((weight[:, None] * turned).T @ turned)[pairs])
    got = []
    for seed in range(10):
        signal = higher_order_rir(tail(moments), RATE, seed, 3).astype(float)
        got.append(np.append(signal[:9] @ signal[0], (signal[1:4] @ signal[1:4].T)[pairs]))
    # the ridge of `waves.shares` leaves moments of this size off by .005 at most: a standard error or less
    assert_mean(np.array(got), expected, "moments and covariance", 0.012, scale=1.0)


def test_orders_that_are_not_made_are_refused() -> None:
    for order in (1, 8, 2.5, float("nan"), True):
        with pytest.raises(ConfigError, match="order: expected 3 to 7"):
            higher_order_rir(tail(DIFFUSE), RATE, 0, order)  # type: ignore[arg-type]
