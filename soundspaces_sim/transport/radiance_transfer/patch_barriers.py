"""Where a face stands on another one and parts it: a wall on a floor that its mesh does not cut.

The air just above a piece of surface is a prism whose sides lean inwards: up to `_HEIGHT`, and within the piece by
`_INSET` and `_SLOPE` times the height. A piece is free on a side if no triangle reaches into that prism: all places
on it then have the same air above them. Triangles that meet the piece at its outline, and do not lean over it by
more than the sides do, leave it free; so does what lies in its plane.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rows import taken
from soundspaces_sim.core.numerics.vec3 import Vec3, dot, row, subtract
from soundspaces_sim.scene.rays.box_tree import (
    LEAF,
    BoxTree,
    clip,
    in_place_order,
    inwards,
    make_box_tree,
)
from soundspaces_sim.scene.triangles import boxes

_HEIGHT = 0.05  # m
_SLOPE = 0.5  # a wall that leans over a piece by less than 27° at its outline leaves it free
_INSET = 0.05  # of the offset of rays
_LEAST = 0.05  # of the offset of rays: the height from which on something is above a piece and not in its plane
# Of a triangle that five planes have cut: each adds half of them at most, with rounding.
_MOST_CORNERS = 20


class _Prism(NamedTuple):
    """A piece of surface and the frame in which the air above it is told."""

    a: Vec3  # m, corners
    b: Vec3
    c: Vec3
    inwards: tuple[Vec3, Vec3, Vec3]  # unit, in the plane, off the edges from a, b and c
    normal: Vec3


@part(forceinline=True)
def _prism(corners: np.ndarray, i: int, normal: Vec3) -> _Prism:
    """Of row i of `corners` (n, 3, 3), of this unit normal, about which they turn to the left."""
    a, b, c = row(corners[i], 0), row(corners[i], 1), row(corners[i], 2)
    sides = inwards(a, b, normal), inwards(b, c, normal), inwards(c, a, normal)
    return _Prism(a, b, c, sides, normal)


@part
def _reaches_in(
    prism: _Prism, epsilon: float, side: float, corners: np.ndarray, polygon: np.ndarray
) -> bool:
    """Whether a triangle (3, 3) reaches into the air on a `side`, 1 or -1, of a piece; `polygon`
    (2, _MOST_CORNERS, 5) is overwritten.

    A point is in it where five numbers, linear in the place, are not negative: distances to its sides, its bottom
    and its top. The triangle is cut by one after the other (Sutherland and Hodgman 1974).
    """
    least = _LEAST * epsilon
    for k in range(3):
        x = row(corners, k)
        height = side * dot(subtract(x, prism.a), prism.normal)
        polygon[0, k, 0] = height - least
        polygon[0, k, 1] = _HEIGHT - height
    for plane in range(2):
        if polygon[0, 0, plane] < 0.0 and polygon[0, 1, plane] < 0.0 and polygon[0, 2, plane] < 0.0:
            return False
    for plane in range(2, 5):
        corner = prism.a if plane == 2 else (prism.b if plane == 3 else prism.c)
        most = -math.inf
        for k in range(3):
            inset = _INSET * epsilon + _SLOPE * (polygon[0, k, 0] + least)
            across = dot(subtract(row(corners, k), corner), prism.inwards[plane - 2])
            polygon[0, k, plane] = across - inset
            most = max(most, polygon[0, k, plane])
        if most < 0.0:
            return False
    return clip(polygon, 5)[0] > 0


@part(forceinline=True)
def _apart(corners: np.ndarray, axis: int, low: float, high: float) -> bool:
    """Whether a triangle (3, 3) is beside a range along an axis."""
    a, b, c = corners[0, axis], corners[1, axis], corners[2, axis]
    return bool((a > high and b > high and c > high) or (a < low and b < low and c < low))


@kernel
def _find_barriers(
    first: int,
    last: int,
    tree: BoxTree,
    corners: np.ndarray,
    pieces: np.ndarray,
    normals: np.ndarray,
    epsilon: float,
    blocked: np.ndarray,
    polygon: np.ndarray,
) -> None:
    """Set entries of `blocked` (n, 2) that are False, of `pieces` (n, 3, 3) of `normals` (n, 3), to whether one of
    the triangles `corners`, in the order of the tree's leaves, reaches into the air on that side."""
    leaves = len(tree.triangle)
    for i in range(first, last):
        look0, look1 = not blocked[i, 0], not blocked[i, 1]
        prism = _prism(pieces, i, row(normals, i))
        low0, low1, low2 = prism.a
        high0, high1, high2 = prism.a
        for k in range(1, 3):
            x, y, z = row(pieces[i], k)
            low0, low1, low2 = min(low0, x), min(low1, y), min(low2, z)
            high0, high1, high2 = max(high0, x), max(high1, y), max(high2, z)
        up = _HEIGHT if look0 else 0.0
        down = -_HEIGHT if look1 else 0.0
        n0, n1, n2 = prism.normal
        low0, high0 = low0 + min(up * n0, down * n0), high0 + max(up * n0, down * n0)
        low1, high1 = low1 + min(up * n1, down * n1), high1 + max(up * n1, down * n1)
        low2, high2 = low2 + min(up * n2, down * n2), high2 + max(up * n2, down * n2)
        node = 1
        while node > 0 and (look0 or look1):
            if (
                tree.low[node, 0] <= high0 and tree.high[node, 0] >= low0
                and tree.low[node, 1] <= high1 and tree.high[node, 1] >= low1
                and tree.low[node, 2] <= high2 and tree.high[node, 2] >= low2
            ):  # fmt: skip
                if node < leaves:
                    node *= 2
                    continue
                for k in range(LEAF):
                    t = (node - leaves) * LEAF + k
                    if tree.triangle[node - leaves, k] < 0:
                        break
                    if (
                        _apart(corners[t], 0, low0, high0)
                        or _apart(corners[t], 1, low1, high1)
                        or _apart(corners[t], 2, low2, high2)
                    ):
                        continue
                    if look0 and _reaches_in(prism, epsilon, 1.0, corners[t], polygon):
                        look0, blocked[i, 0] = False, True
                    if look1 and _reaches_in(prism, epsilon, -1.0, corners[t], polygon):
                        look1, blocked[i, 1] = False, True
            while node & 1:
                node >>= 1
            if node > 0:
                node += 1


class Barriers:
    """Finds which pieces of surface triangles part, those of `corners` (F, 3, 3) m; `epsilon`, m, as in
    `Geometry`."""

    def __init__(self, corners: np.ndarray, epsilon: float) -> None:
        order = in_place_order(corners)
        self._corners, self._epsilon = taken(corners, order), epsilon
        self._tree = make_box_tree(order, *boxes(self._corners))

    def find(self, pieces: np.ndarray, normals: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """(n, 2) whether something parts `pieces` (n, 3, 3) in front of and behind their unit `normals` (n, 3),
        about which they turn to the left; False where it is not `wanted` (n, 2)."""
        if len(pieces) == 0:
            return wanted
        order = in_place_order(pieces)
        blocked = ~wanted[order]
        arguments = self._tree, self._corners, pieces[order], normals[order], self._epsilon, blocked
        over_rows(
            _find_barriers, len(pieces), *arguments, scratch=lambda: np.empty((2, _MOST_CORNERS, 5))
        )
        found = np.empty_like(blocked)
        found[order] = blocked
        return found & wanted
