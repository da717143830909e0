"""Closed solids: walls, slabs and furniture that are modelled with a thickness, so that no air is inside them.

A material's transmission is that of a whole element: of a wall, not of one of the two faces that a mesh gives it.
Sound that passes into a solid therefore leaves it on its other side without loss, and nothing is reflected inside.

A solid is a piece of mesh that closes: each edge has two of its triangles, wound alike. Rooms close as well. They
are told apart by size: a body of volume V and surface A is a solid up to a radius 3 V / A of 0.5 m, as a sphere
of that radius has it; a wall of thickness t has 1.5 t, a wardrobe 0.4 m, the smallest bathroom 0.6 m. A piece as
large as the scene is a room however small it is: the model of one, or a lone box.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import welded

LARGEST_RADIUS = 0.5  # m, 3 V / A of what no room has
_OF_SCENE = 0.999  # share of the scene's extent in every direction that makes a piece as large as it
_WELD = 5  # decimals of a metre to which corners of one place agree


class ClosedSolids(NamedTuple):
    """Which faces of a scene bound closed solids."""

    of_face: np.ndarray  # (F,) number of the solid, -1 for none
    outward: np.ndarray  # (F,) whether the stored normal points out of it


def closed_solids(scene: Scene) -> ClosedSolids:
    """The closed solids of a scene, in the order of their first faces.

    Pieces hang together as the file's vertices say, or else where corners lie in one place: boxes that touch are
    two pieces in the first sense and may be none in the second.
    """
    count = len(scene.faces)
    of_face, outward = np.full(count, -1), np.zeros(count, bool)
    for weld in (False, True):
        left = np.flatnonzero(of_face < 0)
        if len(left) == 0:
            break
        faces = welded(scene.corners[left], _WELD)[1] if weld else scene.faces[left]
        piece, volume = _closed_pieces(faces, scene.corners[left] - scene.center)
        solid = _is_solid(piece, volume, scene, left)
        number = np.where(solid, int(of_face.max()) + np.cumsum(solid), -1)
        inside = piece >= 0
        of_face[left[inside]] = number[piece[inside]]
        outward[left[inside]] = volume[piece[inside]] > 0.0
    first = np.unique(of_face[of_face >= 0], return_index=True)[1]
    order = np.empty(len(first), np.int64)
    order[np.argsort(first)] = np.arange(len(first))
    of_face[of_face >= 0] = order[of_face[of_face >= 0]]
    return ClosedSolids(of_face, outward)


def _closed_pieces(faces: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) piece of each of (n, 3) faces, -1 of those that are not closed, and the (p,) signed volume of each, m³:
    positive where normals point out."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    owner = np.repeat(np.arange(len(faces)), 3)
    key = np.minimum(start, end) * (int(faces.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    key, owner, turn = key[order], owner[order], np.where(start < end, 1, -1)[order]
    fresh = np.append(np.flatnonzero(np.append(True, key[1:] != key[:-1])), len(key))
    first, size = fresh[:-1], np.diff(fresh)
    pairs = first[size == 2]  # an edge of more faces parts pieces that touch
    ends = owner[pairs], owner[pairs + 1]
    matrix = coo_array((np.ones(len(pairs), np.int8), ends), shape=(len(faces), len(faces)))
    count, piece = connected_components(matrix, directed=False)
    # Within a piece every edge must have two faces, of opposite turns.
    order = np.lexsort((key, piece[owner]))
    key, of_piece, turn = key[order], piece[owner[order]], turn[order]
    fresh = np.append(True, (key[1:] != key[:-1]) | (of_piece[1:] != of_piece[:-1]))
    edge = np.cumsum(fresh) - 1
    good = (np.bincount(edge) == 2) & (np.bincount(edge, turn) == 0.0)
    closed = np.ones(count, bool)
    closed[of_piece[fresh][~good]] = False
    volume = np.bincount(piece, _signed_volumes(corners), count)
    number = np.where(closed, np.cumsum(closed) - 1, -1)
    return number[piece], volume[closed]


def _signed_volumes(corners: np.ndarray) -> np.ndarray:
    """(n,) m³ of the tetrahedra from the origin to triangles (n, 3, 3)."""
    a, b, c = corners.transpose(1, 0, 2)
    return np.asarray(np.einsum("nx,nx->n", a, np.cross(b, c)) / 6.0)


def _is_solid(piece: np.ndarray, volume: np.ndarray, scene: Scene, faces: np.ndarray) -> np.ndarray:
    """(p,) which closed pieces are solids; `piece` (n,) of the scene's `faces` (n,)."""
    inside = piece >= 0
    of, corners = piece[inside], scene.corners[faces[inside]]
    area = np.bincount(of, scene.areas[faces[inside]], len(volume))
    low = np.full((len(volume), 3), np.inf)
    high = -low
    np.minimum.at(low, of, corners.min(axis=1))
    np.maximum.at(high, of, corners.max(axis=1))
    whole = scene.bounds[1] - scene.bounds[0]
    as_scene = ((high - low) >= _OF_SCENE * whole).all(axis=1)
    return (3.0 * np.abs(volume) <= LARGEST_RADIUS * area) & (volume != 0.0) & ~as_scene
