"""Patches of surface, between which late sound travels alike for all points: what kernels look up.

A patch is the surface in one cell of a cubic lattice that faces the same of six main directions, has no gap in
depth, and sees one place above it from several heights. Floor on the other side of a wall that ends above it,
below a cupboard, or below a sofa belongs to another patch: sound never leaks from one half of a path to the
other, and the area of a patch is that which sound can reach. `weight` is 1 / R, with R the integral of ρs over
the patch.

Large triangles are split into pieces first, and pieces on which something stands into quarters
(`patch_construction`). Not every piece belongs to a patch: small ones on which something stands, those that see the
place in part only, and small patches are left to other techniques. So is the outline of pieces, as wide as rounding
may take a point across it: a wall may stand there.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, add, dot, length, row, subtract
from soundspaces_sim.scene.rays.geometry import Geometry

PATCH_SIZE = 0.8  # m, least edge of the lattice
CELL_SIZE = 1.6  # m, edge of that whose cells hold patches of neighbouring numbers, and groups of them
OUTLINE = 0.1  # of the offset of rays: the width of a piece's outline


class Places(NamedTuple):
    """Where sound leaves each patch. The pieces `start[c]` to `start[c + 1]` are those of patch c."""

    start: np.ndarray  # (C + 1,)
    triangle: np.ndarray  # (n,)
    area: np.ndarray  # (n,) m², without the outline
    # (n, 3, 3) m, so far within the piece that rays start from it on the right side of walls
    corners: np.ndarray
    normal: np.ndarray  # (n, 3) unit, on the side of the patch
    upto: np.ndarray  # (n,) share of the patch's mean strength (ρs dA), summed up to this piece
    ratio: np.ndarray  # (n, b) share of a band's strength over that of the mean


class Patches(NamedTuple):
    """Lookup of patches, for kernels. C patches, F triangles, b bands."""

    dual: np.ndarray  # (F, 2, 3) 1/m: barycentric (u, v) = dual · (x - anchor)
    splits: np.ndarray  # (F,) pieces per edge
    first: np.ndarray  # (F,) number of a triangle's first piece
    # (pieces, 2) patch in front of and behind the stored normal, -1 for none; -2 - k of a
    # piece whose quarters are pieces k to k + 3
    of_piece: np.ndarray
    weight: np.ndarray  # (C, b) 1/m², 1 / R; 0 where nothing is scattered
    middle: np.ndarray  # (C, 3) m
    places: Places


@part
def patch_at(patches: Patches, geometry: Geometry, triangle: int, point: Vec3, normal: Vec3) -> int:
    """Patch at a `point` (m) of a triangle, seen from the side of `normal`; -1 for none."""
    side = 0 if dot(row(geometry.normal, triangle), normal) > 0.0 else 1
    piece, n = patches.first[triangle], patches.splits[triangle]
    d, e = row(patches.dual[triangle], 0), row(patches.dual[triangle], 1)
    offset = subtract(point, row(geometry.anchor, triangle))
    u, v = dot(d, offset) * n, dot(e, offset) * n
    if n > 1:
        i = min(max(int(u), 0), n - 1)
        j = min(max(int(v), 0), n - 1 - i)
        u, v = u - i, v - j
        if u + v > 1.0 and i + j < n - 1:
            piece += 1
            u, v = 1.0 - u, 1.0 - v
        piece += 2 * (i * n + j)
    depth = float(n)
    while patches.of_piece[piece, 0] < -1:  # u, v: weights of the second and the third corner
        piece = -2 - patches.of_piece[piece, 0]
        depth *= 2.0
        if u + v < 0.5:
            u, v = 2.0 * u, 2.0 * v
        elif u > 0.5:
            piece += 1
            u, v = 2.0 * u - 1.0, 2.0 * v
        elif v > 0.5:
            piece += 2
            u, v = 2.0 * u, 2.0 * v - 1.0
        else:
            piece += 3
            u, v = 1.0 - 2.0 * u, 1.0 - 2.0 * v
    width = OUTLINE * geometry.epsilon * depth
    if u < width * length(d) or v < width * length(e) or 1.0 - u - v < width * length(add(d, e)):
        return -1
    return patches.of_piece[piece, side]


def inverse(values: np.ndarray) -> np.ndarray:
    """1 / x, and 0 where x is 0: the strength R of a patch from its weight, and the weight from R."""
    return np.divide(1.0, values, out=np.zeros_like(values), where=values > 0.0)


def no_patches(bands: int) -> Patches:
    """For models without radiance transfer."""
    empty, none = np.empty(0, np.int64), np.empty((0, 3))
    places = Places(
        np.zeros(1, np.int64),
        empty,
        np.empty(0),
        np.empty((0, 3, 3)),
        none,
        np.empty(0),
        np.empty((0, bands)),
    )
    of_piece, weight = np.empty((0, 2), np.int32), np.empty((0, bands))
    return Patches(np.empty((0, 2, 3)), empty, empty, of_piece, weight, none, places)
