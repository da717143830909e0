"""Triangles near a place: a complete binary tree of boxes, over the order of their Morton codes."""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.rows import in_order
from soundspaces_sim.core.numerics.vec3 import Vec3, cross, divide, length, subtract

LEAF = 4  # triangles
_BITS = 16  # of a coordinate in Morton codes
# Its bits to every third place.
_SPREAD = (16, 0xFF0000FF), (8, 0xF00F00F00F), (4, 0xC30C30C30C3), (2, 0x249249249249)


class BoxTree(NamedTuple):
    """Boxes about F triangles: node 1 is the whole, 2 i and 2 i + 1 the halves of node i, the last ones leaves."""

    low: np.ndarray  # (2 L, 3) m
    high: np.ndarray  # (2 L, 3) m
    triangle: np.ndarray  # (L, LEAF), -1 for none


@kernel
def _find_codes(corners: np.ndarray, least: np.ndarray, scale: float, code: np.ndarray) -> None:
    for i in range(len(corners)):
        code[i] = 0
        for axis in range(3):
            a, b, c = corners[i, 0, axis], corners[i, 1, axis], corners[i, 2, axis]
            middle = 0.5 * (min(a, b, c) + max(a, b, c))
            cell = int(min(max((middle - least[axis]) * scale, 0.0), 2.0**_BITS - 1.0))
            for shift, mask in _SPREAD:
                cell = (cell | cell << shift) & mask
            code[i] |= cell << axis


def in_place_order(corners: np.ndarray) -> np.ndarray:
    """(n,) rows of triangles (n, 3, 3) in an order in which those near each other in space are near in memory."""
    least = corners[:, 0].min(axis=0)
    extent = float((corners[:, 0].max(axis=0) - least).max())
    code = np.empty(len(corners), np.int64)
    _find_codes(np.ascontiguousarray(corners), least, (2**_BITS - 1) / max(extent, 1e-300), code)
    return in_order(code)[1]


def make_box_tree(order: np.ndarray, low: np.ndarray, high: np.ndarray) -> BoxTree:
    """The tree of triangles in the `order` (F,) of `in_place_order`, with boxes from `low` (F, 3) m to `high` in
    that order, which is the leaves': a search reads what is near in memory."""
    leaves = 1 << max(int(np.ceil(np.log2(len(order) / LEAF))), 0)
    triangle = np.full(leaves * LEAF, -1)
    triangle[: len(order)] = order
    tree = BoxTree(*np.empty((2, 2 * leaves, 3)), triangle.reshape(leaves, LEAF))
    _bound(tree, low, high)
    return tree


@kernel
def _bound(tree: BoxTree, low: np.ndarray, high: np.ndarray) -> None:
    """Fill the tree's boxes with those about the triangles', which go from `low` (F, 3) to `high` in its order."""
    leaves = len(tree.triangle)
    for node in range(2 * leaves - 1, 0, -1):
        for axis in range(3):
            least, most = np.inf, -np.inf
            if node < leaves:
                least = min(tree.low[2 * node, axis], tree.low[2 * node + 1, axis])
                most = max(tree.high[2 * node, axis], tree.high[2 * node + 1, axis])
            else:
                first = (node - leaves) * LEAF
                for t in range(first, min(first + LEAF, len(low))):
                    least, most = min(least, low[t, axis]), max(most, high[t, axis])
            tree.low[node, axis], tree.high[node, axis] = least, most
    for axis in range(3):  # no node
        tree.low[0, axis], tree.high[0, axis] = np.inf, -np.inf


@part
def clip(polygon: np.ndarray, planes: int) -> tuple[int, int]:
    """(Corners left of a triangle where its first `planes` columns are not negative, row of `polygon` that has
    them); `polygon` (2, n, columns): its corners in row 0, and room (Sutherland & Hodgman 1974)."""
    count, now = 3, 0
    for plane in range(planes):
        kept, before, after = 0, polygon[now], polygon[1 - now]
        for k in range(count):
            nxt = k + 1 if k + 1 < count else 0
            here, there = before[k, plane], before[nxt, plane]
            if here >= 0.0:
                for m in range(polygon.shape[2]):
                    after[kept, m] = before[k, m]
                kept += 1
            if (here >= 0.0) != (there >= 0.0):
                t = here / (here - there)
                for m in range(polygon.shape[2]):
                    after[kept, m] = before[k, m] + t * (before[nxt, m] - before[k, m])
                kept += 1
        if kept == 0:
            return 0, now
        count, now = kept, 1 - now
    return count, now


@part(forceinline=True)
def inwards(p: Vec3, q: Vec3, normal: Vec3) -> Vec3:
    """Unit, in the plane of a triangle of this normal, off its edge from p to q."""
    across = cross(normal, subtract(q, p))
    return divide(across, max(length(across), 1e-30))  # of an edge without length, nothing
