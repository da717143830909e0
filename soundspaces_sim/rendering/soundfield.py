"""Ambisonic signals in other conventions: nothing here makes sound.

Inside the package signals are ACN / SN3D in world axes (X front, Y left, Z up).
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.axes import CHANNELS, DEGREE

Convention = Literal["sn3d", "n3d", "fuma", "soundspaces1"]

_ORDER = np.array([0, -1, 0, 1, -2, -1, 0, 1, 2])
# W X Y Z R S T U V as rows of ACN; maxN weights with W down by 3 dB (Malham 2003).
_FUMA_ROWS = np.array([0, 3, 1, 2, 6, 7, 5, 8, 4])
_FUMA_GAIN = np.array([math.sqrt(0.5), 1.0, 1.0, 1.0, 1.0, *[2.0 / math.sqrt(3.0)] * 4])


def _rows_and_gains(convention: str) -> tuple[np.ndarray, np.ndarray]:
    same = np.arange(CHANNELS)
    if convention == "sn3d":
        return same, np.ones(CHANNELS)
    n3d = np.sqrt(2.0 * DEGREE + 1.0)
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
    if np.ndim(signal) < 1 or len(signal) != CHANNELS:
        raise ConfigError(f"signal: expected shape (9, …), got {np.shape(signal)}")
    tail = (1,) * (np.ndim(signal) - 1)
    rows, gains = _rows_and_gains(source)
    own = np.empty_like(signal)
    own[rows] = signal / gains.reshape(-1, *tail).astype(signal.dtype)
    rows, gains = _rows_and_gains(target)
    return np.asarray(own[rows] * gains.reshape(-1, *tail).astype(signal.dtype))
