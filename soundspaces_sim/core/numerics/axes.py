"""Directions: their spherical harmonics, and how a head is turned.

Conventions: X front, Y left, Z up; ACN channel order, SN3D normalisation, to order 2. Angles in degrees;
a heading of 0 faces +X, positive turns left.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import ConfigError

CHANNELS = 9
DEGREE = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2])  # of each channel


def spherical_harmonics(direction: ArrayLike) -> np.ndarray:
    """(…, 9) real spherical harmonics, ACN and SN3D, of (…, 3) unit vectors."""
    d = np.asarray(direction, float)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    root3 = math.sqrt(3.0)
    out = np.stack(
        [
            np.ones_like(x),
            y,
            z,
            x,
            root3 * x * y,
            root3 * y * z,
            0.5 * (2.0 * z * z - x * x - y * y),
            root3 * x * z,
            0.5 * root3 * (x * x - y * y),
        ],
        axis=-1,
    )
    return np.asarray(out)


def check_degrees(angles: ArrayLike, name: str = "heading_deg") -> np.ndarray:
    """Angles as an array of floats. Raises `ConfigError` unless all are finite numbers."""
    try:
        found = np.asarray(angles, float)
    except (TypeError, ValueError):
        found = np.full(1, np.nan)
    if not np.isfinite(found).all():
        raise ConfigError(f"{name}: expected finite angles in degrees, got {angles!r:.80}")
    return found


def check_angle(angle: float, name: str) -> float:
    """One angle. Raises `ConfigError`."""
    found = check_degrees(angle, name)
    if found.ndim > 0:
        raise ConfigError(
            f"{name}: expected one angle in degrees, got {angle!r:.80}; for several heads give `binaurals` rows of "
            "heading, pitch and roll, as in [(0, 0, 0), (90, 0, 0)]"
        )
    return float(found)


def check_head(heading_deg: float, pitch_deg: float, roll_deg: float) -> tuple[float, float, float]:
    """The three angles of one head. Raises `ConfigError`."""
    return (
        check_angle(heading_deg, "heading_deg"),
        check_angle(pitch_deg, "pitch_deg"),
        check_angle(roll_deg, "roll_deg"),
    )


def head_matrix(heading_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> np.ndarray:
    """(3, 3) matrix whose columns are a head's front, left and up in world axes.

    From a head that faces +X: roll about its front (positive lowers the right ear), then pitch (positive
    looks up), then heading (positive turns left, counter-clockwise seen from above). Degrees. Raises `ConfigError`
    for angles that are not finite.
    """
    turns = np.radians(check_degrees([heading_deg, pitch_deg, roll_deg], "heading, pitch and roll"))
    (ch, cp, cr), (sh, sp, sr) = (f(turns) for f in (np.cos, np.sin))
    yaw = np.array([[ch, -sh, 0.0], [sh, ch, 0.0], [0.0, 0.0, 1.0]])
    pitch = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return yaw @ pitch @ roll


def rotation_matrix(head: np.ndarray) -> np.ndarray:
    """(9, 9) matrix that turns ACN / SN3D signals from world axes to those of a head (3, 3).

    Spherical harmonics of one order turn among themselves, so the matrix is determined, to rounding, by
    their values in a few directions d: M Y(d) = Y(R^T d).
    """
    return rotation_matrices(head[None])[0]


@lru_cache(maxsize=1)
def _few_directions() -> tuple[np.ndarray, np.ndarray]:
    """((n, 3) unit vectors, (9, n) the inverse of their spherical harmonics)."""
    n = np.arange(32) + 0.5
    z = 1.0 - n / 16.0
    phi = n * math.pi * (3.0 - math.sqrt(5.0))
    d = np.column_stack([np.sqrt(1.0 - z**2) * np.cos(phi), np.sqrt(1.0 - z**2) * np.sin(phi), z])
    return d, np.linalg.pinv(spherical_harmonics(d))


def rotation_matrices(heads: np.ndarray) -> np.ndarray:
    """(k, 9, 9) `rotation_matrix` of heads (k, 3, 3)."""
    d, inverse = _few_directions()
    matrices = np.einsum("cn,knd->kdc", inverse, spherical_harmonics(d @ heads))
    return np.where(DEGREE[:, None] == DEGREE[None, :], matrices, 0.0)
