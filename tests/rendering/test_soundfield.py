"""Conventions and rotations of ambisonic signals."""

from typing import Any

import numpy as np
import pytest
from scipy.special import sph_harm_y

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.axes import head_matrix, rotation_matrix, spherical_harmonics
from soundspaces_sim.rendering.soundfield import convert

DIRECTIONS = np.random.default_rng(0).normal(size=(50, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


def test_orthonormal_with_condon_shortley_is_scipys() -> None:
    """Real harmonics from SciPy's complex ones, which carry the Condon-Shortley phase."""
    x, y, z = DIRECTIONS.T
    theta, phi = np.arccos(z), np.arctan2(y, x)
    expected = []
    for l in range(3):
        for m in range(-l, l + 1):
            value = sph_harm_y(l, abs(m), theta, phi)
            part = value.real if m >= 0 else value.imag
            expected.append(part * (np.sqrt(2.0) if m else 1.0))
    got = convert(spherical_harmonics(DIRECTIONS).T, "soundspaces1")
    np.testing.assert_allclose(got, np.array(expected), atol=1e-12)


def test_n3d_has_unit_mean_square_per_channel() -> None:
    """Gauss quadrature over the sphere: mean of Y_i Y_j is the identity."""
    z, w = np.polynomial.legendre.leggauss(8)
    phi = np.arange(16) * 2.0 * np.pi / 16.0
    r = np.sqrt(1.0 - z**2)
    d = np.stack([np.outer(r, np.cos(phi)), np.outer(r, np.sin(phi)), np.outer(z, np.ones(16))], axis=-1)
    y = convert(spherical_harmonics(d.reshape(-1, 3)).T, "n3d")
    np.testing.assert_allclose((y * np.repeat(w, 16) / 32.0) @ y.T, np.eye(9), atol=1e-12)


def test_fuma_definitions() -> None:
    """W X Y Z R S T U V of Malham (2003), from azimuth A and elevation E."""
    x, y, z = DIRECTIONS.T
    a, e = np.arctan2(y, x), np.arcsin(z)
    expected = [
        np.full(len(x), np.sqrt(0.5)), np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e),
        1.5 * np.sin(e) ** 2 - 0.5, np.cos(a) * np.sin(2 * e), np.sin(a) * np.sin(2 * e),
        np.cos(2 * a) * np.cos(e) ** 2, np.sin(2 * a) * np.cos(e) ** 2,
    ]  # fmt: skip
    np.testing.assert_allclose(convert(spherical_harmonics(DIRECTIONS).T, "fuma"), expected, atol=1e-12)


@pytest.mark.parametrize("convention", ["sn3d", "n3d", "fuma", "soundspaces1"])
def test_conversions_are_undone_by_their_inverse(convention: str) -> None:
    signal = np.random.default_rng(1).normal(size=(9, 20))
    there = convert(signal, convention)  # type: ignore[arg-type]
    np.testing.assert_allclose(convert(there, "sn3d", convention), signal, atol=1e-12)  # type: ignore[arg-type]


def test_unknown_convention_and_shape_are_refused() -> None:
    with pytest.raises(ConfigError, match="convention"):
        convert(np.zeros((9, 3)), "ambix2")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="shape"):
        convert(np.zeros((4, 3)), "n3d")


@pytest.mark.parametrize(
    ("angles", "source", "heard"),
    [
        ((90.0, 0.0, 0.0), (0, 1, 0), (1, 0, 0)),  # turned left: what was left is in front
        ((0.0, 90.0, 0.0), (0, 0, 1), (1, 0, 0)),  # looking up: what was above is in front
        ((0.0, 0.0, 90.0), (0, -1, 0), (0, 0, 1)),  # right ear down: what was right is above
        ((90.0, 90.0, 0.0), (0, -1, 0), (0, 0, 1)),  # left, then up: what was behind her is above
    ],
)  # fmt: skip
def test_a_plane_wave_is_heard_from_where_it_comes(angles: Any, source: Any, heard: Any) -> None:
    wave = spherical_harmonics(source)[:, None]
    turned = rotation_matrix(head_matrix(*angles)) @ wave
    np.testing.assert_allclose(turned[:, 0], spherical_harmonics(heard), atol=1e-12)


def test_rotations_are_exact() -> None:
    head = head_matrix(20.0, -35.0, 70.0)
    np.testing.assert_allclose(head.T @ head, np.eye(3), atol=1e-15)
    got = rotation_matrix(head) @ spherical_harmonics(DIRECTIONS).T
    np.testing.assert_allclose(got, spherical_harmonics(DIRECTIONS @ head).T, atol=1e-12)
    back = rotation_matrix(head.T) @ rotation_matrix(head)
    np.testing.assert_allclose(back, np.eye(9), atol=1e-12)


def test_a_head_that_moves_hears_each_end_as_a_head_that_is_there() -> None:
    """A long tone in the field: the first and last tenth equal the static rendering; nothing in between jumps."""
    rate, n = 16000, 16000
    tone = np.sin(2.0 * np.pi * 500.0 * np.arange(n) / rate)
    field = np.outer(spherical_harmonics([0.0, 1.0, 0.0]), tone).astype(np.float32)
    turns = [(0.0, 0.0, 0.0)] * 3 + [(90.0, 20.0, 0.0), (180.0, 0.0, 10.0)] + [(180.0, 0.0, 10.0)] * 2
    moving = ss.binaural_moving(field, turns, rate)
    inner = slice(400, 1600)
    np.testing.assert_allclose(moving[:, inner], ss.binaural_rir(field, rate, 0.0)[:, inner], atol=1e-5)
    end = ss.binaural_rir(field, rate, 180.0, roll_deg=10.0)
    inner = slice(-1600, -400)
    np.testing.assert_allclose(moving[:, inner], end[:, inner], atol=1e-5)
    still = ss.binaural_moving(field, [(30.0, 5.0, -5.0)] * 4, rate)
    there = ss.binaural_rir(field, rate, 30.0, pitch_deg=5.0, roll_deg=-5.0)
    np.testing.assert_allclose(still, there, atol=1e-5)
    steepest = 2.0 * np.pi * 500.0 / rate * np.abs(moving).max()
    assert np.abs(np.diff(moving[:, 100:-100], axis=1)).max() < 1.2 * steepest
    with pytest.raises(ConfigError, match="orientations"):
        ss.binaural_moving(field, [0.0, 1.0], rate)
