"""A rigid sphere as a head: how loud a near source is at either ear.

Pressure on a rigid sphere of radius a, at the angle theta from a point source at distance r, relative to the
free field at the centre (Rabinowitz, Maxwell, Shao & Wei 1993; Duda & Martens 1998), with rho = r / a, mu = k a:

    H = -(rho / mu) e^{-i mu rho} sum_m (2 m + 1) P_m(cos theta) h_m(mu rho) / h'_m(mu)
"""

from __future__ import annotations

import numpy as np
from scipy.special import eval_legendre, spherical_jn, spherical_yn

HEAD_RADIUS = 0.0875  # m, the mean of Kuhn (1977) that Duda & Martens use
_LARGE = 1e200
_CLOSE = 1e-7  # of the sum: where it ends
_NEAREST = 1.05  # radii


def sphere_response(
    frequency: np.ndarray,
    distance: float,
    cosine: float,
    radius: float = HEAD_RADIUS,
    speed_of_sound: float = 343.0,
) -> np.ndarray:
    """(n,) complex response on a rigid sphere at frequencies (n,) Hz; the source is `distance` m from its centre.

    `cosine` of the angle between the ear and the source. A source nearer than 1.05 radii counts as there.
    """
    rho = max(distance / radius, _NEAREST)
    mu = np.maximum(2.0 * np.pi * np.asarray(frequency, float) * radius / speed_of_sound, 1e-4)
    total = np.zeros(len(mu), complex)
    most = int(np.ceil(mu.max() + np.log(1.0 / _CLOSE) / np.log(rho))) + 8
    for m in range(most):
        # where they overflow, their ratio is that of their static limits
        ratio = -mu / ((m + 1.0) * rho ** (m + 1.0)) + 0j
        with np.errstate(over="ignore", invalid="ignore"):
            top = spherical_jn(m, mu * rho) + 1j * spherical_yn(m, mu * rho)
            bottom = spherical_jn(m, mu, derivative=True) + 1j * spherical_yn(m, mu, derivative=True)
            usable = (np.abs(top) < _LARGE) & (np.abs(bottom) < _LARGE)
        ratio[usable] = top[usable] / bottom[usable]
        total += (2.0 * m + 1.0) * eval_legendre(m, cosine) * ratio
    return np.asarray(-(rho / mu) * np.exp(-1j * mu * rho) * total)


def near_field_gains(
    frequency: np.ndarray, distance: float, reference: float, direction: np.ndarray
) -> np.ndarray:
    """(2, n) magnitudes that a set of HRTFs measured at `reference` m lacks for a source at `distance` m in
    `direction` (3,) of head axes: the sphere's responses at both distances, over each other (distance variation
    functions, Kan, Jin & van Schaik 2009)."""
    out = []
    for ear in (1.0, -1.0):  # left is +Y
        near, far = (
            np.abs(sphere_response(frequency, r, ear * float(direction[1])))
            for r in (distance, reference)
        )
        out.append(near / far)
    return np.array(out)
