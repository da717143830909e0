"""As much of Magnum's Python module as clients of habitat-sim's audio use: angles, vectors, quaternions.

`install` puts it under the name `magnum` where Magnum is not installed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from soundspaces_rlr.habitat.rotations import Quaternion as _Rotation


class Deg(float):
    """An angle in degrees; of a `Rad`, the same angle."""

    def __new__(cls, value: float = 0.0) -> Deg:
        return super().__new__(cls, math.degrees(value) if isinstance(value, Rad) else value)


class Rad(float):
    """An angle in radians; of a `Deg`, the same angle."""

    def __new__(cls, value: float = 0.0) -> Rad:
        return super().__new__(cls, math.radians(value) if isinstance(value, Deg) else value)


class Vector3(np.ndarray):
    """Three numbers x, y and z, an array; of one number, that one three times."""

    def __new__(cls, *values: Any) -> Vector3:
        given = np.asarray(values[0] if len(values) == 1 else values, float) if values else np.zeros(())
        return np.array(np.broadcast_to(given, (3,))).view(cls)

    @property
    def x(self) -> float:
        """The first."""
        return float(self[0])

    @property
    def y(self) -> float:
        """The second."""
        return float(self[1])

    @property
    def z(self) -> float:
        """The third."""
        return float(self[2])

    def length(self) -> float:
        """Euclid's length."""
        return float(np.linalg.norm(self))

    def normalized(self) -> Vector3:
        """Of length 1."""
        return Vector3(self / self.length())


class Quaternion:
    """A rotation by its vector and scalar."""

    def __init__(self, vector: Any = (0.0, 0.0, 0.0), scalar: float = 1.0) -> None:
        self.vector, self.scalar = Vector3(vector), float(scalar)

    @staticmethod
    def rotation(angle: Deg | Rad, normalized_axis: Any) -> Quaternion:
        """By an angle about a unit axis (3,)."""
        half = 0.5 * Rad(angle)
        return Quaternion(math.sin(half) * Vector3(normalized_axis), math.cos(half))

    def __mul__(self, other: Quaternion) -> Quaternion:
        product = _Rotation(self.scalar, *self.vector) * _Rotation(other.scalar, *other.vector)
        return Quaternion(product.imag, product.real)

    def inverted(self) -> Quaternion:
        """The rotation back."""
        back = _Rotation(self.scalar, *self.vector).inverse()
        return Quaternion(back.imag, back.real)
