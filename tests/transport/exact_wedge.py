"""A point source at an infinite rigid wedge, exact: the diffracted pressure as an integral.

Bowman & Senior's (Svensson, Fred & Vanderkooy 1999, eq. 1) integral over path lengths along an edge, turned onto
its path of steepest descent, where the integrand only decays.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np

_EDGES = (88.0, 176.0, 775.0, 3409.0, 20000.0)  # Hz; the lowest band from an octave below its end on
SPEED = 343.0


@cache
def _gauss(points: int) -> tuple[np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(points)
    return x, w


def _kernel(n: float, ts: float, tr: float, eta: np.ndarray) -> np.ndarray:
    nu, total = 1.0 / n, np.zeros(eta.shape, complex)
    for a in (1.0, -1.0):
        for b in (1.0, -1.0):
            phi = np.pi + a * ts + b * tr
            total += np.sin(nu * phi) / (np.cosh(nu * eta) - np.cos(nu * phi))
    return total


def diffracted(
    n: float, rs: float, ts: float, rr: float, tr: float, dz: float, k: np.ndarray, points: int = 300
) -> np.ndarray:
    """Pressure, free field e^(-jkr)/r, at wave numbers (m,); the open sector spans n pi."""
    x, w = _gauss(points)
    u, w = 3.5 * (x + 1.0), 3.5 * w
    k = np.asarray(k, float)[:, None]
    shortest = np.hypot(rs + rr, dz)
    path = shortest - 1j * u**2 / k
    step = -2j * u / k
    eta = np.arccosh((path**2 - rs**2 - rr**2 - dz**2) / (2.0 * rs * rr))
    value = _kernel(n, ts, tr, eta) * np.exp(-1j * k * path) * step / (rs * rr * np.sinh(eta))
    return np.asarray(-(value * w).sum(axis=1) / (2.0 * np.pi * n))


def diffracted_between(
    n: float,
    rs: float,
    ts: float,
    rr: float,
    tr: float,
    z: tuple[float, float, float, float],
    k: np.ndarray,
) -> np.ndarray:
    """The same of an edge that reaches from z[2] to z[3], for ends at z[0] and z[1] along it: the integral over
    the edge itself (Svensson et al. 1999, eq. 29), by the mid-point rule, finest at the apex."""
    zs, zr, low, high = z
    apex = zs + (zr - zs) * rs / (rs + rr)
    # z = apex + sinh-graded steps: the integrand peaks there near shadow boundaries
    reach = np.arcsinh((np.array([low, high]) - apex) / 1e-3)
    s = np.linspace(float(reach[0]), float(reach[1]), 40001)
    s = 0.5 * (s[1:] + s[:-1])
    at = apex + 1e-3 * np.sinh(s)
    weight = 1e-3 * np.cosh(s) * (reach[1] - reach[0]) / 40000
    m, l = np.hypot(rs, at - zs), np.hypot(rr, at - zr)
    cosh_eta = (m * l + (at - zs) * (at - zr)) / (rs * rr)
    beta = _kernel(n, ts, tr, np.arccosh(np.maximum(cosh_eta, 1.0)).astype(complex)).real
    value = weight * beta / (m * l)
    phase = np.exp(-1j * np.asarray(k, float)[:, None] * (m + l))
    return np.asarray(-(phase * value).sum(axis=1) / (4.0 * np.pi * n))


def band_wave_numbers(points: int = 41) -> np.ndarray:
    """(4, points) wave numbers, evenly in log f over the default bands."""
    f = [np.geomspace(a, b, 2 * points + 1)[1::2] for a, b in pairwise(_EDGES)]
    return 2.0 * np.pi / SPEED * np.array(f)


def band_energies(pressure: np.ndarray) -> np.ndarray:
    """(4,) mean squares of pressures (4, points)."""
    return np.asarray((np.abs(pressure) ** 2).mean(axis=1))
