"""Checks of what callers give: a TypeError for what is of another kind, `RlrError` for what cannot be."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from soundspaces_rlr.errors import RlrError
from soundspaces_sim.parts import free_memory

_Thing = TypeVar("_Thing")
_FARTHEST = 1e6  # m
_BYTES = 12.0  # of a sample, in single and then in double precision


def pick(things: Sequence[_Thing], index: Any, what: str) -> _Thing:
    """The thing at an index. Raises `RlrError` if there is none."""
    number = operator.index(index)
    if not 0 <= number < len(things):
        raise RlrError(f"{what} {number} is not among the {len(things)} that were added")
    return things[number]


def length(value: Any, what: str) -> float:
    """A finite length, 0 or more. Raises `RlrError`."""
    if not 0.0 <= float(value) < np.inf:
        raise RlrError(f"{what}: expected 0 or more, got {value!r}")
    return float(value)


def check_reach(positions: np.ndarray, what: str) -> None:
    """Raise `RlrError` for a position (n, 3), m, that is too far away."""
    far = ~(np.abs(positions) <= _FARTHEST).all(axis=1)
    if far.any():
        i = int(far.argmax())
        raise RlrError(
            f"{what} {i} is at {positions[i].tolist()} m, where {_FARTHEST:g} m is the farthest; check unit_scale"
        )


def check_room(samples: float) -> None:
    """Raise `RlrError` if there is no memory for responses of so many samples in all."""
    wanted, free = _BYTES * samples, free_memory()
    if wanted > free:
        raise RlrError(
            f"the responses take {wanted / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are free; take fewer "
            "sources, listeners or channels, or a shorter max_ir_length"
        )


def vector3(values: Any, what: str) -> list[float]:
    """Three finite floats. Raises TypeError for another number of values, `RlrError` for NaN and inf."""
    try:
        array = np.asarray(values, float).ravel()
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (3,):
        raise TypeError(f"{what}: expected three numbers, got {values!r}")
    if not np.isfinite(array).all():
        raise RlrError(f"{what}: expected finite numbers, got {values!r}")
    return [float(v) for v in array]


def rotation(quaternion: Any, what: str) -> np.ndarray:
    """(3, 3) matrix of a quaternion [w, x, y, z], local to world, normalised first.

    Raises TypeError for another number of values, `RlrError` for one without length.
    """
    try:
        array = np.asarray(quaternion, float).ravel()
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (4,):
        raise TypeError(f"{what}: expected [w, x, y, z], got {quaternion!r}")
    length = float(np.linalg.norm(array))
    if not (np.isfinite(length) and length > 1e-9):
        raise RlrError(f"{what}: expected a quaternion [w, x, y, z] with a length, got {quaternion!r}")
    w, x, y, z = array / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def orthonormal(axes: np.ndarray) -> np.ndarray:
    """(3, 3) columns made orthogonal unit vectors. Raises `RlrError` unless they are right-handed."""
    u, s, vh = np.linalg.svd(axes)
    turned = u @ vh
    if s.min() < 0.1 * s.max() or np.linalg.det(turned) < 0.0:
        raise RlrError(
            "Config: hrtf_right, hrtf_up and hrtf_back must be right-handed axes, at right angles; got front, "
            f"left, up as columns {axes.tolist()}"
        )
    return np.asarray(turned)
