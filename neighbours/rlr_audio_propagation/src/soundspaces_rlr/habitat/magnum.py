"""As much of Magnum's Python module as clients of habitat-sim use: angles, vectors, rotations, transformations,
boxes.

`install` puts it under the name `magnum` where Magnum is not installed. What needs Magnum's renderer can be
imported and not used (`refused.py`).
"""

from __future__ import annotations

import math as python_math
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from soundspaces_rlr.arguments import vector3
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat.refused import MAGNUM, NO_FILES, RefusedObject, refuse_in, refused
from soundspaces_rlr.habitat.rotations import Quaternion as _Rotation, as_wxyz, matrix


class Deg(float):
    """An angle in degrees; of a `Rad`, the same angle."""

    def __new__(cls, value: float = 0.0) -> Deg:
        return super().__new__(cls, python_math.degrees(value) if isinstance(value, Rad) else value)


class Rad(float):
    """An angle in radians; of a `Deg`, the same angle."""

    def __new__(cls, value: float = 0.0) -> Rad:
        return super().__new__(cls, python_math.radians(value) if isinstance(value, Deg) else value)


class Vector3(np.ndarray):
    """Three numbers x, y and z, an array; of one number, that one three times."""

    __hash__ = object.__hash__  # type: ignore[assignment] # what Magnum's have: defaults of dataclasses need it

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

    @classmethod
    def zero_init(cls) -> Any:
        """Zeros."""
        return cls()

    @classmethod
    def x_axis(cls, length: float = 1.0) -> Any:
        """Along x."""
        return cls(length, 0.0, 0.0)

    @classmethod
    def y_axis(cls, length: float = 1.0) -> Any:
        """Along y."""
        return cls(0.0, length, 0.0)

    @classmethod
    def z_axis(cls, length: float = 1.0) -> Any:
        """Along z."""
        return cls(0.0, 0.0, length)

    def length(self) -> float:
        """Euclid's length."""
        return float(np.linalg.norm(self))

    def dot(self, *of: Any) -> float:  # type: ignore[override] # Magnum's
        """The scalar product with a vector (3,), or with itself."""
        return float(np.dot(np.asarray(self), np.asarray(of[0] if of else self, float)))

    def normalized(self) -> Vector3:
        """Of length 1."""
        return Vector3(self / self.length())


class Quaternion:
    """A rotation by its vector and scalar."""

    def __init__(self, vector: Any = (0.0, 0.0, 0.0), scalar: float = 1.0) -> None:
        self.vector, self.scalar = Vector3(vector), float(scalar)

    @staticmethod
    def from_matrix(rotation: Any) -> Quaternion:
        """Of a rotation's matrix (3, 3). Raises `RlrError` for what is none."""
        rows = np.asarray(rotation, float)
        if not (rows.shape == (3, 3) and np.allclose(rows @ rows.T, np.eye(3), atol=1e-4)):
            raise RlrError(f"Quaternion.from_matrix: expected a rotation (3, 3), got {rotation!r}")
        turn = Rotation.from_matrix(rows).as_quat()
        return Quaternion(turn[:3], turn[3])

    @staticmethod
    def rotation(angle: Deg | Rad, normalized_axis: Any) -> Quaternion:
        """By an angle about a unit axis (3,)."""
        half = 0.5 * Rad(angle)
        return Quaternion(python_math.sin(half) * Vector3(normalized_axis), python_math.cos(half))

    def __mul__(self, other: Quaternion) -> Quaternion:
        product = _Rotation(self.scalar, *self.vector) * _Rotation(other.scalar, *other.vector)
        return Quaternion(product.imag, product.real)

    def inverted(self) -> Quaternion:
        """The rotation back."""
        back = _Rotation(self.scalar, *self.vector).inverse()
        return Quaternion(back.imag, back.real)

    def to_matrix(self) -> Matrix3:
        """(3, 3) its matrix."""
        return Matrix3(matrix(self))

    def transform_vector(self, vector: Any) -> Vector3:
        """(3,) a vector turned."""
        return Vector3(matrix(self) @ np.array(vector3(vector, "Quaternion.transform_vector")))

    def normalized(self) -> Quaternion:
        """Of length 1."""
        unit = _Rotation(self.scalar, *self.vector).normalized()
        return Quaternion(unit.imag, unit.real)


class Vector2(np.ndarray):
    """Two numbers x and y, an array; of one number, that one twice."""

    def __new__(cls, *values: Any) -> Vector2:
        given = np.asarray(values[0] if len(values) == 1 else values, float) if values else np.zeros(())
        return np.array(np.broadcast_to(given, (2,))).view(cls)

    @property
    def x(self) -> float:
        """The first."""
        return float(self[0])

    @property
    def y(self) -> float:
        """The second."""
        return float(self[1])

    def length(self) -> float:
        """Euclid's length."""
        return float(np.linalg.norm(self))


class Color3(Vector3):
    """Red, green and blue, 0 to 1."""

    @classmethod
    def red(cls, red: float = 1.0) -> Any:
        """Red alone."""
        return cls(red, 0.0, 0.0)

    @classmethod
    def green(cls, green: float = 1.0) -> Any:
        """Green alone."""
        return cls(0.0, green, 0.0)

    @classmethod
    def blue(cls, blue: float = 1.0) -> Any:
        """Blue alone."""
        return cls(0.0, 0.0, blue)


class Color4(np.ndarray):
    """Red, green, blue and opacity, 0 to 1; of three numbers, opaque; of one, a grey."""

    def __new__(cls, *values: Any) -> Color4:
        given = np.concatenate([np.atleast_1d(np.asarray(v, float)) for v in values or (0.0,)])
        if len(given) == 1:
            given = np.repeat(given, 3)
        if len(given) == 3:
            given = np.append(given, 1.0)
        if len(given) != 4:
            raise TypeError(f"Color4: expected one, three or four numbers, got {values!r}")
        return given.view(cls)

    @classmethod
    def red(cls, red: float = 1.0) -> Color4:
        """Red alone."""
        return cls(red, 0.0, 0.0)

    @classmethod
    def green(cls, green: float = 1.0) -> Color4:
        """Green alone."""
        return cls(0.0, green, 0.0)

    @classmethod
    def blue(cls, blue: float = 1.0) -> Color4:
        """Blue alone."""
        return cls(0.0, 0.0, blue)


class Matrix3:
    """A linear map of three dimensions; of rows, (3, 3), or none: the identity."""

    def __init__(self, rows: Any = None) -> None:
        self.rows = np.eye(3) if rows is None else np.array(rows, float).reshape(3, 3)

    def __matmul__(self, other: Any) -> Any:
        if isinstance(other, Matrix3):
            return Matrix3(self.rows @ other.rows)
        return Vector3(self.rows @ np.array(vector3(other, "Matrix3")))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.rows, dtype)

    def transposed(self) -> Matrix3:
        """Rows for columns."""
        return Matrix3(self.rows.T)

    def inverted(self) -> Matrix3:
        """The map back."""
        return Matrix3(np.linalg.inv(self.rows))


class _OfBoth:
    """A name that makes something of the class and reads something of an instance, as Magnum has them."""

    def __init__(self, make: Any, read: Any, write: Any = None) -> None:
        self._make, self._read, self._write = make, read, write

    def __get__(self, instance: Any, owner: type) -> Any:
        return self._make if instance is None else self._read(instance)

    def __set__(self, instance: Any, value: Any) -> None:
        if self._write is None:
            raise AttributeError("this cannot be set")
        self._write(instance, value)


class Matrix4:
    """A transformation of space: a linear map, then a translation; of rows, (4, 4), or none: the identity.

    `Matrix4.translation(v)` is one, of a matrix `m.translation` where the origin goes; so is
    `Matrix4.rotation(angle, axis)`, and `m.rotation()` the linear map with columns of length 1.
    """

    rotation: Any  # both are given below, as they make a `Matrix4`
    translation: Any

    def __init__(self, rows: Any = None) -> None:
        self.rows = np.eye(4) if rows is None else np.array(rows, float).reshape(4, 4)

    @staticmethod
    def identity_init() -> Matrix4:
        """What leaves all where it is."""
        return Matrix4()

    @staticmethod
    def from_(rotation_scaling: Any, translation: Any) -> Matrix4:
        """Of a map (3, 3) and a translation (3,)."""
        made = Matrix4()
        made.rows[:3, :3] = np.asarray(rotation_scaling)
        made.rows[:3, 3] = vector3(translation, "Matrix4.from_")
        return made

    @staticmethod
    def scaling(factors: Any) -> Matrix4:
        """What stretches x, y and z by three factors."""
        return Matrix4.from_(np.diag(vector3(factors, "Matrix4.scaling")), (0.0, 0.0, 0.0))

    @staticmethod
    def rotation_x(angle: Deg | Rad) -> Matrix4:
        """About x."""
        return _turn(angle, (1.0, 0.0, 0.0))

    @staticmethod
    def rotation_y(angle: Deg | Rad) -> Matrix4:
        """About y."""
        return _turn(angle, (0.0, 1.0, 0.0))

    @staticmethod
    def rotation_z(angle: Deg | Rad) -> Matrix4:
        """About z."""
        return _turn(angle, (0.0, 0.0, 1.0))

    def rotation_scaling(self) -> Matrix3:
        """The linear map."""
        return Matrix3(self.rows[:3, :3])

    def transform_point(self, point: Any) -> Vector3:
        """(3,) where a place goes."""
        return Vector3(self.transform_vector(point) + self.rows[:3, 3])

    def transform_vector(self, vector: Any) -> Vector3:
        """(3,) what becomes of a direction."""
        return Vector3(self.rows[:3, :3] @ np.array(vector3(vector, "Matrix4")))

    def inverted(self) -> Matrix4:
        """The transformation back."""
        return Matrix4(np.linalg.inv(self.rows))

    def __matmul__(self, other: Matrix4) -> Matrix4:
        return Matrix4(self.rows @ other.rows)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.rows, dtype)


def _turn(angle: Deg | Rad, axis: Any) -> Matrix4:
    return Matrix4.from_(matrix(Quaternion.rotation(angle, axis)), (0.0, 0.0, 0.0))


def _unscaled(transform: Matrix4) -> Matrix3:
    linear = transform.rows[:3, :3]
    return Matrix3(linear / np.linalg.norm(linear, axis=0))


def _put(transform: Matrix4, place: Any) -> None:
    transform.rows[:3, 3] = vector3(place, "Matrix4.translation")


Matrix4.rotation = _OfBoth(_turn, lambda m: lambda: _unscaled(m))
Matrix4.translation = _OfBoth(
    lambda place: Matrix4.from_(np.eye(3), place), lambda m: Vector3(m.rows[:3, 3]), _put
)


class Range1D:
    """An interval: its ends."""

    _dimensions = 1

    def __init__(self, low: Any = None, high: Any = None) -> None:
        n = self._dimensions
        self.min, self.max = (
            np.array(np.broadcast_to(0.0 if end is None else np.asarray(end, float), (n,)))
            for end in (low, high)
        )

    @classmethod
    def from_size(cls, low: Any, size: Any) -> Any:
        """Of its lower end and its size."""
        return cls(low, np.asarray(low, float) + np.asarray(size, float))

    @classmethod
    def from_center(cls, center: Any, half_size: Any) -> Any:
        """Of its middle and half its size."""
        middle, half = np.asarray(center, float), np.asarray(half_size, float)
        return cls(middle - half, middle + half)

    def size(self) -> np.ndarray:
        """From end to end."""
        return np.asarray(self.max - self.min)

    def center(self) -> np.ndarray:
        """Its middle."""
        return np.asarray(0.5 * (self.min + self.max))

    def contains(self, point: Any) -> bool:
        """Whether a place is in it, its upper end excluded."""
        place = np.asarray(point, float)
        return bool(((self.min <= place) & (place < self.max)).all())


class Range2D(Range1D):
    """A rectangle along the axes: its lowest and highest corner."""

    _dimensions = 2


class Range3D(Range1D):
    """A box along the axes: its lowest and highest corner."""

    _dimensions = 3


def _dot(a: Any, b: Any) -> float:
    return float(np.dot(np.asarray(a, float), np.asarray(b, float)))


def _cross(a: Any, b: Any) -> Vector3:
    return Vector3(np.cross(np.asarray(a, float), np.asarray(b, float)))


def quat_to_magnum(quat: Any) -> Quaternion:
    """Magnum's quaternion of a rotation of numpy-quaternion's or of ours."""
    w, *v = as_wxyz(quat, "quat_to_magnum")
    return Quaternion(v, w)


def orthonormalize_rotation_shear(transform: Matrix4) -> Matrix4:
    """A transformation whose linear map is the rotation nearest to the one given, by singular values."""
    u, _, vh = np.linalg.svd(transform.rows[:3, :3])
    return Matrix4.from_(u @ vh, transform.rows[:3, 3])


math = SimpleNamespace(
    dot=_dot, cross=_cross, pi=python_math.pi, inf=python_math.inf, nan=python_math.nan
)
#: `magnum.trade`; habitat-lab makes a manager where it is imported, so making one is no use of it yet.
trade = SimpleNamespace(
    ImporterManager=lambda: RefusedObject("magnum.trade.ImporterManager()", NO_FILES),
    **{
        name: refused(f"magnum.trade.{name}", NO_FILES)
        for name in ("MeshAttribute", "MeshData", "SceneField")
    },
)
refuse_in(sys.modules[__name__], "magnum", MAGNUM)
