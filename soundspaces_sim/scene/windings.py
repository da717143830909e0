"""Which side of each face is the outside of what it bounds.

Sound that crosses a face passes a building element (`transport.elements`), which ends where it leaves by a face
that points away. So windings decide, and a mesh may have some of them wrong. Faces that share an edge are wound
alike; those of a piece that are not are turned to the majority, by area. What is nearly closed and thin is a body,
and is turned so that it has a positive volume: a wall that is modelled inside out is a wall all the same. What is
larger is a room, whose faces may look in or out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.core.numerics.rows import in_order
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import middles, welded_faces

# m, 3 V / A of what no room has; a wall of thickness t has 1.5 t, a small bathroom 0.6 m.
LARGEST_RADIUS = 0.5
# Share of a body's surface that may be missing: of what is flat the sum of area vectors is 1.
_OPENING = 0.25
_ROUNDING = 1e-9
_WELD = 5  # decimals of a metre to which corners of one place agree


class Sides(NamedTuple):
    """Of each face of a scene."""

    # (F,) 1 where the stored normal points out of what the face bounds, -1 where it points in
    outward: np.ndarray
    thin: np.ndarray  # (F,) whether it is of a closed thin body


def outward_sides(scene: Scene) -> np.ndarray:
    """(F,) int8: `Sides.outward`."""
    return find_sides(scene).outward.astype(np.int8)


def find_sides(scene: Scene) -> Sides:
    """Which side of each face is out."""
    count = len(scene.faces)
    _, in_place = welded_faces(scene.vertices, scene.faces, _WELD)
    ends, alike = zip(*(_neighbours(faces) for faces in (scene.faces, in_place)), strict=True)
    pairs, same = np.concatenate(ends, axis=1), np.concatenate(alike)
    # Every face as it is, and turned: what is wound alike hangs together.
    first = np.concatenate([pairs[0], pairs[0] + count])
    second = np.where(same, pairs[1], pairs[1] + count)
    second = np.concatenate([second, np.where(same, pairs[1] + count, pairs[1])])
    matrix = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(2 * count, 2 * count))
    label = connected_components(matrix, directed=False)[1]
    kept, turned = label[:count], label[count:]
    # A piece is a pair of components; one that meets itself turned has no sides, and stays as it is stored.
    piece = np.unique(np.minimum(kept, turned), return_inverse=True)[1]
    number = int(piece.max()) + 1
    sign = np.where(kept <= turned, 1.0, -1.0)
    sign *= np.where(np.bincount(piece, sign * scene.areas, number) < 0.0, -1.0, 1.0)[piece]
    inside_out, thin = _bodies(scene, piece, sign)
    sign *= np.where(inside_out, -1.0, 1.0)[piece]
    return Sides(sign.astype(np.int64), thin[piece])


def _neighbours(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(2, n) faces on both sides of the edges that have two, and whether these are wound alike."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key, order = in_order(np.minimum(start, end) * (int(faces.max()) + 1) + np.maximum(start, end))
    owner, turn = order // 3, (start < end)[order]
    fresh = np.append(np.flatnonzero(np.append(True, key[1:] != key[:-1])), len(key))
    first = fresh[:-1][np.diff(fresh) == 2]  # an edge of more faces parts pieces that touch
    first = first[owner[first] != owner[first + 1]]
    return np.stack([owner[first], owner[first + 1]]), turn[first] != turn[first + 1]


def _bodies(scene: Scene, piece: np.ndarray, sign: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(p,) which pieces are thin bodies whose faces, times `sign` (F,), look into them, and which are closed thin
    bodies, of whichever way."""
    area = np.asarray(np.bincount(piece, scene.areas), float)
    vectors = (scene.areas * sign)[:, None] * scene.normals
    opening = np.stack([np.bincount(piece, column) for column in vectors.T], axis=1)
    weighted = (np.bincount(piece, scene.areas * x) for x in middles(scene.corners).T)
    middle = np.stack(list(weighted), axis=1) / np.maximum(area, 1e-300)[:, None]
    height = ((scene.corners[:, 0] - middle[piece]) * vectors).sum(axis=1)
    volume = np.bincount(piece, height) / 3.0
    missing = np.linalg.norm(opening, axis=1) / np.maximum(area, 1e-300)
    thin = 3.0 * np.abs(volume) <= LARGEST_RADIUS * area
    some = np.abs(volume) > _ROUNDING * area * scene.diagonal
    return (missing <= _OPENING) & (volume < 0.0) & thin, (missing <= _ROUNDING) & thin & some
