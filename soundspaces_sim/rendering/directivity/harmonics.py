"""Patterns as spherical-harmonic coefficients of any order."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import sph_harm_y

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.echogram.endpoints import Directivity


@dataclass(frozen=True)
class SphericalHarmonics(Directivity):
    """Pressure sum c_nm Y_nm, ACN order and SN3D normalisation; `coefficients` ((N + 1)^2,), real or
    complex, or (k, (N + 1)^2) at k increasing `frequencies` in Hz.

    Raises `ConfigError` if their number is not a square, or does not match the frequencies.
    """

    coefficients: tuple[complex, ...] | tuple[tuple[complex, ...], ...]
    frequencies: tuple[float, ...] = (1000.0,)

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            rows = np.atleast_2d(np.asarray(self.coefficients, complex))
            f = np.atleast_1d(np.asarray(self.frequencies, float))
        except (TypeError, ValueError) as error:
            raise ConfigError(
                f"SphericalHarmonics: expected numbers of shape (n,) or (k, n) ({error})"
            ) from None
        square = rows.ndim == 2 and math.isqrt(rows.shape[1]) ** 2 == rows.shape[1] > 0
        if (
            not square
            or f.ndim != 1
            or len(f) != len(rows)
            or not ((f > 0.0).all() and (np.diff(f) > 0.0).all())
        ):
            raise ConfigError(
                "SphericalHarmonics: expected (N + 1)^2 coefficients at each of some increasing frequencies, got "
                f"coefficients {rows.shape} at {f.size} frequencies"
            )
        if not np.isfinite(rows).all():
            raise ConfigError("SphericalHarmonics: expected finite coefficients")
        object.__setattr__(self, "coefficients", tuple(map(tuple, rows.tolist())))
        object.__setattr__(self, "frequencies", tuple(f.tolist()))

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows = np.array(self.coefficients, complex)
        pressure = real_harmonics(directions, math.isqrt(rows.shape[1]) - 1) @ rows.T
        return np.array(self.frequencies), np.abs(pressure) ** 2


def real_harmonics(directions: np.ndarray, order: int) -> np.ndarray:
    """(n, (order + 1)^2) real spherical harmonics, ACN and SN3D, of unit vectors (n, 3)."""
    theta = np.arccos(np.clip(directions[:, 2], -1.0, 1.0))
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for n in range(order + 1):
        for m in range(-n, n + 1):
            # scipy's are orthonormal and carry the Condon-Shortley sign
            y = sph_harm_y(n, abs(m), theta, phi) * (-1.0) ** m * math.sqrt(4.0 * math.pi / (2 * n + 1))
            columns.append(y.real if m == 0 else math.sqrt(2.0) * (y.real if m > 0 else y.imag))
    return np.stack(columns, axis=1)
