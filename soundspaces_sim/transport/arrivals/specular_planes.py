"""Specular planes: triangles grouped by plane equation, once per scene.

The seed paper clusters early reflections "based on the plane equation of the geometry". A triangle belongs to a
plane if its normal lies within 10 degrees of the plane's and its vertices within 5 cm, so that a noisy scanned
wall is one plane; of a rough one, those too that noise turns by more. The two faces of a slab, such as a door or a
table top, are two. Curved surfaces (normals that vary with position), planes of little area and strips are left
out; their specular paths are found by subpaths. A strip of 0.14 m, as the side of a door's opening, reflects 20 dB
less than a mirror at 125 Hz, 11 at 1 kHz and 5 at 4 kHz, if it is 1.5 m from both ends (Fresnel's integral).

Where a plane has triangles is drawn into cells (`Cover`), which say cheaply that there is nothing to reflect.

Host code (numpy): it runs once per scene.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rows import in_order
from soundspaces_sim.core.numerics.vec3 import Vec3, add, divide, dot, length, put, row, scale, subtract
from soundspaces_sim.scene.rays.box_tree import in_place_order
from soundspaces_sim.scene.triangles import (
    areas,
    corners_of,
    cross_products,
    longest_edges,
    middles,
)

_MAX_ANGLE_COS = float(np.cos(np.deg2rad(10.0)))
_MAX_CURVATURE = 0.05  # rad, rms variation of the normal that position explains
_MAX_TURN_COS = float(np.cos(np.deg2rad(45.0)))  # of triangles that noise turns
_NOISE = 3.0  # times a rough plane's rms stray: what is nearer is part of it
_LOOSE = 2.0  # times a grain's offset: a part may be so far from the plane by which it is found
_APART = 0.1  # m, between parts that are not connected
_SETTLES = 3  # times that a part's plane is fitted anew
_FLAT = 0.0005  # m
_GROW, _GROWN = 8, 1.01  # times at most, while a plane grows by more than this
_FLAT_COS = float(np.cos(np.deg2rad(0.3)))  # of triangles side by side: of scans most turn by more
_ROUNDS = 3  # of smoothing
_SIMILAR = 0.35  # rad: a neighbour that turns by more counts less than half
OF_THREAD = 4096  # faces for which it is worth to start a thread
_BLOCK = 32  # faces that are tried together, and blocks of these
_ROUNDING = 1e-6  # m, more than it is
_MOST_NUMBER = 2**63 - 1  # of a cell
_SLAB = 0.5  # of a group's rms stray: two sides that stray less are those of a slab


class Grain(NamedTuple):
    """How fine planes are told apart."""

    area: float  # m², of the smallest
    seed: float  # m², of what it grows from
    offset: float  # m, of a triangle's corners from its plane
    patch: float  # m, of small triangles from which a plane grows: their mean normal is good where noise turns each
    width: float  # m, of a disc that has to fit in; 0 for any shape


#: Walls mirror sound; at the edges of faces it bends.
WALLS = Grain(area=0.3, seed=0.03, offset=0.05, patch=0.5, width=0.4)
FACES = Grain(area=0.03, seed=0.0075, offset=0.015, patch=0.3, width=0.0)


class SpecularPlanes(NamedTuple):
    """P planes, n · x = offset, by area, and the plane of each face; relative to the scene's centre."""

    normal: np.ndarray  # (P, 3) unit
    offset: np.ndarray  # (P,) m
    margin: np.ndarray  # (P,) m, how far its triangles stray from it
    of_face: np.ndarray  # (F,) row, or -1


@threadpool_limits.wrap(limits=1, user_api="blas")  # products are small: threads only wait
def group_planes(
    vertices: np.ndarray, faces: np.ndarray, grain: Grain = WALLS, beside: np.ndarray | None = None
) -> SpecularPlanes:
    """Group the triangles of a mesh ((V, 3) m, (F, 3)) into planes. `beside`: (F, 3) `beyond_sides` of the
    triangles, if planes are to be told apart that are small, or near each other: then noisy normals are smoothed
    first, and what is not connected has planes of its own."""
    corners = corners_of(vertices, faces)
    apart = beside is not None
    normal = cross_products(corners)
    if beside is not None:
        normal = _smoothed(normal, beside)
    area = 0.5 * _made_unit(normal)
    turned = np.empty(len(faces), bool)
    over_rows(_make_one_sided, len(faces), normal, turned, least=OF_THREAD)
    centroid = middles(corners)

    of_face = np.full(len(faces), -1, np.int64)
    free = np.ones(len(faces), bool)
    blocks = _in_blocks(corners)
    room = np.empty(len(faces), np.int64)
    found: list[tuple[np.ndarray, float, float]] = []
    for seed in _seeds(corners, normal, centroid, area, grain):
        seed = seed[free[seed]]
        if area[seed].sum() < grain.seed:
            continue
        n, d = _fit(normal, centroid, area, seed)
        members = seed
        for k in range(_GROW):  # gather, refit, gather again
            before = len(members)
            members = _near(normal, corners, free, blocks, n, d, _MAX_ANGLE_COS, grain.offset, room)
            if len(members) == 0 or (k > 0 and len(members) <= _GROWN * before):
                break
            n, d = _fit(normal, centroid, area, members)
        if len(members) == 0 or area[members].sum() < grain.area:
            free[seed] = False
            continue
        parts = [members]
        if apart:
            loose = _LOOSE * grain.offset
            near = _near(normal, corners, free, blocks, n, d, _MAX_ANGLE_COS, loose, room)
            parts = _parts(corners, near, n, d, grain)
        for part_of in parts:
            free[part_of] = False
            for own in _sides(normal, centroid, corners, area, part_of, turned[part_of]):
                if area[own].sum() < grain.area:
                    continue
                n, d = _flattest(corners[own], n) if apart else _fit(normal, centroid, area, own)
                if _curvature(normal, centroid, area, own, n) > _MAX_CURVATURE:
                    continue
                if grain.width > 0.0 and not _holds_disc(
                    flattened(corners[own], in_plane(n)), grain.width
                ):
                    continue
                if is_rough(heights(corners[own], n)):
                    noise = min(_NOISE * _rms(corners, own, n, d), grain.offset)
                    more = _near(normal, corners, free, blocks, n, d, _MAX_TURN_COS, noise, room)
                    if apart:
                        more = more[_beside_box(centroid[more], corners[own], _APART)]
                    free[more] = False
                    own = np.concatenate([own, more])
                of_face[own] = len(found)
                found.append((n, d, _margin(corners, own, n, d)))
    normals = np.array([n for n, _, _ in found]).reshape(-1, 3)
    offsets = np.array([d for _, d, _ in found], float)
    total = np.bincount(of_face[of_face >= 0], area[of_face >= 0], len(found))
    order = np.lexsort(np.round([offsets, *normals.T, -total], 6))  # whatever they grew from
    rank = np.append(np.argsort(order), -1)
    return SpecularPlanes(
        normals[order], offsets[order], np.array([m for _, _, m in found], float)[order], rank[of_face]
    )


def _smoothed(cross: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """Cross products (F, 3) of a scan's triangles, turned to the mean of those beside them, where what turns more
    counts less: noise goes, creases stay. Unchanged where most of the area is flat.

    Source: Y. Zheng et al. (2011), Bilateral normal filtering for mesh denoising, IEEE TVCG 17 (10).
    """
    normal = cross.copy()
    size = _made_unit(normal)
    noisy = np.empty(len(cross), bool)
    over_rows(_find_noisy, len(cross), beside, normal, noisy, least=OF_THREAD)
    if size[noisy].sum() < 0.5 * size.sum():
        return cross
    turned = cross
    for _ in range(_ROUNDS):
        over_rows(_turn, len(normal), beside, size, normal, turned, least=OF_THREAD)
        normal, turned = turned, normal
    normal *= size[:, None]
    return normal


def _made_unit(vectors: np.ndarray) -> np.ndarray:
    """Scale vectors (n, 3) to a length of one, in place; their lengths before."""
    size = np.empty(len(vectors))
    over_rows(_make_unit, len(vectors), vectors, size, least=OF_THREAD)
    return size


@kernel
def _make_unit(first: int, last: int, vectors: np.ndarray, size: np.ndarray) -> None:
    for i in range(first, last):
        size[i] = length(row(vectors, i))
        put(vectors, i, divide(row(vectors, i), max(size[i], 1e-300)))


@kernel
def _make_one_sided(first: int, last: int, normal: np.ndarray, turned: np.ndarray) -> None:
    """One sign per plane: the largest component is positive, and it is known of which normals (F, 3) it was not."""
    for f in range(first, last):
        largest = 0.0
        for k in range(3):
            if abs(normal[f, k]) > abs(largest):
                largest = normal[f, k]
        turned[f] = largest < 0.0
        if turned[f]:
            put(normal, f, scale(-1.0, row(normal, f)))


@kernel
def _find_noisy(
    first: int, last: int, beside: np.ndarray, normal: np.ndarray, noisy: np.ndarray
) -> None:
    """Flag triangles (F,) that turn from one beside them, but not as at an edge."""
    for f in range(first, last):
        noisy[f] = False
        for k in range(3):
            if beside[f, k] >= 0:
                cos = abs(dot(row(normal, f), row(normal, beside[f, k])))
                noisy[f] |= _MAX_TURN_COS < cos < _FLAT_COS


@kernel
def _turn(
    first: int, last: int, beside: np.ndarray, size: np.ndarray, normal: np.ndarray, out: np.ndarray
) -> None:
    """Fill `out` with normals (F, 3) turned to the mean, by `size` (F,), of each and those `beside` it."""
    for f in range(first, last):
        own = row(normal, f)
        total = scale(size[f], own)
        for k in range(3):
            g = beside[f, k]
            if g >= 0:
                cos = dot(own, row(normal, g))
                weight = math.copysign(math.exp((abs(cos) - 1.0) / _SIMILAR**2), cos)
                total = add(total, scale(weight * size[g], row(normal, g)))
        put(out, f, divide(total, max(length(total), 1e-300)))


def _parts(
    corners: np.ndarray, faces: np.ndarray, n: np.ndarray, d: float, grain: Grain
) -> list[np.ndarray]:
    """The connected parts of faces near a plane, as far as each has a plane of its own: what is far apart is seldom
    in one to a centimetre."""
    out = []
    for rows in _connected(corners[faces], n):
        own, towards, offset = faces[rows], n, d
        triangles = kept = corners[own]
        for k in range(_SETTLES):
            if k > 0:
                towards, offset = _flattest(kept, towards)
            height = heights(triangles, towards)
            a, b, c = height.T
            middle = (a + b + c) / 3.0
            near = np.abs(middle - offset) < grain.offset
            offset = float(np.median(middle[near])) if near.any() else math.inf
            a, b, c = (np.abs(height - offset) < grain.offset).T
            is_kept = a & b & c
            kept = triangles[is_kept]
            if areas(kept).sum() < grain.area:
                break
        else:
            out.append(own[is_kept])
    return out


def _connected(corners: np.ndarray, normal: np.ndarray) -> list[np.ndarray]:
    """Rows of triangles (n, 3, 3) of a plane that are less than `_APART` m from each other, in it."""
    from scipy import ndimage  # readers of datasets do without it

    flat = flattened(corners, in_plane(normal))
    first, covered = drawn(flat, _APART, 2.0 * _APART)
    middle = (flat[:, 0] + flat[:, 1] + flat[:, 2]) / 3.0
    i, j = ((middle - first) / _APART).astype(np.int64).T
    part_of = ndimage.label(covered, np.ones((3, 3)))[0][i, j]
    order = np.argsort(part_of, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(part_of[order])) + 1)


def _beside_box(points: np.ndarray, corners: np.ndarray, beyond: float) -> np.ndarray:
    """(n,) whether points (n, 3) are in the box about triangles, or so little beside it, m."""
    low, high = span(corners)
    inside = np.ones(len(points), bool)
    for x, least, most in zip(points.T, low - beyond, high + beyond, strict=True):
        inside &= (x > least) & (x < most)
    return inside


def span(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k,) least and greatest of points (..., k) along each axis, in a seventh of the time of `min` and
    `max`."""
    columns = points.reshape(-1, points.shape[-1]).T
    return np.array([x.min() for x in columns]), np.array([x.max() for x in columns])


def _flattest(corners: np.ndarray, towards: np.ndarray) -> tuple[np.ndarray, float]:
    """The plane from which the corners of triangles (n, 3, 3) stray least, by area; its normal towards this one."""
    weight = areas(corners)
    weight /= weight.sum()
    middle = weight @ middles(corners)
    off = (corners - middle).reshape(-1, 9)
    off *= np.sqrt(weight)[:, None]
    off = off.reshape(-1, 3)
    n = np.linalg.eigh(off.T @ off)[1][:, 0]
    n *= math.copysign(1.0, n @ towards)
    return n, float(n @ middle)


class _Boxes(NamedTuple):
    middle: np.ndarray  # (n, 3) m
    half: np.ndarray  # (n, 3) m, of its sides, and what rounding may take off


class _Blocks(NamedTuple):
    """Faces by their place, `_BLOCK` at a time, and as many blocks at a time: most planes are far from most."""

    face: np.ndarray  # (F,)
    free: np.ndarray  # (n,) whether some of a block's faces may be free
    small: _Boxes  # (n,) about the faces of each block
    large: _Boxes  # about those of `_BLOCK` blocks


def _in_blocks(corners: np.ndarray) -> _Blocks:
    face = in_place_order(corners)
    first = np.arange(0, -(-len(face) // _BLOCK))
    middle, half = np.empty((2, len(first), 3))
    over_rows(_bound, len(first), corners, face, middle, half, least=OF_THREAD // _BLOCK)
    low = np.minimum.reduceat(middle - half, first[::_BLOCK])
    high = np.maximum.reduceat(middle + half, first[::_BLOCK])
    large = _Boxes(0.5 * (low + high), 0.5 * (high - low) + _ROUNDING)
    return _Blocks(face, np.ones(len(first), bool), _Boxes(middle, half), large)


@kernel
def _bound(
    first: int, last: int, corners: np.ndarray, face: np.ndarray, middle: np.ndarray, half: np.ndarray
) -> None:
    for b in range(first, last):
        for axis in range(3):
            low, high = math.inf, -math.inf
            for f in face[b * _BLOCK : (b + 1) * _BLOCK]:
                for k in range(3):
                    low, high = min(low, corners[f, k, axis]), max(high, corners[f, k, axis])
            middle[b, axis], half[b, axis] = 0.5 * (low + high), 0.5 * (high - low) + _ROUNDING


@part
def _is_near(boxes: _Boxes, b: int, n: Vec3, d: float, offset: float) -> bool:
    """Whether some of a box may be less than `offset` m from a plane."""
    half = row(boxes.half, b)
    reach = half[0] * abs(n[0]) + half[1] * abs(n[1]) + half[2] * abs(n[2])
    return abs(dot(row(boxes.middle, b), n) - d) <= reach + offset


def _near(
    normal: np.ndarray,
    corners: np.ndarray,
    free: np.ndarray,
    blocks: _Blocks,
    n: np.ndarray,
    d: float,
    cos: float,
    offset: float,
    room: np.ndarray,
) -> np.ndarray:
    """Those of the `free` (F,) faces, ascending, that turn from a plane by less than this cosine's angle, and whose
    corners stray less than `offset` m from it; found in `room`."""
    return np.sort(room[: _gather(normal, corners, free, blocks, n, d, cos, offset, room)])


@kernel
def _gather(
    normal: np.ndarray,
    corners: np.ndarray,
    free: np.ndarray,
    blocks: _Blocks,
    n: np.ndarray,
    d: float,
    cos: float,
    offset: float,
    out: np.ndarray,
) -> int:
    count = 0
    towards = (n[0], n[1], n[2])
    for m in range(len(blocks.large.half)):
        if not _is_near(blocks.large, m, towards, d, offset):
            continue
        for b in range(m * _BLOCK, min((m + 1) * _BLOCK, len(blocks.free))):
            if not blocks.free[b] or not _is_near(blocks.small, b, towards, d, offset):
                continue
            some = False
            for f in blocks.face[b * _BLOCK : (b + 1) * _BLOCK]:
                some |= free[f]
                inside = free[f] and abs(dot(row(normal, f), towards)) > cos
                for k in range(3):
                    inside = inside and abs(dot(row(corners[f], k), towards) - d) < offset
                if inside:
                    out[count] = f
                    count += 1
            blocks.free[b] = some
    return count


def _rms(corners: np.ndarray, members: np.ndarray, n: np.ndarray, d: float) -> float:
    """How far the corners of some faces stray from a plane, rms, m."""
    stray = heights(corners[members], n) - d
    return float(np.sqrt((stray * stray).mean()))


def _margin(corners: np.ndarray, members: np.ndarray, n: np.ndarray, d: float) -> float:
    """How far some faces stray from a plane, m."""
    return float(np.abs(heights(corners[members], n) - d).max())


def _sides(
    normal: np.ndarray,
    centroid: np.ndarray,
    corners: np.ndarray,
    area: np.ndarray,
    members: np.ndarray,
    turned: np.ndarray,
) -> list[np.ndarray]:
    """Both faces of a slab, that of more area first; or all of a group, as of a noisy wall, whose windings differ.

    Faces that are wound the one way and those wound the other are two planes if either strays less than half as far
    from its own plane as from the common one.
    """
    parts = [members[~turned], members[turned]]
    if min(len(part) for part in parts) == 0:
        return [members]
    whole = _rms(corners, members, *_fit(normal, centroid, area, members))
    if max(_rms(corners, part, *_fit(normal, centroid, area, part)) for part in parts) >= _SLAB * whole:
        return [members]
    return sorted(parts, key=lambda part: -area[part].sum())


def heights(corners: np.ndarray, n: np.ndarray) -> np.ndarray:
    """(F, 3) `corners @ n` of triangles (F, 3, 3), in a third of its time."""
    return np.asarray((corners.reshape(-1, 3) @ n).reshape(-1, 3))


def flattened(corners: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """(F, 3, 2) `corners @ basis.T` of triangles (F, 3, 3), in a third of its time."""
    return np.asarray((corners.reshape(-1, 3) @ basis.T).reshape(-1, 3, 2))


def is_rough(height: np.ndarray) -> bool:
    """Whether most of the triangles of a plane, whose corners are so high (n, 3), are not flat in it: as noise has
    it, but not what is drawn."""
    a, b, c = height.T
    spread = np.maximum(np.maximum(a, b), c) - np.minimum(np.minimum(a, b), c)
    return bool(np.median(spread) > _FLAT)


def _seeds(
    corners: np.ndarray, normal: np.ndarray, centroid: np.ndarray, area: np.ndarray, grain: Grain
) -> list[np.ndarray]:
    """Faces that share a cell of (normal, offset) space, or, small ones, one of (normal, place): cells of most area
    first."""
    cell = np.empty(len(corners), np.int64)
    small = longest_edges(corners) < grain.patch**2
    low, high = np.zeros((2, 8), np.int64)
    _find_cells(normal, centroid, small, grain.patch, grain.offset, low, high, cell)
    cell, order = in_order(cell)
    first = np.flatnonzero(np.diff(cell, prepend=-1))
    last = np.append(first[1:], len(cell))
    total = np.bincount(np.repeat(np.arange(len(first)), last - first), weights=area[order])
    ranked = np.argsort(-total, kind="stable")
    return [order[first[i] : last[i]] for i in ranked[total[ranked] > grain.seed]]


@kernel
def _find_cells(
    normal: np.ndarray,
    centroid: np.ndarray,
    small: np.ndarray,
    patch: float,
    offset: float,
    low: np.ndarray,
    high: np.ndarray,
    cell: np.ndarray,
) -> None:
    """The number (F,) of each face's cell, see `_seeds`, from zero up, in the order of its coordinates: these go
    from `low` (8,) to `high`, that are zero before."""
    for turn in range(2):
        for f in range(len(cell)):
            n, x = row(normal, f), row(centroid, f)
            towards, place = n, (0.0, 0.0, 0.0)
            if small[f]:
                towards = (np.rint(2.0 * n[0]), np.rint(2.0 * n[1]), np.rint(2.0 * n[2]))
                place = (np.rint(x[0] / patch), np.rint(x[1] / patch), np.rint(x[2] / patch))
                n = towards
            else:
                n = (np.rint(8.0 * n[0]), np.rint(8.0 * n[1]), np.rint(8.0 * n[2]))
            off = dot(subtract(x, scale(patch, place)), towards) / max(length(towards), 1e-300)
            at = (1.0 if small[f] else 0.0, *n, *place, np.rint(off / offset))
            number = 0
            for axis in range(8):
                value = int(at[axis])
                if turn == 0:
                    low[axis], high[axis] = min(low[axis], value), max(high[axis], value)
                else:
                    number = number * (high[axis] - low[axis] + 1) + (value - low[axis])
            cell[f] = number & _MOST_NUMBER


def _fit(
    normal: np.ndarray, centroid: np.ndarray, area: np.ndarray, members: np.ndarray
) -> tuple[np.ndarray, float]:
    """Area-weighted plane of some faces."""
    weight = area[members]
    reference = normal[members[weight.argmax()]]
    own = normal[members]
    sign = np.where(own @ reference < 0.0, -1.0, 1.0)
    n = (own * (weight * sign)[:, None]).sum(axis=0)
    n /= np.linalg.norm(n)
    return n, float((centroid[members] @ n * weight).sum() / weight.sum())


def _curvature(
    normal: np.ndarray, centroid: np.ndarray, area: np.ndarray, members: np.ndarray, n: np.ndarray
) -> float:
    """Rms variation (rad) of the normals that a linear function of position explains.

    It is near zero for a flat wall with noisy normals and large for a cylinder or a sphere.
    """
    weight = area[members] / area[members].sum()
    basis = in_plane(n).T
    x = centroid[members] @ basis
    x = x - weight @ x
    own = normal[members]
    oriented = own * np.where(own @ n < 0.0, -1.0, 1.0)[:, None] @ basis
    oriented = oriented - weight @ oriented
    root = np.sqrt(weight)[:, None]
    slope = np.linalg.lstsq(root * x, root * oriented, rcond=None)[0]
    return float(np.linalg.norm(root * (x @ slope)))


def _holds_disc(flat: np.ndarray, width: float) -> bool:
    """Whether a disc about so many m across fits into triangles (n, 3, 2), m, but for holes of less than a cell."""
    from scipy import ndimage  # readers of datasets do without it

    size = _cell_size(*span(flat))
    _, covered = drawn(flat, size, 2.0 * size)
    depth = ndimage.distance_transform_edt(covered).max(initial=0.0)
    return bool((depth - 1.0) * size >= 0.5 * width - _ROUNDING)


def in_plane(normal: np.ndarray) -> np.ndarray:
    """(2, 3) unit vectors in a plane of this normal, and at right angles."""
    s = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    s /= np.linalg.norm(s)
    return np.stack([s, np.cross(normal, s)])


def faces_of_planes(of_face: np.ndarray, planes: int) -> tuple[np.ndarray, np.ndarray]:
    """(Faces by their plane, (planes + 1,) first of each plane's)."""
    own = np.flatnonzero(of_face >= 0)
    own = own[np.argsort(of_face[own], kind="stable")]
    return own, np.searchsorted(of_face[own], np.arange(planes + 1))


def plane_boxes(of_face: np.ndarray, corners: np.ndarray, planes: SpecularPlanes) -> np.ndarray:
    """(P, 2, 3) least and greatest coordinates of each plane's triangles, with a margin, m; `of_face` (F,): plane
    of each face, -1 for none; `corners` (F, 3, 3) m."""
    face = np.flatnonzero(of_face >= 0)
    face = face[np.argsort(of_face[face], kind="stable")]
    boxes = np.empty((len(planes.offset), 2, 3))
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf  # no face has it: nothing is in it
    plane, first = np.unique(of_face[face], return_index=True)
    boxes[plane, 0] = np.minimum.reduceat(corners[face].min(axis=1), first)
    boxes[plane, 1] = np.maximum.reduceat(corners[face].max(axis=1), first)
    margin = (planes.margin + 0.01)[:, None]
    boxes[:, 0] -= margin
    boxes[:, 1] += margin
    return boxes


_CELL = 0.1  # m, or larger
_MOST = 100_000  # cells of a plane, but for its border
_BESIDE = 0.75  # cells from a triangle, up to which a cell's middle is part of it: half a diagonal
_NEAR = 1.0  # m from triangles, up to which a place is near them
THERE, NEAR = 2, 1  # triangles are at a place; near it


class Cover(NamedTuple):
    """The cells of P planes: those of a plane are start[a] on, the second index running."""

    basis: np.ndarray  # (P, 2, 3) unit
    corner: np.ndarray  # (P, 2) m, of the first cell
    size: np.ndarray  # (P,) m, of a cell
    shape: np.ndarray  # (P, 2)
    start: np.ndarray  # (P,)
    cell: np.ndarray  # (n,) THERE, NEAR, or 0


@kernel
def draw(triangles: np.ndarray, beyond: float, covered: np.ndarray) -> None:
    """Set the cells whose middles are in triangles (n, 3, 2), in cells, or less than `beyond` cells beside one."""
    nx, ny = covered.shape
    for n in range(len(triangles)):
        ax, ay = triangles[n, 0]
        bx, by = triangles[n, 1]
        cx, cy = triangles[n, 2]
        turn = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if turn < 0.0:
            bx, by, cx, cy = cx, cy, bx, by
        la = beyond * max(((bx - ax) ** 2 + (by - ay) ** 2) ** 0.5, 1e-9)
        lb = beyond * max(((cx - bx) ** 2 + (cy - by) ** 2) ** 0.5, 1e-9)
        lc = beyond * max(((ax - cx) ** 2 + (ay - cy) ** 2) ** 0.5, 1e-9)
        low_x, high_x = min(ax, bx, cx) - beyond - 0.5, max(ax, bx, cx) + beyond + 0.5
        low_y, high_y = min(ay, by, cy) - beyond - 0.5, max(ay, by, cy) + beyond + 0.5
        for i in range(max(int(low_x), 0), min(int(high_x) + 1, nx)):
            x = i + 0.5
            for j in range(max(int(low_y), 0), min(int(high_y) + 1, ny)):
                y = j + 0.5
                if (
                    (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= -la
                    and (cx - bx) * (y - by) - (cy - by) * (x - bx) >= -lb
                    and (ax - cx) * (y - cy) - (ay - cy) * (x - cx) >= -lc
                ):
                    covered[i, j] = True


def drawn(flat: np.ndarray, size: float, border: float) -> tuple[np.ndarray, np.ndarray]:
    """(Corner of the first cell; the cells of so many m that triangles (n, 3, 2) cover, with a border, m)."""
    low, high = span(flat)
    first = low - border
    shape = np.ceil((high + border - first) / size).astype(int)
    covered = np.zeros(shape, np.bool_)
    draw((flat - first) / size, 0.5, covered)
    return first, covered


def _widened(covered: np.ndarray, cells: int) -> np.ndarray:
    """With all cells that are so near to one along either axis."""
    for _ in range(2):
        total = np.cumsum(np.pad(covered, ((cells + 1, cells), (0, 0))), axis=0)
        covered = (total[2 * cells + 1 :] > total[: -2 * cells - 1]).T
    return np.asarray(covered)


def _cell_size(least: np.ndarray, most: np.ndarray) -> float:
    """m, where triangles reach from `least` to `most` (2,)."""
    across = most - least
    return max(_CELL, float(np.sqrt(np.prod(across) / _MOST)), float(across.max()) / _MOST)


def make_cover(
    of_face: np.ndarray, corners: np.ndarray, planes: SpecularPlanes
) -> tuple[Cover, np.ndarray]:
    """The cells of the triangles (F, 3, 3) m of planes, and (P,) m² of those cells that hang together, of a plane's
    parts the largest (cells reach .1 m beyond triangles); `of_face` (F,): plane of each triangle, -1 for none."""
    from scipy import ndimage  # readers of datasets do without it

    order, start = faces_of_planes(of_face, len(planes.offset))
    bases, firsts, sizes, cells, area = [], [], [], [np.empty((0, 0), np.uint8)], []
    for a, (low, high) in enumerate(pairwise(start)):
        basis = in_plane(planes.normal[a])
        flat = corners[order[low:high]] @ basis.T
        least, most = np.zeros(2), np.zeros(2)
        if len(flat):
            least, most = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
        size = _cell_size(least, most)
        near, there = int(np.ceil(_NEAR / size)), 1 + int(planes.margin[a] / size)
        border = near + there + 1
        first = least - border * size
        covered = np.zeros(np.ceil((most - least) / size).astype(int) + 2 * border, np.bool_)
        draw((flat - first) / size, _BESIDE, covered)
        bases.append(basis)
        firsts.append(first)
        sizes.append(size)
        parts = np.bincount(ndimage.label(covered)[0][covered])
        area.append(size**2 * parts.max(initial=0))
        cells.append(_widened(covered, there).astype(np.uint8) + _widened(covered, near))
    shapes = np.array([c.shape for c in cells[1:]], np.int64).reshape(-1, 2)
    cover = Cover(
        np.array(bases).reshape(-1, 2, 3),
        np.array(firsts).reshape(-1, 2),
        np.array(sizes, float),
        shapes,
        np.append(0, np.cumsum(shapes.prod(axis=1)))[:-1],
        np.concatenate([c.ravel() for c in cells]),
    )
    return cover, np.array(area, float)


@part(forceinline=True)
def cover_at(cover: Cover, a: int, x: Vec3) -> int:
    """What `Cover.cell` has at a place in plane `a`."""
    i = int((dot(row(cover.basis[a], 0), x) - cover.corner[a, 0]) / cover.size[a])
    j = int((dot(row(cover.basis[a], 1), x) - cover.corner[a, 1]) / cover.size[a])
    nx, ny = cover.shape[a]
    return cover.cell[cover.start[a] + i * ny + j] if 0 <= i < nx and 0 <= j < ny else 0
