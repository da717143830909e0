"""A human talker, from published averages.

Monson, Hunter & Story 2012, "Horizontal directivity of low- and high-frequency energy in speech and
singing", J. Acoust. Soc. Am. 132(1), 433-441: octave-band levels of normal speech, mean of 15 talkers, in
the horizontal plane at 60 cm, re the level in front. Elsewhere the pattern is taken to be symmetric about
the mouth's axis; a real one is a few dB stronger below the mouth than above it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from soundspaces_sim.echogram.endpoints import Directivity

_HZ = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16000.0])
_ANGLE_DEG = np.arange(0.0, 181.0, 15.0)
_LEVEL_DB = np.array([
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.8, 0.7, 0.6, -0.2, -1.0, -1.7, -1.0, -0.1],
    [-0.1, -0.2, 0.1, -0.7, -0.1, -0.7, -1.7, -0.5],
    [-0.4, -0.5, 0.0, -1.4, -0.8, -1.6, -3.1, -2.3],
    [-0.6, -0.8, -0.1, -1.5, -2.5, -3.9, -5.8, -4.4],
    [-1.1, -1.6, -0.7, -1.4, -4.7, -5.3, -7.0, -5.1],
    [-1.6, -2.3, -1.6, -1.6, -7.0, -6.3, -8.7, -7.2],
    [-2.1, -3.1, -2.8, -2.5, -7.6, -9.0, -11.5, -10.1],
    [-2.7, -3.9, -4.4, -4.6, -7.9, -12.7, -15.0, -14.2],
    [-3.1, -4.5, -5.5, -7.0, -9.3, -14.5, -17.8, -17.8],
    [-3.5, -4.9, -6.0, -7.9, -13.0, -16.7, -21.5, -21.7],
    [-3.6, -5.0, -6.0, -6.9, -15.0, -21.0, -25.0, -23.5],
    [-3.6, -5.1, -5.9, -6.3, -13.1, -18.9, -26.3, -26.7],
])  # fmt: skip
_BETWEEN = PchipInterpolator(_ANGLE_DEG, _LEVEL_DB)  # no overshoot between measured angles


@dataclass(frozen=True, kw_only=True)
class Talker(Directivity):
    """A person who speaks at a normal level towards the heading; the mouth is the source's position."""

    def energy(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angle = np.degrees(np.arccos(np.clip(directions[:, 0], -1.0, 1.0)))
        return _HZ, 10.0 ** (_BETWEEN(angle) / 10.0)
