"""A scene of objects in the kernels' form, prepared in parts that are kept while what they are made of stays.

What takes time is grouping triangles into planes and finding patches. Planes are grouped object by object.
Patches are found block by block of space: a block's are a function of the triangles in it and close by alone,
in a scene for rays of its own, so that not even the order in which Embree meets faces that coincide hangs on
what lies elsewhere. Either is kept under the digest of all that it is made of. After an object has moved, its
planes and the blocks that it left and entered are made again, and the result is, to the bit, that of a scene
made afresh. (All is made again if an object changes the bounds of the scene: kernels work relative to their
middle.)
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np

from soundspaces_sim.base.config import SimulationConfig
from soundspaces_sim.rays.embree import RayScene
from soundspaces_sim.rays.geometry import Geometry
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.model import Mirrors, Model, assemble_model, bending_edges, scene_surfaces
from soundspaces_sim.transport.patches import (
    PATCH_SIZE,
    Patches,
    Places,
    join_places,
    lattice_cell,
    make_patches,
    no_patches,
    select_places,
    split_faces,
)
from soundspaces_sim.transport.planes import group_planes
from soundspaces_sim.transport.surface import scattered_energy

BLOCK = 5  # cells of the lattice of patches along an edge
_MARGIN = 0.5  # m: what a patch's pieces and the rays between them reach beyond its cell
_MOST_PLANES = 2000
_HALF = 2**20  # blocks to either side: more than scenes may be wide
_MOST_BLOCKS = 4096  # that one face may reach; beyond, it is too large to be of a patch

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


def prepare(scene: Scene, owner: np.ndarray, config: SimulationConfig, seed: int, kept: Kept) -> Model:
    """A model of the scene for echograms of any length up to `config.max_duration`; `at_points` fits it to points.

    `owner` (F,): the object of each face.
    """
    of_face, mirrors = _planes(scene, owner, kept)
    surfaces, surface = scene_surfaces(scene, config)
    geometry = scene.geometry._replace(plane=of_face, material=surface)
    patches = no_patches(len(config.bands) - 1)
    if config.merging:
        patches = _patches(scene, scattered_energy(surfaces)[surface], kept)
    duration = config.duration or config.max_duration
    return assemble_model(
        scene,
        config,
        seed,
        duration,
        geometry,
        surfaces,
        mirrors,
        *bending_edges(scene, config),
        patches,
    )


class _ObjectPlanes(NamedTuple):
    normal: np.ndarray  # (P, 3)
    offset: np.ndarray  # (P,) m
    margin: np.ndarray  # (P,) m
    area: np.ndarray  # (P,) m²
    of_face: np.ndarray  # (F,) row, or -1


def _object_planes(corners: np.ndarray) -> _ObjectPlanes:
    """Planes of an object's faces (F, 3, 3)."""
    planes = group_planes(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    on = planes.of_face >= 0
    area = np.bincount(planes.of_face[on], 0.5 * np.linalg.norm(cross[on], axis=1), len(planes.offset))
    return _ObjectPlanes(planes.normal, planes.offset, planes.margin, area, planes.of_face)


def _planes(scene: Scene, owner: np.ndarray, kept: Kept) -> tuple[np.ndarray, Mirrors]:
    """(F,) plane of each face, -1 for none; the planes, the largest first."""
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
    mirrors = Mirrors(
        np.concatenate([p.normal for p in found])[order],
        np.concatenate([p.offset for p in found])[order],
        np.concatenate([p.margin for p in found])[order],
    )
    return row[of_face], mirrors


@dataclass(frozen=True)
class _Block:
    """Patches of the pieces whose middles lie in one block; k faces."""

    dual: np.ndarray  # (k, 2, 3), see Patches
    splits: np.ndarray  # (k,)
    face: np.ndarray  # (n,) of each piece, among the k
    slot: np.ndarray  # (n,) of each piece, among those of its face
    of_piece: np.ndarray  # (n, 2)
    weight: np.ndarray  # (patches, b)
    middle: np.ndarray  # (patches, 3) m
    places: Places


def _patches(scene: Scene, scattered: np.ndarray, kept: Kept) -> Patches:
    """What `make_patches` finds, put together from blocks; patches are numbered block by block."""
    corners = scene.corners - scene.center
    epsilon = np.array(scene.geometry.epsilon)
    blocks = []
    for block, own, near in _in_blocks(corners):
        at = np.concatenate([own, near])
        part = kept.part(
            _block_patches, block, np.array(len(own)), corners[at], scene.normals[at], scattered[own], epsilon
        )  # fmt: skip
        blocks.append((own, part))
    splits = np.ones(len(corners), np.int64)
    dual = np.zeros((len(corners), 2, 3))
    for own, part in blocks:
        splits[own], dual[own] = part.splits, part.dual
    slots = np.where(splits > 1, 2 * splits**2, 1)
    first = np.concatenate([[0], np.cumsum(slots)[:-1]])
    of_piece = np.full((int(slots.sum()), 2), -1, np.int32)
    before = 0
    for own, part in blocks:
        rows = np.where(part.of_piece >= 0, part.of_piece + before, -1)
        of_piece[first[own[part.face]] + part.slot] = rows
        before += len(part.weight)
    none, parts = no_patches(scattered.shape[1]), [part for _, part in blocks]
    weight = np.concatenate([none.weight, *(part.weight for part in parts)])
    middle = np.concatenate([none.middle, *(part.middle for part in parts)])
    places = join_places([none.places, *(part.places for part in parts)])
    return Patches(dual, splits, first, of_piece, weight, middle, places)


def _in_blocks(corners: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(block (3,), faces that may have pieces in it, faces that are near it besides) of all blocks with faces."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    first, last = _block_of(low - _MARGIN), _block_of(high + _MARGIN)
    count = (last - first + 1).astype(float).prod(axis=1)
    large = np.flatnonzero(count > _MOST_BLOCKS)
    small = np.flatnonzero(count <= _MOST_BLOCKS)
    face, block = _spread(small, first, last)
    middle = corners[large].mean(axis=1)  # such a face is one piece
    face, block = np.concatenate([face, large]), np.concatenate([block, _block_of(middle)])
    inside = ((block >= _block_of(low)[face]) & (block <= _block_of(high)[face])).all(axis=1)
    key = ((block + _HALF) @ [(2 * _HALF) ** 2, 2 * _HALF, 1]).astype(np.int64)
    order = np.lexsort((face, ~inside, key))
    out = []
    for rows in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
        here = block[rows[0]]
        own, near = face[rows[inside[rows]]], face[rows[~inside[rows]]]
        if len(own):
            passing = (first[large] <= here).all(axis=1) & (last[large] >= here).all(axis=1)
            near = np.union1d(near, np.setdiff1d(large[passing], own))
            out.append((here, own, near))
    return out


def _block_of(points: np.ndarray) -> np.ndarray:
    """(n, 3) block of (n, 3) points in m."""
    return np.asarray((lattice_cell(points, PATCH_SIZE) + BLOCK // 2) // BLOCK)


def _spread(faces: np.ndarray, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each of some faces once for every block from (F, 3) `first` to `last`: (n,) face, (n, 3) block."""
    face = faces
    block = np.empty((len(faces), 0), np.int64)
    for axis in range(3):
        count = last[face, axis] - first[face, axis] + 1
        rows = np.repeat(np.arange(len(face)), count)
        step = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
        face = face[rows]
        block = np.column_stack([block[rows], first[face, axis] + step])
    return face, block


def _block_patches(
    block: np.ndarray, count: np.ndarray, corners: np.ndarray, normals: np.ndarray, scattered: np.ndarray,
    epsilon: np.ndarray,
) -> _Block:  # fmt: skip
    """Patches of the first `count` of some faces, as far as their pieces lie in a block; all stop rays."""
    rays = RayScene(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    none = np.zeros(len(corners), np.int64)
    geometry = Geometry(
        rays.handle, rays.tied(np.ascontiguousarray(corners[:, 0])), np.ascontiguousarray(normals), none, none,
        float(epsilon),
    )  # fmt: skip
    own = corners[: int(count)]
    made = make_patches(geometry, own, scattered, PATCH_SIZE)
    _, _, pieces, number = split_faces(own, PATCH_SIZE)
    here = (_block_of(pieces.center) == block).all(axis=1)
    face, number = pieces.face[here], number[here]
    of_piece = made.of_piece[number]
    used = np.unique(of_piece[of_piece >= 0])
    renumber = np.full(len(made.weight) + 1, -1, np.int32)
    renumber[used] = np.arange(len(used))
    return _Block(
        made.dual, made.splits, face, number - made.first[face], renumber[of_piece], made.weight[used],
        made.middle[used], select_places(made.places, used),
    )  # fmt: skip
