"""A scene of objects in the kernels' form, prepared in parts that are kept while what they are made of stays.

What takes time is grouping triangles into planes: they are grouped object by object, and kept under the digest of
the object's triangles. After an object has moved, its planes alone are made again, and the result is, to the
bit, that of a scene made afresh. (All is made again if an object changes the bounds of the scene: kernels work
relative to their middle.)
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np

from soundspaces_sim import Scene, SimulationConfig
from soundspaces_sim.parts import (
    PreparedScene,
    SpecularPlanes,
    group_planes,
    prepare_planes,
    prepare_scene,
)

_MOST_PLANES = 2000

_Part = TypeVar("_Part")


class Kept:
    """Parts by the digest of what they were made of: those of the scene at hand and of the one before it."""

    def __init__(self) -> None:
        self._before: dict[bytes, Any] = {}
        self._now: dict[bytes, Any] = {}

    def start_scene(self) -> None:
        """Another scene is about to be prepared."""
        self._before, self._now = self._now, {}

    def part(self, make: Callable[..., _Part], *of: np.ndarray) -> _Part:
        """`make(*of)`, or what it gave for the same arrays."""
        sha = hashlib.blake2b(make.__name__.encode(), digest_size=16)
        for array in of:
            sha.update(repr((array.shape, array.dtype.str)).encode())
            sha.update(np.ascontiguousarray(array).data)
        key = sha.digest()
        if key not in self._now:
            self._now[key] = self._before[key] if key in self._before else make(*of)
        return self._now[key]


def prepare(scene: Scene, owner: np.ndarray, config: SimulationConfig, kept: Kept) -> PreparedScene:
    """The scene under a config. `owner` (F,): the object of each face."""
    return prepare_scene(scene, config, {prepare_planes: _planes(scene, owner, kept)})


class _ObjectPlanes(NamedTuple):
    normal: np.ndarray  # (P, 3)
    offset: np.ndarray  # (P,) m
    margin: np.ndarray  # (P,) m
    area: np.ndarray  # (P,) m²
    of_face: np.ndarray  # (F,) row, or -1


def _object_planes(corners: np.ndarray) -> _ObjectPlanes:
    """SpecularPlanes of an object's faces (F, 3, 3)."""
    planes = group_planes(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    on = planes.of_face >= 0
    area = np.bincount(planes.of_face[on], 0.5 * np.linalg.norm(cross[on], axis=1), len(planes.offset))
    return _ObjectPlanes(planes.normal, planes.offset, planes.margin, area, planes.of_face)


def _planes(scene: Scene, owner: np.ndarray, kept: Kept) -> SpecularPlanes:
    """The planes of a scene, the largest first."""
    corners = scene.corners - scene.center
    of_face = np.full(len(owner), -1)
    found: list[_ObjectPlanes] = []
    for thing in np.unique(owner):
        own = np.flatnonzero(owner == thing)
        planes = kept.part(_object_planes, corners[own])
        before = sum(len(p.offset) for p in found)
        of_face[own] = np.where(planes.of_face >= 0, planes.of_face + before, -1)
        found.append(planes)
    order = np.argsort(-np.concatenate([p.area for p in found]), kind="stable")[:_MOST_PLANES]
    row = np.full(sum(len(p.offset) for p in found) + 1, -1)
    row[order] = np.arange(len(order))
    return SpecularPlanes(
        np.concatenate([p.normal for p in found])[order],
        np.concatenate([p.offset for p in found])[order],
        np.concatenate([p.margin for p in found])[order],
        row[of_face],
    )
