"""Triangles that lie in one place: a carpet drawn on a slab, in its plane.

Rays tell triangles apart that are farther from each other than half their offset: of those the one that sound
meets first counts. Of nearer ones that which belongs to the smaller piece counts, on both sides; of pieces of equal
area the one that absorbs more. A piece is what hangs together in one plane and is of one material. The order of
faces decides only among those of one material, which sound alike.
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.io.check_cached import like, within
from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rows import taken, unique_rows
from soundspaces_sim.core.numerics.vec3 import Vec3, cross, dot, length, row, subtract
from soundspaces_sim.scene.materials import MaterialTable
from soundspaces_sim.scene.rays.box_tree import (
    LEAF,
    BoxTree,
    clip,
    in_place_order,
    inwards,
    make_box_tree,
)
from soundspaces_sim.scene.rays.geometry import Covers, Geometry
from soundspaces_sim.scene.triangles import areas, boxes, cross_products, pieces_of, side_numbers, welded

# Of the offset of rays: nearer triangles lie in one place, and more of them than that has to.
_NEAR = 0.5
CLOSE = 1e-3  # m, as far as drawings put a carpet above a slab that they mean to be one place
_PARALLEL = 0.99  # least cosine between normals; heights decide
_MOST_CORNERS = 12  # of a triangle that three planes have cut, with rounding


class Overlaps(NamedTuple):
    """n pairs of triangles, in the order of what is covered, then of what counts first."""

    below: np.ndarray  # (n,) triangle that does not count
    above: np.ndarray  # (n,) triangle that counts in its place
    area: np.ndarray  # (n,) m², that they share
    # (n,) of two materials: a body stands on what looks the other way, which nobody hears
    contact: np.ndarray


def are_pairs(found: Overlaps, faces: int) -> bool:
    """Whether these can be the overlaps of so many triangles."""
    expected = {"below": "i8 n", "above": "i8 n", "area": "f8 n", "contact": "b1 n"}
    return like(found, expected, {}) and all(
        within(triangle, 0, faces - 1) for triangle in (found.below, found.above)
    )


@part(forceinline=True)
def _sides(piece: np.ndarray, normal: Vec3) -> tuple[Vec3, Vec3, Vec3]:
    """Unit, in the plane of a `piece` (3, 3) and off its edges from its first, second and third corner."""
    a, b, c = row(piece, 0), row(piece, 1), row(piece, 2)
    return inwards(a, b, normal), inwards(b, c, normal), inwards(c, a, normal)


@part
def _shared_area(
    piece: np.ndarray,
    sides: tuple[Vec3, Vec3, Vec3],
    normal: Vec3,
    other: np.ndarray,
    near: float,
    inside: float,
    polygon: np.ndarray,
) -> float:
    """m² of a triangle `other` (3, 3) that lie on a `piece` (3, 3) in its plane, within its outline by `inside` m;
    0 if it leaves the plane there by more than `near`. `polygon` (2, _MOST_CORNERS, 4) is overwritten."""
    for m in range(3):
        farthest = -1.0
        for k in range(3):
            polygon[0, k, m] = dot(subtract(row(other, k), row(piece, m)), sides[m]) - inside
            farthest = max(farthest, polygon[0, k, m])
        if farthest < 0.0:
            return 0.0
    for k in range(3):
        polygon[0, k, 3] = dot(subtract(row(other, k), row(piece, 0)), normal)
    count, now = clip(polygon, 3)
    if count == 0:
        return 0.0
    twice = 0.0
    for k in range(count):
        nxt = k + 1 if k + 1 < count else 0
        x, y = polygon[now, k], polygon[now, nxt]
        if not abs(x[3]) <= near:
            return 0.0
        twice += x[0] * y[1] - x[1] * y[0]
    return 0.5 * abs(twice) / max(length(cross(sides[0], sides[1])), 1e-30)  # their axes are oblique


class _Pairs(NamedTuple):
    """n pairs of triangles in one place, each of them once."""

    triangle: np.ndarray  # (n, 2), the lower number first
    area: np.ndarray  # (n,) m², that they share


class _There(NamedTuple):
    """Triangles in the order of a tree's leaves, so that what is near in space is near in memory."""

    corners: np.ndarray  # (n, 3, 3) m
    normal: np.ndarray  # (n, 3)
    low: np.ndarray  # (n, 3) m, boxes
    high: np.ndarray  # (n, 3) m


@part(forceinline=True)
def _meets(
    low: np.ndarray, high: np.ndarray, i: int, lows: np.ndarray, highs: np.ndarray, j: int, near: float
) -> bool:
    """Whether box i of some is up to `near` m from box j of others."""
    return bool(
        low[i, 0] <= highs[j, 0] + near and high[i, 0] >= lows[j, 0] - near
        and low[i, 1] <= highs[j, 1] + near and high[i, 1] >= lows[j, 1] - near
        and low[i, 2] <= highs[j, 2] + near and high[i, 2] >= lows[j, 2] - near
    )  # fmt: skip


@part
def _pairs_of_leaves(
    one: int,
    other: int,
    tree: BoxTree,
    there: _There,
    near: float,
    inside: float,
    found: _Pairs,
    at: int,
    polygon: np.ndarray,
) -> int:
    """The pairs of a leaf's triangles with those of one that does not come before it, into `found` from row `at` on
    where there is room; how many there are."""
    count, leaves = 0, len(tree.triangle)
    for n in range(LEAF):
        own = one * LEAF + n
        if tree.triangle[one, n] < 0 or not _meets(
            tree.low, tree.high, leaves + other, there.low, there.high, own, near
        ):
            continue
        for k in range(n + 1 if one == other else 0, LEAF):
            its = other * LEAF + k
            if tree.triangle[other, k] < 0:
                break
            # Boxes of neighbours meet more often than their normals are parallel.
            if abs(dot(row(there.normal, own), row(there.normal, its))) < _PARALLEL or not _meets(
                there.low, there.high, its, there.low, there.high, own, near
            ):
                continue
            i, t, p, q = tree.triangle[one, n], tree.triangle[other, k], own, its
            if t < i:
                i, t, p, q = t, i, q, p
            normal = row(there.normal, p)
            sides = _sides(there.corners[p], normal)
            shared = _shared_area(
                there.corners[p], sides, normal, there.corners[q], near, inside, polygon
            )
            if shared > 0.0:
                if len(found.area) > 0:
                    found.triangle[at + count, 0], found.triangle[at + count, 1] = i, t
                    found.area[at + count] = shared
                count += 1
    return count


@kernel
def _find_pairs(
    first: int,
    last: int,
    tree: BoxTree,
    there: _There,
    near: float,
    inside: float,
    start: np.ndarray,
    found: _Pairs,
    polygon: np.ndarray,
) -> None:
    """Triangles that lie in one place, by the leaf of the tree in which the first of them is: their number to
    `start[leaf + 1]` where there is no room in `found`, else they from row `start[leaf]` on."""
    leaves = len(tree.triangle)
    for leaf in range(first, last):
        if tree.triangle[leaf, 0] < 0 or (len(found.area) > 0 and start[leaf] == start[leaf + 1]):
            continue
        node, count = leaves + leaf, 0
        while node > 0:
            if _meets(tree.low, tree.high, node, tree.low, tree.high, leaves + leaf, near):
                if node < leaves:
                    node *= 2
                    continue
                at = start[leaf] + count
                count += _pairs_of_leaves(
                    leaf, node - leaves, tree, there, near, inside, found, at, polygon
                )
            while node & 1:
                node >>= 1
            if node > 0:
                node += 1
        if len(found.area) == 0:
            start[leaf + 1] = count


def find_overlaps(
    corners: np.ndarray,
    center: np.ndarray,
    normals: np.ndarray,
    epsilon: float,
    material: np.ndarray,
    table: MaterialTable,
) -> Overlaps:
    """Of triangles (F, 3, 3) m about a `center` (3,), with unit `normals` (F, 3) and rows `material` (F,) of a
    table; `epsilon`, m, as in `Geometry`."""
    near = _NEAR * epsilon
    return _found(corners, center, normals, near, near, material, table)


def find_close(
    corners: np.ndarray,
    center: np.ndarray,
    normals: np.ndarray,
    epsilon: float,
    material: np.ndarray,
    table: MaterialTable,
) -> Overlaps:
    """As `find_overlaps`, of triangles up to `CLOSE` apart that do not lie in one place: rays tell them apart, and
    the one that is met first from a side counts there."""
    near = _found(corners, center, normals, CLOSE, _NEAR * epsilon, material, table)
    one = find_overlaps(corners, center, normals, epsilon, material, table)
    known = set(zip(one.below.tolist(), one.above.tolist(), strict=True))
    pairs = zip(near.below.tolist(), near.above.tolist(), strict=True)
    apart = np.array([pair not in known for pair in pairs], bool)
    return Overlaps(*(column[apart] for column in near))


def _found(
    corners: np.ndarray,
    center: np.ndarray,
    normals: np.ndarray,
    near: float,
    inside: float,
    material: np.ndarray,
    table: MaterialTable,
) -> Overlaps:
    """Pairs up to `near` m apart that share an area, of which `inside` m beyond either outline count to it."""
    pairs, area = _pairs(corners, center, normals, near, inside)
    if len(pairs) == 0:
        return Overlaps(*np.empty((2, 0), np.int64), np.empty(0), np.empty(0, bool))
    mixed = pairs[material[pairs[:, 0]] != material[pairs[:, 1]]]  # others sound alike
    local = corners - center if len(mixed) > 0 else corners
    piece, size = _pieces(local, normals, material, np.unique(mixed))
    rank = _ranks(size, material, table, np.unique(pairs))
    swap = rank[pairs[:, 0]] < rank[pairs[:, 1]]
    below, above = np.where(swap, pairs[:, 1], pairs[:, 0]), np.where(swap, pairs[:, 0], pairs[:, 1])
    order = np.lexsort((rank[above], below))
    below, above, area = below[order], above[order], area[order]
    opposed = (normals[below] * normals[above]).sum(axis=1) < 0.0
    contact = opposed & (size[above] < size[below]) & (material[above] != material[below])
    if contact.any():
        contact &= _bases(local, piece, np.unique(piece[above[contact]]))[above]
    return Overlaps(below, above, area, contact)


def _pairs(
    corners: np.ndarray, center: np.ndarray, normals: np.ndarray, near: float, inside: float
) -> _Pairs:
    order = in_place_order(corners)
    at = taken(corners, order)
    at -= center
    there = _There(at, taken(normals, order), *boxes(at))
    tree = make_box_tree(order, there.low, there.high)
    start = np.zeros(len(tree.triangle) + 1, np.int64)
    for _ in range(2):  # they are counted, then noted
        found = _Pairs(np.empty((start[-1], 2), np.int64), np.empty(start[-1]))
        over_rows(
            _find_pairs, len(tree.triangle), tree, there, near, inside, start, found,
            scratch=lambda: np.empty((2, _MOST_CORNERS, 4)),
        )  # fmt: skip
        if len(found.area) > 0 or not start.any():
            break
        start = np.cumsum(start)
    return found


def _pieces(
    corners: np.ndarray, normals: np.ndarray, material: np.ndarray, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(F,) number of the piece of each triangle, and the logarithm of its area, alike but for rounding; -1 and 0 of
    those that cannot be of a piece with `chosen` triangles (n,)."""
    piece, size = np.full(len(corners), -1), np.zeros(len(corners))
    if len(chosen) == 0:
        return piece, size
    main = np.abs(normals).argmax(axis=1)[:, None]
    upright = normals * np.sign(np.take_along_axis(normals, main, axis=1))
    rounded = np.rint(100.0 * upright).astype(np.int64)
    key = rounded @ (1 << np.array([0, 10, 20])) + (material << 30)
    some = np.flatnonzero(np.isin(key, key[chosen]))
    point = welded(corners[some], 4)[1]
    columns = [point.ravel(), np.repeat(material[some], 3), *np.repeat(rounded[some], 3, axis=0).T]
    of_corner = unique_rows(np.column_stack(columns))[1].reshape(-1, 3)
    piece[some] = pieces_of(of_corner, int(of_corner.max()) + 1)
    size[some] = np.round(np.log(np.bincount(piece[some], areas(corners[some]))[piece[some]]), 6)
    return piece, size


def _ranks(
    size: np.ndarray, material: np.ndarray, table: MaterialTable, chosen: np.ndarray
) -> np.ndarray:
    """(F,) which triangle counts first of those in one place: the one of the lowest rank. `size` (F,) of pieces.
    Only ranks of `chosen` triangles (n,), ascending, are set."""
    values = np.column_stack([table.absorption, table.scattering, table.transmission])
    mean = table.absorption.mean(axis=1)
    of_table = np.empty(len(values), np.int64)
    of_table[np.lexsort((table.names, *values.T[::-1], -mean))] = np.arange(len(values))
    rank = np.empty(len(size), np.int64)
    rank[chosen[np.lexsort((of_table[material[chosen]], size[chosen]))]] = np.arange(len(chosen))
    return rank


def _bases(corners: np.ndarray, piece: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(F,) whether triangles are of one of the `chosen` pieces, and other faces rise from its whole outline: a body
    stands on it."""
    of_chosen = np.isin(piece, chosen)
    low, high = boxes(corners)
    near = (high >= low[of_chosen].min(axis=0) - 1e-3).all(axis=1)
    some = np.flatnonzero(near & (low <= high[of_chosen].max(axis=0) + 1e-3).all(axis=1))
    point = welded(corners[some], 4)[1]
    edge = side_numbers(point).ravel()
    of_edge = np.repeat(piece[some], 3)
    both = unique_rows(np.column_stack([edge, of_edge]))[1]
    alone = np.bincount(both)[both] == 1
    free = alone & (np.bincount(edge)[edge] == 1)
    return of_chosen & ~np.isin(piece, of_edge[free])


def covers_of(
    corners: np.ndarray, center: np.ndarray, normals: np.ndarray, overlaps: Overlaps
) -> Covers:
    """As kernels look them up, relative to a `center` (3,); `corners` (F, 3, 3) m and unit `normals` (F, 3) of the
    triangles."""
    count = np.bincount(overlaps.below, minlength=len(corners))
    above = overlaps.above
    return Covers(
        np.concatenate([[0], np.cumsum(count)]), above, corners[above] - center, normals[above]
    )


@kernel
def _covered(
    first: int,
    last: int,
    geometry: Geometry,
    pieces: np.ndarray,
    normals: np.ndarray,
    triangle: np.ndarray,
    out: np.ndarray,
    polygon: np.ndarray,
) -> None:
    covers, near = geometry.covers, _NEAR * geometry.epsilon
    for i in range(first, last):
        normal = row(normals, i)
        sides = _sides(pieces[i], normal)
        for k in range(covers.start[triangle[i]], covers.start[triangle[i] + 1]):
            if _shared_area(pieces[i], sides, normal, covers.corners[k], near, near, polygon) > 0.0:
                out[i] = True
                break


def covered(geometry: Geometry, pieces: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """(n,) whether other triangles count somewhere on `pieces` (n, 3, 3) m of triangles (n,)."""
    out = np.zeros(len(pieces), np.bool_)
    normals = cross_products(pieces)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    over_rows(
        _covered, len(pieces), geometry, pieces, normals, triangle, out,
        scratch=lambda: np.empty((2, _MOST_CORNERS, 4)),
    )  # fmt: skip
    return out


def overlap_notes(overlaps: Overlaps, material: np.ndarray, table: MaterialTable) -> tuple[str, ...]:
    """A sentence on faces of two materials in one place, bodies that stand there aside; or none."""
    pairs = _listed(overlaps, material, table, "on")
    return (f"faces of two materials lie in one plane, and the first counts: {pairs}",) if pairs else ()


def close_notes(close: Overlaps, material: np.ndarray, table: MaterialTable) -> tuple[str, ...]:
    """The same on those of `find_close`."""
    pairs = _listed(close, material, table, "beside")
    if not pairs:
        return ()
    how = f"up to {1e3 * CLOSE:g} mm apart, and the one that sound meets first counts"
    return (f"faces of two materials lie {how}: {pairs}",)


def _listed(overlaps: Overlaps, material: np.ndarray, table: MaterialTable, how: str) -> str:
    """Pairs of materials by area; empty for none."""
    kinds = np.column_stack([material[overlaps.above], material[overlaps.below]])
    told = (kinds[:, 0] != kinds[:, 1]) & ~overlaps.contact
    kinds, area = kinds[told], overlaps.area[told]
    if len(kinds) == 0:
        return ""
    first, of_pair = unique_rows(kinds)
    total = np.bincount(of_pair, area)
    return ", ".join(
        f"{total[k]:.3g} m² of '{table.names[kinds[first[k], 0]]}' {how} '{table.names[kinds[first[k], 1]]}'"
        for k in np.argsort(-total, kind="stable")
    )
