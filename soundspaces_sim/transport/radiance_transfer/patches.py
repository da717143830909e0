"""Patches of surface, between which late sound travels alike for all points (`transfer`).

A patch is what lies in one cell of a cubic lattice, faces the same of six main directions, hangs
together in depth, and sees one place above it from several heights: floor on the other side of a wall
that ends above it, below a cupboard, or below a sofa belongs to another patch. So sound never leaks from
one half of a path to the other, and the area of a patch is that which sound can reach. `weight` is
1 / R, R the integral of rho s over the patch.

Large triangles are split into pieces first. Not every piece needs to be of a patch: walks do not merge
on those that see the place in part only, nor on small patches.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.scene.rays.geometry import cast, visible

PATCH_SIZE = 0.8  # m, edge of the lattice
_GAP = 0.02  # m of empty depth that parts two patches
_MOST_SPLITS = 256  # per edge; triangles that would need more (a ground plane) are no patches
_LEAST_AREA = 0.15  # of PATCH_SIZE²: smaller patches do not merge
_HEIGHTS = np.array([0.05, 0.15, 0.4])  # m above the surface: where pieces must see the same
_ROUNDS = 4  # patches at most that one side of a cluster falls apart into


class Places(NamedTuple):
    """Where sound leaves each patch. The pieces `start[c]` to `start[c + 1]` are those of patch c."""

    start: np.ndarray  # (C + 1,)
    corners: np.ndarray  # (n, 3, 3) m
    normal: np.ndarray  # (n, 3) on the side of the patch
    upto: np.ndarray  # (n,) share of the patch's mean strength (rho s dA), summed up to this piece
    ratio: np.ndarray  # (n, b) share of a band's strength over that of the mean


class Patches(NamedTuple):
    """Lookup of patches, for kernels. C patches, b bands."""

    dual: np.ndarray  # (F, 2, 3) 1/m: barycentric (u, v) = dual . (x - anchor)
    splits: np.ndarray  # (F,) pieces per edge
    first: np.ndarray  # (F,) number of a triangle's first piece
    of_piece: np.ndarray  # (pieces, 2) patch in front of and behind the stored normal, -1 for none
    weight: np.ndarray  # (C, b) 1/m²; 0 where nothing is scattered
    middle: np.ndarray  # (C, 3) m
    places: Places


@part
def patch_at(patches, geometry, triangle, x, y, z, nx, ny, nz):
    """Patch at a point of a triangle, seen from the side of (nx, ny, nz); -1 for none."""
    normal, anchor = geometry.normal, geometry.anchor
    front = normal[triangle, 0] * nx + normal[triangle, 1] * ny + normal[triangle, 2] * nz > 0.0
    piece = patches.first[triangle]
    n = patches.splits[triangle]
    if n > 1:
        ax, ay, az = x - anchor[triangle, 0], y - anchor[triangle, 1], z - anchor[triangle, 2]
        g = patches.dual
        u = (g[triangle, 0, 0] * ax + g[triangle, 0, 1] * ay + g[triangle, 0, 2] * az) * n
        v = (g[triangle, 1, 0] * ax + g[triangle, 1, 1] * ay + g[triangle, 1, 2] * az) * n
        i = min(max(int(u), 0), n - 1)
        j = min(max(int(v), 0), n - 1 - i)
        upper = 1 if (u - i) + (v - j) > 1.0 and i + j < n - 1 else 0
        piece += 2 * (i * n + j) + upper
    return patches.of_piece[piece, 0 if front else 1]


def inverse(values: np.ndarray) -> np.ndarray:
    """1 / x, and 0 where x is 0: of a patch's weight its strength, and the other way round."""
    return np.divide(1.0, values, out=np.zeros_like(values), where=values > 0.0)


def no_patches(bands: int) -> Patches:
    """For engines that do not merge."""
    empty, none = np.empty(0, np.int64), np.empty((0, 3))
    places = Places(np.zeros(1, np.int64), np.empty((0, 3, 3)), none, np.empty(0), np.empty((0, bands)))
    return Patches(
        np.empty((0, 2, 3)), empty, empty, np.empty((0, 2), np.int32), np.empty((0, bands)), none, places
    )


class _Pieces(NamedTuple):
    """Triangles, split: n pieces."""

    face: np.ndarray  # (n,)
    corners: np.ndarray  # (n, 3, 3) m
    center: np.ndarray  # (n, 3) m
    area: np.ndarray  # (n,)


def _split_faces(corners: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, _Pieces, np.ndarray]:
    """Split (F, 3, 3) triangles into pieces of about half `size`: (splits, first, pieces, number).

    Piece 2 (i n + j) + k of a triangle is the k-th half of the barycentric cell (i, j); cells beyond the
    triangle leave holes in the numbering.
    """
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
    n = np.maximum(np.ceil(edges / (0.5 * size)), 1.0)
    n = np.where(n > _MOST_SPLITS, 1, n).astype(np.int64)
    slots = np.where(n > 1, 2 * n**2, 1)
    first = np.concatenate([[0], np.cumsum(slots)[:-1]])
    face = np.repeat(np.arange(len(n)), slots)
    local = np.arange(len(face)) - first[face]
    m = n[face]
    i, j, upper = local // 2 // m, local // 2 % m, local % 2
    real = i + j + upper < m
    face, i, j, upper, m = face[real], i[real], j[real], upper[real], m[real]
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    whole = 0.5 * np.linalg.norm(np.cross(edge1, edge2), axis=1)
    origin, e1, e2 = corners[face, 0], edge1[face], edge2[face]
    flip = np.where(upper == 1, -1.0, 1.0)
    u, v = (i + upper) / m, (j + upper) / m
    a = origin + u[:, None] * e1 + v[:, None] * e2
    b = a + (flip / m)[:, None] * e1
    c = a + (flip / m)[:, None] * e2
    pieces = _Pieces(face, np.stack([a, b, c], axis=1), (a + b + c) / 3.0, whole[face] / m**2)
    return n, first, pieces, np.flatnonzero(real)


def _cluster(pieces: _Pieces, axis: np.ndarray, size: float) -> np.ndarray:
    """(n,) cluster of every piece: same lattice cell, same main direction, no gap in depth."""
    # Walls tend to lie at round coordinates: keep the lattice planes away from them.
    lattice = np.floor(pieces.center / size + 0.381966).astype(np.int64)
    rows = np.arange(len(axis))
    depth = pieces.corners[rows, :, axis]
    low, high = depth.min(axis=1), depth.max(axis=1)
    order = np.lexsort((low, lattice[:, 2], lattice[:, 1], lattice[:, 0], axis))
    key = np.column_stack([axis, lattice])[order]
    fresh = np.concatenate([[True], (key[1:] != key[:-1]).any(axis=1)])
    # Running maximum of `high` within a cell: lift every cell above all before it.
    lift = np.cumsum(fresh) * (high.max() - low.min() + 1.0)
    reach = np.maximum.accumulate(high[order] + lift) - lift
    gap = np.concatenate([[False], low[order][1:] > reach[:-1] + _GAP])
    patch = np.empty(len(axis), np.int64)
    patch[order] = np.cumsum(fresh | gap) - 1
    return patch


@part
def _levels(geometry, x, y, z, n):
    """How many of the heights above a point are free: the lowest, and those up to which nothing lies above it."""
    low = _HEIGHTS[0]
    x, y, z = x + low * n[0], y + low * n[1], z + low * n[2]
    for count in range(len(_HEIGHTS), 1, -1):
        _, above = cast(geometry, x, y, z, n[0], n[1], n[2], _HEIGHTS[count - 1] - low)
        if above < 0:
            return count
    return 1


@kernel
def _free_levels(first, last, geometry, places, center, normal, free):
    """Fill `free` (n,): `_levels` above the middles of pieces `places`."""
    for k in range(first, last):
        i = places[k]
        n = (normal[i, 0], normal[i, 1], normal[i, 2])
        free[k] = _levels(geometry, center[i, 0], center[i, 1], center[i, 2], n)


@part
def _sees(geometry, x, y, z, n, px, py, pz, m, levels):
    """Whether a point of normal `n` sees the place (px, py, pz) of normal `m` from `levels` heights, the lowest."""
    for k in range(levels):
        height = _HEIGHTS[k]
        if not visible(
            geometry, x + height * n[0], y + height * n[1], z + height * n[2], px + height * m[0],
            py + height * m[1], pz + height * m[2],
        ):  # fmt: skip
            return False
    return True


@kernel
def _count_seen(first, last, geometry, pieces, normal, rows, own, places, free, levels, seen):
    """Fill `seen` (n,): of four points of each of the pieces `rows`: how many walks can meet and see its place.

    That takes as many free heights above either, `free` above the place. Those above a point are found once: in
    `levels` (pieces, 4) they are -1 before, and 0 where walks do not meet it. Of `seen`, 0 and 4 are exact: once
    one point is seen and another is not, the rest is not looked at.
    """
    low, corners, center = _HEIGHTS[0], pieces.corners, pieces.center
    for row in range(first, last):
        i, p, count = rows[row], places[own[row]], 0
        n = (normal[i, 0], normal[i, 1], normal[i, 2])
        m = (normal[p, 0], normal[p, 1], normal[p, 2])
        for k in range(4):
            x, y, z = 0.0, 0.0, 0.0
            for corner in range(3):
                share = 1.0 / 3.0 if k == 3 else (0.8 if corner == k else 0.1)
                x += share * corners[i, corner, 0]
                y += share * corners[i, corner, 1]
                z += share * corners[i, corner, 2]
            if levels[i, k] < 0:
                _, below = cast(
                    geometry, x + low * n[0], y + low * n[1], z + low * n[2], -n[0], -n[1], -n[2],
                    2.0 * low,
                )  # fmt: skip
                levels[i, k] = _levels(geometry, x, y, z, n) if below == pieces.face[i] else 0
            if levels[i, k] == free[own[row]] and _sees(
                geometry, x, y, z, n, center[p, 0], center[p, 1], center[p, 2], m, levels[i, k]
            ):
                count += 1
            if 0 < count <= k:
                break
        seen[row] = count


def _part(
    geometry: tuple, pieces: _Pieces, cluster: np.ndarray, sign: np.ndarray, least: float
) -> np.ndarray:
    """(n,) patch of every piece on one side, -1 for none: what sees one place above its cluster.

    The place is above the piece nearest to the middle of what is not yet of a patch; what it does not
    see waits for the next round. Where no more than `least` m² are left, no patch is looked for.
    """
    patch = np.full(len(cluster), -1)
    waiting = np.arange(len(cluster))
    normal = sign[:, None] * geometry.normal[pieces.face]  # type: ignore[attr-defined]
    levels = np.full((len(cluster), 4), -1, np.int8)
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
        free, seen = np.empty(len(places), np.int8), np.empty(len(waiting), np.int8)
        over_rows(_free_levels, len(places), geometry, places, pieces.center, normal, free)
        over_rows(
            _count_seen, len(waiting), geometry, pieces, normal, waiting, own, places, free, levels, seen
        )
        patch[waiting[seen == 4]] = found + own[seen == 4]
        found += len(total)
        again = seen == 0
        again[nearest] = False  # it had its turn
        waiting = waiting[again]
    return patch


def make_patches(geometry: tuple, corners: np.ndarray, scattered: np.ndarray, size: float) -> Patches:
    """Patches of a scene.

    `corners` (F, 3, 3) relative to the scene's centre, in m; `scattered` (F, b): rho s of each face;
    `size` in m.
    """
    splits, first, pieces, number = _split_faces(corners, size)
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(e1, e2)
    square = (normal**2).sum(axis=1)[:, None]
    dual = np.stack([np.cross(e2, normal), np.cross(normal, e1)], axis=1) / square[:, None]

    direction = normal[pieces.face]
    axis = np.abs(direction).argmax(axis=1)
    cluster = _cluster(pieces, axis, size)
    along = np.sign(direction[np.arange(len(axis)), axis])
    table = np.full((int(np.where(splits > 1, 2 * splits**2, 1).sum()), 2), -1, np.int32)
    a, b, c = pieces.corners.transpose(1, 0, 2)
    extent = np.maximum(np.maximum(a, b), c) - np.minimum(np.minimum(a, b), c)
    small_enough = np.linalg.norm(extent, axis=1) < 2.0 * size
    weights: list[np.ndarray] = []
    sides, least = [], _LEAST_AREA * size**2
    for sign in (along, -along):  # all pieces from the side of the positive axis, then the other
        patch = _part(geometry, pieces, cluster, sign, least)
        patch[~small_enough] = -1
        on = patch >= 0
        bins = int(patch.max(initial=-1)) + 1
        area = np.bincount(patch[on], pieces.area[on], bins)
        strength = np.stack(
            [np.bincount(patch[on], pieces.area[on] * s, bins) for s in scattered[pieces.face[on]].T],
            axis=1,
        ).astype(float)  # counts of nothing are integers
        use = (area > least) & (strength.max(axis=1) > 0.0)
        before = sum(map(len, weights))
        renumber = np.append(np.where(use, before + np.cumsum(use) - 1, -1), -1)
        table[number, np.where(sign > 0.0, 0, 1)] = renumber[patch]
        sides.append((renumber[patch], sign))
        strength = strength[use]
        weights.append(inverse(strength))
    weight = np.concatenate(weights)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    places, middle = _places(pieces, scattered[pieces.face], unit, sides, weight)
    return Patches(np.ascontiguousarray(dual), splits, first, table, weight, middle, places)


def _places(
    pieces: _Pieces,
    scattered: np.ndarray,
    unit: np.ndarray,
    sides: list[tuple[np.ndarray, np.ndarray]],
    weight: np.ndarray,
) -> tuple[Places, np.ndarray]:
    """Pieces of (n, b) `scattered` by patch, on both `sides` (patch, sign of the normal); patch middles."""
    patch = np.concatenate([side[0] for side in sides])
    sign = np.concatenate([side[1] for side in sides])
    order = np.argsort(patch, kind="stable")
    order = order[np.searchsorted(patch[order], 0) :]
    patch, piece = patch[order], order % len(pieces.area)
    strength = pieces.area[piece, None] * scattered[piece]
    mean = strength.mean(axis=1)
    bins = len(weight)
    start = np.searchsorted(patch, np.arange(bins + 1))
    total = np.bincount(patch, mean, bins)
    running = np.cumsum(mean)
    before = np.concatenate([[0.0], running])[start[:-1]]
    share = mean / total[patch]
    ratio = np.divide(
        strength * weight[patch], share[:, None], out=np.zeros_like(strength), where=share[:, None] > 0.0
    )
    middle = np.stack(
        [np.bincount(patch, mean * x, bins) / total for x in pieces.center[piece].T], axis=1
    )
    places = Places(
        start, pieces.corners[piece], sign[order][:, None] * unit[piece],
        (running - before[patch]) / total[patch], ratio,
    )  # fmt: skip
    return places, middle
