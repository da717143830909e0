"""Ambisonic signals in other conventions, and turned: nothing here makes sound.

Inside the package signals are ACN / SN3D in world axes (X front, Y left, Z up).
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np

from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.sound.ambisonics import CHANNELS, spherical_harmonics

Convention = Literal["sn3d", "n3d", "fuma", "soundspaces1"]

_DEGREE = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2])
_ORDER = np.array([0, -1, 0, 1, -2, -1, 0, 1, 2])
# W X Y Z R S T U V as rows of ACN; maxN weights with W down by 3 dB (Malham 2003).
_FUMA_ROWS = np.array([0, 3, 1, 2, 6, 7, 5, 8, 4])
_FUMA_GAIN = np.array([math.sqrt(0.5), 1.0, 1.0, 1.0, 1.0, *[2.0 / math.sqrt(3.0)] * 4])


def _rows_and_gains(convention: str) -> tuple[np.ndarray, np.ndarray]:
    same = np.arange(CHANNELS)
    if convention == "sn3d":
        return same, np.ones(CHANNELS)
    n3d = np.sqrt(2.0 * _DEGREE + 1.0)
    if convention == "n3d":
        return same, n3d
    if convention == "fuma":
        return _FUMA_ROWS, _FUMA_GAIN
    if convention == "soundspaces1":
        return same, n3d / math.sqrt(4.0 * math.pi) * (-1.0) ** np.abs(_ORDER)
    names = ", ".join(get_args(Convention))
    raise ConfigError(f"convention: expected one of {names}, got {convention!r}")


def convert(signal: np.ndarray, target: Convention, source: Convention = "sn3d") -> np.ndarray:
    """A (9, …) signal in another convention.

    ``sn3d`` ACN order, the package's own (AmbiX); ``n3d`` ACN, times sqrt(2 l + 1); ``fuma``
    Furse-Malham W X Y Z R S T U V; ``soundspaces1`` ACN, orthonormal with the Condon-Shortley sign, as
    the RIRs published with SoundSpaces (2020).
    """
    _check(signal)
    tail = (1,) * (np.ndim(signal) - 1)
    rows, gains = _rows_and_gains(source)
    own = np.empty_like(signal)
    own[rows] = signal / gains.reshape(-1, *tail).astype(signal.dtype)
    rows, gains = _rows_and_gains(target)
    return np.asarray(own[rows] * gains.reshape(-1, *tail).astype(signal.dtype))


def _check(signal: np.ndarray) -> None:
    if np.ndim(signal) < 1 or len(signal) != CHANNELS:
        raise ConfigError(f"signal: expected shape (9, …), got {np.shape(signal)}")


def head_matrix(heading_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> np.ndarray:
    """(3, 3) matrix whose columns are a head's front, left and up in world axes.

    From a head that faces +X: roll about its front (positive lowers the right ear), then pitch (positive
    looks up), then heading (positive turns left, counter-clockwise seen from above). Degrees.
    """
    (ch, cp, cr), (sh, sp, sr) = (
        f(np.radians([heading_deg, pitch_deg, roll_deg])) for f in (np.cos, np.sin)
    )
    yaw = np.array([[ch, -sh, 0.0], [sh, ch, 0.0], [0.0, 0.0, 1.0]])
    pitch = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return yaw @ pitch @ roll


def rotation_matrix(head: np.ndarray) -> np.ndarray:
    """(9, 9) matrix that turns ACN / SN3D signals from world axes to those of a head (3, 3).

    Spherical harmonics of one order turn among themselves, so the matrix is determined, to rounding, by
    their values in a few directions d: M Y(d) = Y(R^T d).
    """
    n = np.arange(32) + 0.5
    z = 1.0 - n / 16.0
    phi = n * math.pi * (3.0 - math.sqrt(5.0))
    d = np.column_stack([np.sqrt(1.0 - z**2) * np.cos(phi), np.sqrt(1.0 - z**2) * np.sin(phi), z])
    matrix = np.linalg.lstsq(spherical_harmonics(d), spherical_harmonics(d @ head), rcond=None)[0].T
    return np.where(_DEGREE[:, None] == _DEGREE[None, :], matrix, 0.0)


def rotate(
    signal: np.ndarray, heading_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0
) -> np.ndarray:
    """A (9, n) world-axes signal as heard by a head turned so; angles as `head_matrix`. Exact."""
    _check(signal)
    matrix = rotation_matrix(head_matrix(heading_deg, pitch_deg, roll_deg))
    return np.asarray(np.tensordot(matrix.astype(signal.dtype), signal, axes=1))
