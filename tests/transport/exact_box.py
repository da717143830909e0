"""Pressure in a rectangular room whose walls have one real admittance, exact: modes across, closed form along z.

-(laplace + k²) G = delta with dp/dn = -i k beta p on the walls separates: across x and y eigenfunctions of
complex wave numbers (Morse & Ingard, Theoretical Acoustics, 9.5; their roots by Newton's method from those of
rigid walls), along z the Green's function of what is left of k². The pressure is sqrt(4 pi) G: free field 1 /
(sqrt(4 pi) r). Time: exp(i w t).
"""

from __future__ import annotations

import numpy as np

_PATH, _POLISH = 12, 4


def wave_numbers(length: float, beta: float, k: np.ndarray, count: int) -> np.ndarray:
    """(m, count) roots q of the modes between two such walls at wave numbers k (m,), even and odd in turn."""
    n = np.arange(count)
    half, even = 0.5 * length, n % 2 == 0
    q = np.broadcast_to(n * np.pi / length, (len(k), count)).astype(complex)
    if beta == 0.0:
        return q
    for part in np.concatenate([np.linspace(0.0, 1.0, _PATH + 1)[1:], np.ones(_POLISH)]):
        b = 1j * np.asarray(k)[:, None] * beta * part
        if part == 1.0 / _PATH:
            q[:, 0] = np.sqrt(2.0 * b[:, 0] / length)
        for _ in range(3):
            sin, cos = np.sin(q * half), np.cos(q * half)
            value = np.where(even, q * sin - b * cos, q * cos + b * sin)
            slope = np.where(
                even, sin + half * q * cos + half * b * sin, cos - half * q * sin + half * b * cos
            )
            q = q - value / np.where(slope == 0.0, 1.0, slope)
    return q


def _modes(length: float, q: np.ndarray, x: float, y: float) -> np.ndarray:
    """(m, count) psi(x) psi(y) / integral of psi²."""
    even = np.arange(q.shape[1]) % 2 == 0
    a, b = q * (x - 0.5 * length), q * (y - 0.5 * length)
    turn = np.where(q == 0.0, 1.0, np.sin(q * length) / np.where(q == 0.0, 1.0, q * length))
    norm = 0.5 * length * np.where(even, 1.0 + turn, 1.0 - turn)
    norm = np.where(norm == 0.0, 1.0, norm)
    return np.where(even, np.cos(a) * np.cos(b), np.sin(a) * np.sin(b)) / norm


def pressure(
    size: tuple[float, float, float],
    beta: float,
    frequency: np.ndarray,
    source: np.ndarray,
    listener: np.ndarray,
    c: float = 343.0,
    count: int = 16,
    ends: tuple[complex | np.ndarray, complex | np.ndarray] | None = None,
) -> np.ndarray:
    """(m,) complex, at frequencies (m,) in Hz. `ends`: admittances of the floor and the ceiling, numbers or (m,), if
    they are not those of the walls."""
    k = 2.0 * np.pi * np.asarray(frequency, float) / c
    across = [wave_numbers(size[d], beta, k, count) for d in (0, 1)]
    weight = [_modes(size[d], across[d], source[d], listener[d]) for d in (0, 1)]
    kappa = np.sqrt((k**2)[:, None, None] - across[0][:, :, None] ** 2 - across[1][:, None] ** 2 + 0j)
    kappa = np.where(np.abs(kappa) < 1e-9, 1e-9, kappa)
    low, high = ((1j * k * b)[:, None, None] for b in (ends or (beta, beta)))
    length = size[2]
    near, far = min(source[2], listener[2]), length - max(source[2], listener[2])

    def wall(z: float, b: np.ndarray) -> np.ndarray:
        return np.asarray(np.cos(kappa * z) + b / kappa * np.sin(kappa * z))

    slope = -kappa * np.sin(kappa * length) + low * np.cos(kappa * length)
    along = wall(near, low) * wall(far, high) / (slope + high * wall(length, low))
    total = np.einsum("mi,mj,mij->m", weight[0], weight[1], along)
    return np.asarray(np.sqrt(4.0 * np.pi) * total)
