"""Patches of a scene: triangles are split into pieces, pieces on which something stands into quarters
(`patch_barriers`), pieces clustered by cell, direction and depth, clusters parted by sight (`patch_visibility`).
`patches` defines a patch."""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.vec3 import add, cross, length, put, row, scale, subtract
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.scene.rays.overlaps import covered
from soundspaces_sim.scene.triangles import areas, boxes, cross_products, longest_edges, middles
from soundspaces_sim.transport.radiance_transfer.patch_barriers import Barriers
from soundspaces_sim.transport.radiance_transfer.patch_visibility import Pieces, split_by_visibility
from soundspaces_sim.transport.radiance_transfer.patches import (
    CELL_SIZE,
    OUTLINE,
    Patches,
    Places,
    inverse,
)

_GAP = 0.02  # m of empty depth that parts two patches
_MOST_SPLITS = 256  # per edge; triangles that would need more (a ground plane) are no patches
_LEAST_AREA = 0.15  # of the lattice's cell size squared: smaller patches are left out
_QUARTERED = 0.1  # m, longest edge of pieces that are quartered no more
_CLEAR = 0.6  # of the offset of rays: so far off the outline rays start, for a wall may lean over it
_MOST_CLEAR = 0.9  # of a piece's height, in all
_OF_THREAD = 4096  # pieces for which it is worth to start a thread


class _Split(NamedTuple):
    """n pieces of triangles."""

    number: np.ndarray  # (n,) row of `Patches.of_piece`
    face: np.ndarray  # (n,) triangle
    corners: np.ndarray  # (n, 3, 3) m, which turn as those of the triangle


def _split_faces(corners: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, _Split, np.ndarray]:
    """Split (F, 3, 3) triangles into pieces of about half `size`: (splits, first, pieces, of_piece).

    Piece 2 (i n + j) + k of a triangle is the k-th half of the barycentric cell (i, j); cells beyond the
    triangle leave holes in the numbering.
    """
    edges = np.sqrt(longest_edges(corners))
    n = np.maximum(np.ceil(edges / (0.5 * size)), 1.0)
    n = np.where(n > _MOST_SPLITS, 1, n).astype(np.int64)
    slots = np.where(n > 1, 2 * n**2, 1)
    first = np.concatenate([[0], np.cumsum(slots)[:-1]])
    face = np.repeat(np.arange(len(n)), slots)
    local = np.arange(len(face)) - first[face]
    m = n[face]
    i, j, upper = local // 2 // m, local // 2 % m, local % 2
    real = i + j + upper < m
    number = np.flatnonzero(real)
    face, i, j, upper, m = face[real], i[real], j[real], upper[real], m[real]
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    origin, e1, e2 = corners[face, 0], edge1[face], edge2[face]
    flip = np.where(upper == 1, -1.0, 1.0)
    u, v = (i + upper) / m, (j + upper) / m
    a = origin + u[:, None] * e1 + v[:, None] * e2
    b = a + (flip / m)[:, None] * e1
    c = a + (flip / m)[:, None] * e2
    split = _Split(number, face, np.stack([a, b, c], axis=1))
    return n, first, split, np.full((int(slots.sum()), 2), -1, np.int32)


def _quartered(
    geometry: Geometry, corners: np.ndarray, split: _Split, wanted: np.ndarray, of_piece: np.ndarray
) -> tuple[_Split, np.ndarray, np.ndarray]:
    """Quarter pieces until nothing stands or lies on them or they are small: (pieces, free, of_piece).

    `free` (n, 2): whether nothing stands in front of and behind a piece, where it is `wanted` (n, 2), and nothing
    lies on it.
    """
    barriers = Barriers(corners, geometry.epsilon)
    done: list[tuple[_Split, np.ndarray]] = []
    while len(split.number):
        parted = barriers.find(split.corners, geometry.normal[split.face], wanted)
        parted |= wanted & covered(geometry, split.corners, split.face)[:, None]
        longest = np.sqrt(longest_edges(split.corners))
        again = parted.any(axis=1) & (longest > _QUARTERED)
        done.append((_Split(*(column[~again] for column in split)), (wanted & ~parted)[~again]))
        a, b, c = split.corners[again].transpose(1, 0, 2)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        quarters = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, bc, ca, ab], axis=1).reshape(-1, 3, 3)
        number = len(of_piece) + np.arange(len(quarters))
        of_piece[split.number[again]] = (-2 - number[::4])[:, None]
        of_piece = np.concatenate([of_piece, np.full((len(quarters), 2), -1, np.int32)])
        split = _Split(number, np.repeat(split.face[again], 4), quarters)
        wanted = np.repeat(wanted[again], 4, axis=0)
    pieces, free = zip(*done, strict=True)
    columns = (np.concatenate(column) for column in zip(*pieces, strict=True))
    return _Split(*columns), np.concatenate(free), of_piece


def _inset(corners: np.ndarray, width: float) -> np.ndarray:
    """Triangles (n, 3, 3) with each edge moved inwards by `width` m, or less where little would be left."""
    out = np.empty_like(corners)
    over_rows(_move_edges, len(corners), np.ascontiguousarray(corners), width, out, least=_OF_THREAD)
    return out


@kernel
def _move_edges(first: int, last: int, corners: np.ndarray, width: float, out: np.ndarray) -> None:
    for i in range(first, last):
        a, b, c = row(corners[i], 0), row(corners[i], 1), row(corners[i], 2)
        one, two, three = subtract(c, b), subtract(a, c), subtract(b, a)  # opposite of each corner
        twice = length(cross(one, two))
        x, y, z = (
            width * length(one) / twice,
            width * length(two) / twice,
            width * length(three) / twice,
        )
        less = min(_MOST_CLEAR / (x + y + z), 1.0)
        x, y, z = x * less, y * less, z * less
        left = 1.0 - (x + y + z)
        middle = add(add(scale(x, a), scale(y, b)), scale(z, c))
        put(out[i], 0, add(middle, scale(left, a)))
        put(out[i], 1, add(middle, scale(left, b)))
        put(out[i], 2, add(middle, scale(left, c)))


def _cluster(pieces: Pieces, axis: np.ndarray, size: float) -> np.ndarray:
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


def make_patches(geometry: Geometry, corners: np.ndarray, scattered: np.ndarray, size: float) -> Patches:
    """Patches of a scene.

    `corners` (F, 3, 3) m relative to the scene's centre; `scattered` (F, 2, b): ρs of each face,
    in front of and behind its stored normal; `size` m of the
    lattice's cells.
    """
    splits, first, split, table = _split_faces(corners, size)
    low, high = boxes(split.corners)
    extent = np.linalg.norm(high - low, axis=1)
    wanted = (scattered[split.face] > 0.0).any(axis=2) & (extent < 2.0 * size)[:, None]
    split, free, table = _quartered(geometry, corners, split, wanted, table)
    inner = _inset(split.corners, OUTLINE * geometry.epsilon)
    pieces = Pieces(split.face, inner, middles(inner), areas(inner))

    direction = cross_products(corners)[pieces.face]
    axis = np.abs(direction).argmax(axis=1)
    cluster = _cluster(pieces, axis, size)
    along = np.sign(direction[np.arange(len(axis)), axis])
    weights: list[np.ndarray] = []
    sides, least = [], _LEAST_AREA * size**2
    for sign in (along, -along):  # all pieces from the side of the positive axis, then the other
        side = np.where(sign > 0.0, 0, 1)
        of_side = scattered[pieces.face, side]
        on_side = free[np.arange(len(side)), side]
        patch = split_by_visibility(geometry, pieces, cluster, on_side, sign, least)
        on = patch >= 0
        bins = int(patch.max(initial=-1)) + 1
        area = np.bincount(patch[on], pieces.area[on], bins)
        strength = np.stack(
            [np.bincount(patch[on], pieces.area[on] * s, bins) for s in of_side[on].T],
            axis=1,
        ).astype(float)  # counts of nothing are integers
        use = (area > least) & (strength.max(axis=1) > 0.0)
        before = sum(map(len, weights))
        renumber = np.append(np.where(use, before + np.cumsum(use) - 1, -1), -1)
        table[split.number, side] = renumber[patch]
        sides.append((renumber[patch], sign, of_side))
        strength = strength[use]
        weights.append(inverse(strength))
    weight = np.concatenate(weights)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    starts = _inset(split.corners, _CLEAR * geometry.epsilon)
    places, middle = _places(pieces, starts, unit, sides, weight)
    order = np.lexsort((*np.floor(middle.T[::-1] / CELL_SIZE),))  # stable
    places, weight, middle = _reordered(places, order), weight[order], middle[order]
    rank = np.append(np.argsort(order), -1).astype(np.int32)
    table = np.where(table >= 0, rank[np.maximum(table, -1)], table)
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = cross_products(corners)
    dual = np.stack([np.cross(e2, normal), np.cross(normal, e1)], axis=1)
    dual /= (normal**2).sum(axis=1)[:, None, None]
    return Patches(dual, splits, first, table, weight, middle, places)


def _reordered(places: Places, order: np.ndarray) -> Places:
    """Places of the patches `order` (C,): neighbours follow each other, so chunks of them hold whole groups."""
    count = np.diff(places.start)
    start = np.concatenate([[0], np.cumsum(count[order])])
    rows = np.arange(start[-1]) + np.repeat(places.start[:-1][order] - start[:-1], count[order])
    return Places(start, *(column[rows] for column in places[1:]))


def _places(
    pieces: Pieces,
    starts: np.ndarray,
    unit: np.ndarray,
    sides: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
    weight: np.ndarray,
) -> tuple[Places, np.ndarray]:
    """Pieces by patch, and their triangles `starts` (n, 3, 3); patch middles. `sides`: of all pieces the patch
    (n,), -1 for none, the sign (n,), 1 on the side of the stored normal, else -1, and what scatters (n, b)."""
    patch, sign, scattered = (np.concatenate(column) for column in zip(*sides, strict=True))
    order = np.argsort(patch, kind="stable")
    order = order[np.searchsorted(patch[order], 0) :]
    patch, piece = patch[order], order % len(pieces.area)
    strength = pieces.area[piece, None] * scattered[order]
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
    normal, upto = sign[order][:, None] * unit[piece], (running - before[patch]) / total[patch]
    face, area = pieces.face[piece], pieces.area[piece]
    return Places(start, face, area, starts[piece], normal, upto, ratio), middle
