"""The lattice's own frequencies and amplitudes, and what puts them right.

With X = 4 sin²(k_x h / 2) and so on, the scheme has sin²(omega T / 2) = (courant² / 4) (X + Y + Z - (XY + YZ +
ZX) / 6), which to fourth order in k h is the same in all directions (Kowalczyk & van Walstijn 2011). So waves
of frequency f are those of the lattice at another frequency, alike in all directions: the response is read off
there. Every mode's amplitude is that of 1 / (d phi / d (k h)²), phi being the bracket's mean over directions,
and is multiplied by that.
"""

from __future__ import annotations

import numpy as np

MIXED = 1.0 / 6.0  # of the terms XY, YZ, ZX
_NODES = 8  # of an octant in either angle


def _symbol(kh: np.ndarray) -> np.ndarray:
    """(n, directions) of wave numbers (n,) over 1 / h, for directions spread over an octant."""
    u, _ = np.polynomial.legendre.leggauss(_NODES)
    z, turn = 0.5 + 0.5 * u, 0.25 * np.pi * (1.0 + u)
    r = np.sqrt(1.0 - z**2)
    unit = np.stack(
        [np.outer(r, np.cos(turn)), np.outer(r, np.sin(turn)), np.repeat(z[:, None], _NODES, 1)], axis=-1
    ).reshape(-1, 3)
    x, y, z = (4.0 * np.sin(0.5 * kh[:, None] * unit[:, axis]) ** 2 for axis in range(3))
    return np.asarray(x + y + z - MIXED * (x * y + y * z + z * x))


def _mean_symbol(kh: np.ndarray) -> np.ndarray:
    w = np.polynomial.legendre.leggauss(_NODES)[1]
    return np.asarray(_symbol(kh) @ (0.25 * np.outer(w, w).ravel()))


def lattice_frequency(frequency: np.ndarray, spacing: float, step: float, c: float) -> np.ndarray:
    """Hz: where on the lattice waves of these frequencies are found, in the mean over directions."""
    phi = _mean_symbol(2.0 * np.pi * frequency * spacing / c)
    courant = c * step / spacing
    return np.asarray(np.arcsin(0.5 * courant * np.sqrt(phi)) / (np.pi * step))


def amplitude_factor(frequency: np.ndarray, spacing: float, c: float) -> np.ndarray:
    """d phi / d (k h)²: what the lattice's response is multiplied by."""
    square = (2.0 * np.pi * np.maximum(frequency, 1e-3) * spacing / c) ** 2
    small = 1e-3 * square
    return np.asarray(
        (_mean_symbol(np.sqrt(square + small)) - _mean_symbol(np.sqrt(square - small))) / (2.0 * small)
    )


def velocity_spread(frequency: float, spacing: float, step: float, c: float) -> float:
    """Largest relative difference of the phase velocity between directions and their mean: what is left."""
    kh = np.array([2.0 * np.pi * frequency * spacing / c])
    courant = c * step / spacing
    omega = np.arcsin(0.5 * courant * np.sqrt(_symbol(kh)))
    mean = np.arcsin(0.5 * courant * np.sqrt(_mean_symbol(kh)))
    return float(np.abs(omega / mean[:, None] - 1.0).max())
