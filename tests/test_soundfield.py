"""Conventions and rotations of ambisonic signals."""

import numpy as np
import pytest
from scipy.special import sph_harm_y

from soundspaces_sim.ambisonics import rotate_heading, spherical_harmonics
from soundspaces_sim.errors import ConfigError
from soundspaces_sim.soundfield import convert, head_matrix, rotate, rotation_matrix

DIRECTIONS = np.random.default_rng(0).normal(size=(50, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


def test_orthonormal_with_condon_shortley_is_scipys() -> None:
    """Real harmonics from SciPy's complex ones, which carry the Condon-Shortley phase."""
    x, y, z = DIRECTIONS.T
    theta, phi = np.arccos(z), np.arctan2(y, x)
    expected = []
    for l in range(3):  # noqa: E741
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
def test_a_plane_wave_is_heard_from_where_it_comes(angles: tuple, source: tuple, heard: tuple) -> None:
    wave = spherical_harmonics(source)[:, None]
    np.testing.assert_allclose(rotate(wave, *angles)[:, 0], spherical_harmonics(heard), atol=1e-12)


def test_rotations_are_exact_and_agree_with_the_heading_alone() -> None:
    signal = np.random.default_rng(2).normal(size=(9, 5))
    np.testing.assert_allclose(rotate(signal, 37.0), rotate_heading(signal, 37.0), atol=1e-12)
    head = head_matrix(20.0, -35.0, 70.0)
    np.testing.assert_allclose(head.T @ head, np.eye(3), atol=1e-15)
    got = rotation_matrix(head) @ spherical_harmonics(DIRECTIONS).T
    np.testing.assert_allclose(got, spherical_harmonics(DIRECTIONS @ head).T, atol=1e-12)
    back = rotation_matrix(head.T) @ rotation_matrix(head)
    np.testing.assert_allclose(back, np.eye(9), atol=1e-12)
