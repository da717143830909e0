"""Rotations, as habitat-sim's clients make, read and multiply them.

habitat-sim's rotations are those of numpy-quaternion. Where a client has imported that package (`import
quaternion`), rotations made here are of its type, so that its functions take them; else they are `Quaternion`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from soundspaces_rlr.arguments import rotation, vector3
from soundspaces_rlr.errors import RlrError


@dataclass(frozen=True)
class Quaternion:
    """w + x i + y j + z k."""

    w: float = 1.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    @property
    def components(self) -> np.ndarray:
        """(4,) w, x, y, z."""
        return np.array([self.w, self.x, self.y, self.z])

    @property
    def real(self) -> float:
        """w."""
        return self.w

    @property
    def imag(self) -> np.ndarray:
        """(3,) x, y, z."""
        return np.array([self.x, self.y, self.z])

    vec = imag

    def __mul__(self, other: Any) -> Quaternion:
        """Hamilton's product: the turn by `other` first, then by this one."""
        if not all(hasattr(other, name) for name in "wxyz"):
            return NotImplemented
        v, u = self.imag, np.array([other.x, other.y, other.z])
        x, y, z = self.w * u + other.w * v + np.cross(v, u)
        return Quaternion(float(self.w * other.w - v @ u), float(x), float(y), float(z))

    def conjugate(self) -> Quaternion:
        """w - x i - y j - z k."""
        return Quaternion(self.w, -self.x, -self.y, -self.z)

    def inverse(self) -> Quaternion:
        """The rotation back."""
        n = float(self.components @ self.components)
        return Quaternion(self.w / n, -self.x / n, -self.y / n, -self.z / n)

    def normalized(self) -> Quaternion:
        """Of length 1."""
        return Quaternion(*(self.components / np.linalg.norm(self.components)).tolist())


def make(w: float, x: float, y: float, z: float) -> Any:
    """A rotation of numpy-quaternion's type if that has been imported, else a `Quaternion`."""
    made_by = getattr(sys.modules.get("quaternion"), "quaternion", Quaternion)
    return made_by(float(w), float(x), float(y), float(z))


def product(first: Any, second: Any) -> Any:
    """The turn by `second`, then by `first`, whatever their types."""
    a, b = (Quaternion(*as_wxyz(q, "rotation")) for q in (first, second))
    return make(*(a * b).components)


def identity() -> Any:
    """No rotation."""
    return make(1.0, 0.0, 0.0, 0.0)


def as_wxyz(rotation: Any, what: str) -> list[float]:
    """[w, x, y, z] of a rotation: anything with w, x, y and z, with a scalar and a vector (Magnum), or
    [x, y, z, w], as habitat takes lists. Raises TypeError, and `RlrError` for NaN and inf."""
    if all(hasattr(rotation, name) for name in "wxyz"):
        found = [float(getattr(rotation, name)) for name in "wxyz"]
    elif hasattr(rotation, "scalar") and hasattr(rotation, "vector"):
        found = [float(rotation.scalar), *vector3(rotation.vector, what)]
    else:
        try:
            x, y, z, w = (float(v) for v in rotation)
        except (TypeError, ValueError):
            raise TypeError(f"{what}: expected a quaternion or [x, y, z, w], got {rotation!r}") from None
        found = [w, x, y, z]
    if not all(math.isfinite(v) for v in found):
        raise RlrError(f"{what}: expected finite numbers, got {rotation!r}")
    return found


def matrix(turn: Any, what: str = "rotation") -> np.ndarray:
    """(3, 3) of a rotation, local to world. Raises TypeError and `RlrError`."""
    return rotation(as_wxyz(turn, what), what)


def quat_from_angle_axis(theta: float, axis: Sequence[float] | np.ndarray) -> Any:
    """The rotation by `theta` rad about `axis` (3,)."""
    direction = np.array(vector3(axis, "quat_from_angle_axis"))
    length = float(np.linalg.norm(direction))
    if not (length > 0.0 and math.isfinite(theta)):
        raise RlrError(
            f"quat_from_angle_axis: expected an angle and an axis, got {theta!r} and {axis!r}"
        )
    x, y, z = math.sin(0.5 * theta) * direction / length
    return make(math.cos(0.5 * theta), x, y, z)


def quat_to_angle_axis(quat: Any) -> tuple[float, np.ndarray]:
    """Angle, rad, 0 to 2 π, and unit axis (3,) of a rotation; (1, 0, 0) for none."""
    w, *v = as_wxyz(quat, "quat_to_angle_axis")
    length = float(np.linalg.norm(v))
    theta = 2.0 * math.atan2(length, w)
    return theta, np.array(v) / length if length > 1e-8 else np.array([1.0, 0.0, 0.0])


def quat_from_coeffs(coeffs: Sequence[float]) -> Any:
    """The rotation of [x, y, z, w]."""
    return make(*as_wxyz(list(coeffs), "quat_from_coeffs"))


def quat_to_coeffs(quat: Any) -> np.ndarray:
    """(4,) x, y, z, w of a rotation."""
    w, x, y, z = as_wxyz(quat, "quat_to_coeffs")
    return np.array([x, y, z, w])


def quat_from_magnum(quat: Any) -> Any:
    """The rotation of a Magnum quaternion."""
    return make(*as_wxyz(quat, "quat_from_magnum"))


def quat_rotate_vector(q: Any, v: Sequence[float] | np.ndarray) -> np.ndarray:
    """(3,) a vector turned."""
    return np.asarray(matrix(q, "quat_rotate_vector") @ np.array(vector3(v, "quat_rotate_vector")))


def angle_between_quats(q1: Any, q2: Any) -> float:
    """Angle of the turn from one rotation to another, rad, 0 to π."""
    a, b = (np.array(as_wxyz(q, "angle_between_quats")) for q in (q1, q2))
    cosine = abs(a @ b) / (np.linalg.norm(a) * np.linalg.norm(b))
    return float(2.0 * math.acos(min(1.0, cosine)))


def quat_from_two_vectors(v0: Sequence[float] | np.ndarray, v1: Sequence[float] | np.ndarray) -> Any:
    """The shortest rotation that turns the direction of v0 (3,) to that of v1 (3,)."""
    a, b = (np.array(vector3(v, "quat_from_two_vectors")) for v in (v0, v1))
    if not (a.any() and b.any()):
        raise RlrError("quat_from_two_vectors: expected vectors with a length")
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    if a @ b < 1e-8 - 1.0:  # opposite: about any axis at right angles
        side = np.cross(a, np.eye(3)[np.abs(a).argmin()])
        return quat_from_angle_axis(math.pi, side)
    w, v = math.sqrt(0.5 * (1.0 + a @ b)), np.cross(a, b)
    return make(w, *(v / (2.0 * w)))


def random_quaternion() -> Any:
    """A rotation, even over all, from NumPy's global generator, as habitat draws it (Shoemake 1992)."""
    u, v, w = np.random.rand(3)  # noqa: NPY002 # the generator that clients seed
    a, b = math.sqrt(1.0 - u), math.sqrt(u)
    return make(
        a * math.sin(2.0 * math.pi * v),
        a * math.cos(2.0 * math.pi * v),
        b * math.sin(2.0 * math.pi * w),
        b * math.cos(2.0 * math.pi * w),
    )
