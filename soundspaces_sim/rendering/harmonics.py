"""Real spherical harmonics of any order. Order 2, in closed form, is `core.numerics.axes`."""

from __future__ import annotations

import numpy as np
import scipy.special


def harmonics_n3d(directions: np.ndarray, order: int) -> np.ndarray:
    """(A, (order + 1)²) real spherical harmonics, ACN and N3D, of (A, 3) unit vectors; of the zero vector,
    no direction, the first alone."""
    theta = np.arccos(np.clip(directions[:, 2], -1.0, 1.0))
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    out = np.empty((len(directions), (order + 1) ** 2))
    for n in range(order + 1):
        for m in range(n + 1):
            y = scipy.special.sph_harm_y(n, m, theta, phi) * np.sqrt(4.0 * np.pi)
            if m == 0:
                out[:, n * n + n] = y.real
            else:  # undo the Condon-Shortley phase
                sign = (-1.0) ** m * np.sqrt(2.0)
                out[:, n * n + n + m], out[:, n * n + n - m] = sign * y.real, sign * y.imag
    out[~directions.any(axis=1), 1:] = 0.0
    return out


def n3d_gains(order: int) -> np.ndarray:
    """((order + 1)²,) sqrt(2 n + 1) of each channel's degree n: N3D over SN3D."""
    return np.repeat(np.sqrt(2.0 * np.arange(order + 1) + 1.0), 2 * np.arange(order + 1) + 1)


def harmonics_sn3d(directions: np.ndarray, order: int) -> np.ndarray:
    """As `harmonics_n3d`, in SN3D."""
    return harmonics_n3d(directions, order) / n3d_gains(order)
