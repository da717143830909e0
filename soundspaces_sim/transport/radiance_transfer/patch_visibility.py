"""Which pieces of surface belong to one patch: those that see one place above their cluster.

Sight is tested from three heights above the surface, so that a wall that ends a little above the floor parts
patches.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, negate, row
from soundspaces_sim.scene.rays.box_tree import in_place_order
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray, unoccluded

# m above the surface, where pieces must see the same: none that faces of meshes lie at
_HEIGHTS = np.array([0.0512938, 0.1537142, 0.4087365])
_ROUNDS = 4  # patches at most into which one side of a cluster falls apart


class Pieces(NamedTuple):
    """Triangles, split into n pieces."""

    face: np.ndarray  # (n,) triangle
    corners: np.ndarray  # (n, 3, 3) m
    center: np.ndarray  # (n, 3) m
    area: np.ndarray  # (n,) m²


class _Sight(NamedTuple):
    """Which pieces are tested against which places."""

    pieces: np.ndarray  # (m,) pieces that are tested
    own: np.ndarray  # (m,) place of each, among `places`
    places: np.ndarray  # (p,) pieces above whose middles the places are
    free: np.ndarray  # (p,) free levels above them
    order: np.ndarray  # (m,) rows of `pieces`, those near each other in turn


@part
def _free_levels(geometry: Geometry, point: Vec3, n: Vec3) -> int:
    """How many of the heights above a point of normal `n` are free: the lowest, and those up to which nothing lies
    above it."""
    low = _HEIGHTS[0]
    start = along(point, low, n)
    for count in range(len(_HEIGHTS), 1, -1):
        _, above = cast_ray(geometry, start, n, _HEIGHTS[count - 1] - low)
        if above < 0:
            return count
    return 1


@kernel
def _fill_free_levels(
    first: int,
    last: int,
    geometry: Geometry,
    places: np.ndarray,
    center: np.ndarray,
    normal: np.ndarray,
    free: np.ndarray,
) -> None:
    """Fill `free` (p,): `_free_levels` above the middles of the pieces `places` (p,); `center`, `normal` (n, 3)."""
    for k in range(first, last):
        free[k] = _free_levels(geometry, row(center, places[k]), row(normal, places[k]))


@part
def _sees(geometry: Geometry, point: Vec3, n: Vec3, place: Vec3, m: Vec3, levels: int) -> bool:
    """Whether a point of normal `n` and a `place` of normal `m` see each other at the `levels` lowest heights."""
    for k in range(levels):
        if not unoccluded(geometry, along(point, _HEIGHTS[k], n), along(place, _HEIGHTS[k], m)):
            return False
    return True


@part(forceinline=True)
def _sample_point(corners: np.ndarray, k: int) -> Vec3:
    """One of four points of a triangle (3, 3): near corner k, or for k = 3 its middle."""
    point = (0.0, 0.0, 0.0)
    for corner in range(3):
        share = 1.0 / 3.0 if k == 3 else (0.8 if corner == k else 0.1)
        point = along(point, share, row(corners, corner))
    return point


@kernel
def _count_seen(
    first: int,
    last: int,
    geometry: Geometry,
    pieces: Pieces,
    normal: np.ndarray,
    sight: _Sight,
    levels: np.ndarray,
    seen: np.ndarray,
) -> None:
    """Fill rows `sight.order[first:last]` of `seen` (m,): how many of four points of a piece subpaths can meet and
    see the place.

    That takes as many free levels above the point as above the place. Those above a point are found once: in
    `levels` (n, 4) they are -1 before, and 0 where subpaths do not meet it. Of `seen`, 0 and 4 are exact: once
    one point is seen and another is not, the rest is not tested. `normal` (n, 3) on the side that is tested.
    """
    low = _HEIGHTS[0]
    for k in range(first, last):
        r = sight.order[k]
        i, own = sight.pieces[r], sight.own[r]
        place, free, count = sight.places[own], sight.free[own], 0
        n = row(normal, i)
        for m in range(4):
            point = _sample_point(pieces.corners[i], m)
            if levels[i, m] < 0:
                _, below = cast_ray(geometry, along(point, low, n), negate(n), 2.0 * low)
                levels[i, m] = _free_levels(geometry, point, n) if below == pieces.face[i] else 0
            if levels[i, m] == free and _sees(
                geometry, point, n, row(pieces.center, place), row(normal, place), levels[i, m]
            ):
                count += 1
            if 0 < count <= m:
                break
        seen[r] = count


def split_by_visibility(
    geometry: Geometry,
    pieces: Pieces,
    cluster: np.ndarray,
    free: np.ndarray,
    sign: np.ndarray,
    least: float,
) -> np.ndarray:
    """(n,) patch of every piece on the side of `sign` (n,) of its normal, -1 for none: `free` (n,) pieces that see
    one place above their `cluster` (n,).

    The place is above the piece nearest to the middle of those that have no patch yet; what it does not see waits
    for the next round. A cluster of which no more than `least` m² are left has no further patch.
    """
    patch = np.full(len(cluster), -1)
    waiting = np.flatnonzero(free)
    normal = sign[:, None] * geometry.normal[pieces.face]
    levels = np.full((len(cluster), 4), -1, np.int8)
    order = in_place_order(pieces.corners)
    found = 0
    for _ in range(_ROUNDS):
        left = np.bincount(cluster[waiting], pieces.area[waiting])
        waiting = waiting[left[cluster[waiting]] > least]
        if len(waiting) == 0:
            break
        total, area = left[left > least], pieces.area[waiting]
        own = (np.cumsum(left > least) - 1)[cluster[waiting]]
        middle = np.stack([np.bincount(own, area * x) / total for x in pieces.center[waiting].T], axis=1)
        distance = np.linalg.norm(pieces.center[waiting] - middle[own], axis=1)
        least_off = np.full(len(total), np.inf)
        np.minimum.at(least_off, own, distance)
        first = np.flatnonzero(distance == least_off[own])[::-1]
        nearest = np.empty(len(total), np.int64)
        nearest[own[first]] = first  # the first of several that are as near
        places = waiting[nearest]
        above, seen = np.empty(len(places), np.int8), np.empty(len(waiting), np.int8)
        over_rows(_fill_free_levels, len(places), geometry, places, pieces.center, normal, above)
        # Rays that begin near each other find what they meet in a cache.
        row_of = np.full(len(cluster), -1)
        row_of[waiting] = np.arange(len(waiting))
        rows = row_of[order]
        sight = _Sight(waiting, own, places, above, rows[rows >= 0])
        over_rows(_count_seen, len(waiting), geometry, pieces, normal, sight, levels, seen)
        patch[waiting[seen == 4]] = found + own[seen == 4]
        found += len(total)
        again = seen == 0
        again[nearest] = False  # it had its turn
        waiting = waiting[again]
    return patch
