"""Where things are in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from soundspaces_rlr.arguments import vector3
from soundspaces_rlr.habitat.rotations import identity, matrix, product, quat_from_angle_axis


@dataclass
class Node:
    """Where an agent or a sensor is in the world, (3,) m, and how it is turned, local to world."""

    absolute_translation: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rotation: Any = field(default_factory=identity)

    @property
    def translation(self) -> np.ndarray:
        """`absolute_translation`."""
        return self.absolute_translation

    @property
    def axes(self) -> np.ndarray:
        """(3, 3) matrix of the rotation: columns are right, up and back."""
        return matrix(self.rotation)


def from_euler(angles: Sequence[float], what: str) -> Any:
    """The rotation of a specification's `orientation`: about x, then y, then z of the outer frame, rad."""
    turn = identity()
    for angle, axis in zip(vector3(angles, what), np.eye(3), strict=True):
        turn = product(quat_from_angle_axis(angle, axis), turn)
    return turn
