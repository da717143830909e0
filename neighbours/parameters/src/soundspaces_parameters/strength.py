"""Strength, and lateral energy (ISO 3382-1, annex A). Each gives (R, K).

Levels are re the direct sound at 10 m in the open, 1/(4 pi 100 m²) of what is emitted, without air: G of a free
field is 0 dB at 10 m. The lateral axis is horizontal and at right angles to the source: the null of a
figure-of-eight microphone points there.
"""

from __future__ import annotations

import numpy as np

from soundspaces_parameters.response import Response
from soundspaces_sim.parts import BIN_S, energy_up_to as up_to

_AT_10_M = 1.0 / (4.0 * np.pi * 100.0)
_EARLY_BINS = round(0.08 / BIN_S) + 2  # the last holds what arrives later, and counts nowhere
_SIDEWAYS = 1e-3  # least horizontal part of the direction to the source


def _level(energy: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        level = 10.0 * np.log10(np.maximum(energy, 0.0) / _AT_10_M)
    return np.where(np.isfinite(level), level, np.nan)


def _early(energy: np.ndarray, end: float = 0.08) -> np.ndarray:
    return up_to(energy, BIN_S, end)


def strength(response: Response) -> np.ndarray:
    """G, dB."""
    return _level(response.energy.sum(axis=-1))


def early_strength(response: Response) -> np.ndarray:
    """G up to 80 ms, dB."""
    return _level(_early(response.energy))


def late_strength(response: Response) -> np.ndarray:
    """G from 80 ms on, dB."""
    return _level(response.energy.sum(axis=-1) - _early(response.energy))


def lateral_axis(response: Response) -> np.ndarray | None:
    """Unit vector to the left of who faces the source; None if the source is above, below, or nobody knows
    where."""
    if response.towards is None:
        return None
    x, y = float(response.towards[0]), float(response.towards[1])
    length = np.hypot(x, y)
    return np.array([-y, x, 0.0]) / length if length > _SIDEWAYS else None


def _squares(response: Response) -> np.ndarray:
    """(R, K, n) lateral energy of a response that has an axis, which two measures take."""
    return response.along(_axis_of(response), 2)


def _axis_of(response: Response) -> np.ndarray:
    axis = lateral_axis(response)
    assert axis is not None
    return axis


def _fraction(response: Response, power: int) -> np.ndarray:
    """Lateral energy from 5 to 80 ms to all up to 80 ms."""
    axis = lateral_axis(response)
    if axis is None:
        return np.full(response.estimate.shape[:2], np.nan)
    squared = power == 2
    side = response.once(_squares) if squared else response.along(axis, power, _EARLY_BINS)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((_early(side) - _early(side, 0.005)) / _early(response.energy))


def lateral_fraction(response: Response) -> np.ndarray:
    """LF: squared cosines of the angles to the lateral axis."""
    return _fraction(response, 2)


def lateral_fraction_cosine(response: Response) -> np.ndarray:
    """LFC: magnitudes of cosines, as the product of both microphones' pressures has it."""
    return _fraction(response, 1)


def late_lateral_level(response: Response) -> np.ndarray:
    """L_J, dB: lateral energy from 80 ms on."""
    axis = lateral_axis(response)
    if axis is None:
        return np.full(response.estimate.shape[:2], np.nan)
    side = response.once(_squares)
    return _level(side.sum(axis=-1) - _early(side))
