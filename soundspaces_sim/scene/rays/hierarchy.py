"""Ray casting without a library: a hierarchy of boxes in arrays, which kernels follow without a stack.

Boxes are split by the surface area heuristic over 16 bins (I. Wald, "On fast construction of SAH-based bounding
volume hierarchies", IEEE Symposium on Interactive Ray Tracing 2007). A ray goes from box to box by links to parents
and siblings (M. Hapala and others, "Efficient stack-less BVH traversal for ray tracing", SCCG 2011), so that
nothing is allocated and the same functions compile for other targets. Triangles are tested watertight: a ray that
meets an edge or a corner meets one of the triangles that share it (S. Woop, C. Benthin and I. Wald, "Watertight
ray/triangle intersection", Journal of Computer Graphics Techniques 2(1), 2013). That needs products which are not
fused with sums. Numbers are in double precision; boxes in single, rounded outwards.

Conventions: as `embree`. A miss is `(inf, -1)`; of triangles at the same distance it is the first in the mesh.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3

_LEAF = 4  # triangles at most, unless their middles lie in one place
_BINS = 16
_DEEP = 512  # boxes that wait while the hierarchy is built: twice its depth at most
_WIDER = 1e-6  # of a box's coordinates: more than rounding takes off a ray that touches it
_TINY = 1e-300  # component of a direction in place of 0
_DOWN, _ACROSS, _UP = 0, 1, 2  # how a box was reached: from its parent, its sibling, or its children


class Hierarchy(NamedTuple):
    """N boxes about F triangles; box 0 is the whole."""

    box: np.ndarray  # (N, 6) float32 m: least x, y, z, and greatest
    # (N, 4) int32: parent, first child or triangle, triangles (0: it has children), axis of its split
    link: np.ndarray
    corners: np.ndarray  # (F, 9) m, in the order of leaves
    face: np.ndarray  # (F,) int32 row of the mesh


class _Work(NamedTuple):
    """What `_build` works in."""

    wait: np.ndarray  # (_DEEP, 3) box, first and last triangle
    low: np.ndarray  # (_BINS, 3)
    high: np.ndarray  # (_BINS, 3)
    count: np.ndarray  # (_BINS,)
    right: np.ndarray  # (_BINS,) areas times triangles from each bin on
    span: np.ndarray  # (4, 3) bounds: of middles, and of a sweep


class RayScene:
    """The hierarchy of one triangle mesh, `handle`, which kernels pass to `intersect` and `occluded`.

    `vertices` (V, 3) m, `faces` (F, 3) rows of them. Raises `SceneError` for what is no mesh.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        corners = np.asarray(vertices, float)[np.asarray(faces)]
        if len(corners) == 0 or not np.isfinite(corners).all():
            raise SceneError(f"rays need triangles with finite corners, got {len(corners)} triangles")
        low, high = corners.min(axis=1), corners.max(axis=1)
        middle, order = 0.5 * (low + high), np.arange(len(corners))
        box = np.zeros((2 * len(corners), 6))
        link = np.zeros((2 * len(corners), 4), np.int32)
        work = _Work(
            np.empty((_DEEP, 3), np.int64),
            np.empty((_BINS, 3)),
            np.empty((_BINS, 3)),
            np.empty(_BINS, np.int64),
            np.empty(_BINS),
            np.empty((4, 3)),
        )
        count = _build(low, high, middle, order, box, link, work)
        if count < 0:
            raise SceneError(
                f"rays: a hierarchy of {len(corners)} triangles is deeper than {_DEEP // 2}"
            )
        wider = _WIDER * np.abs(box[:count]).max()
        box[:count, :3] -= wider
        box[:count, 3:] += wider
        outwards = [np.nextafter(np.float32(box[:count, :3]), np.float32(-np.inf)),
                    np.nextafter(np.float32(box[:count, 3:]), np.float32(np.inf))]  # fmt: skip
        self.handle = Hierarchy(
            np.ascontiguousarray(np.concatenate(outwards, axis=1)),
            link[:count].copy(),
            np.ascontiguousarray(corners[order].reshape(-1, 9)),
            order.astype(np.int32),
        )

    def tied(self, array: np.ndarray) -> np.ndarray:
        """The same array: records hold the hierarchy's arrays themselves."""
        return array

    def __deepcopy__(self, _: object) -> RayScene:
        """The same: nobody writes to it."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError("a RayScene is made in a moment; pickle the Scene, which makes its own")


@kernel
def _build(
    low: np.ndarray,
    high: np.ndarray,
    middle: np.ndarray,
    order: np.ndarray,
    box: np.ndarray,
    link: np.ndarray,
    work: _Work,
) -> int:
    """Fill `box` and `link`, and sort `order` by leaves, of triangles with bounds `low`, `high` and `middle`; the
    number of boxes, -1 if they are too deep."""
    count, top = 1, 1
    work.wait[0, 0], work.wait[0, 1], work.wait[0, 2] = 0, 0, len(order)
    link[0, 0] = -1
    while top > 0:
        top -= 1
        node, first, last = work.wait[top, 0], work.wait[top, 1], work.wait[top, 2]
        for k in range(3):
            box[node, k], box[node, 3 + k] = np.inf, -np.inf
            work.span[0, k], work.span[1, k] = np.inf, -np.inf
            for i in range(first, last):
                f = order[i]
                box[node, k] = min(box[node, k], low[f, k])
                box[node, 3 + k] = max(box[node, 3 + k], high[f, k])
                work.span[0, k] = min(work.span[0, k], middle[f, k])
                work.span[1, k] = max(work.span[1, k], middle[f, k])
        axis, cut = _split(low, high, middle, order, first, last, work)
        if axis < 0:
            link[node, 1], link[node, 2], link[node, 3] = first, last - first, 0
            continue
        if top + 2 > len(work.wait):
            return -1
        i, j = first, last - 1
        while i <= j:
            if _bin(middle[order[i], axis], work.span, axis) <= cut:
                i += 1
            else:
                order[i], order[j] = order[j], order[i]
                j -= 1
        link[node, 1], link[node, 2], link[node, 3] = count, 0, axis
        for k in range(2):
            link[count + k, 0] = node
            work.wait[top + k, 0] = count + k
            work.wait[top + k, 1] = first if k == 0 else i
            work.wait[top + k, 2] = i if k == 0 else last
        count, top = count + 2, top + 2
    return count


@part(forceinline=True)
def _bin(at: float, span: np.ndarray, axis: int) -> int:
    width = span[1, axis] - span[0, axis]
    return min(_BINS - 1, int(_BINS * ((at - span[0, axis]) / width)))


@part
def _split(
    low: np.ndarray,
    high: np.ndarray,
    middle: np.ndarray,
    order: np.ndarray,
    first: int,
    last: int,
    work: _Work,
) -> tuple[int, int]:
    """(axis, last bin on the lower side) of the split of the least area times triangles; axis -1 for a leaf."""
    best, axis, cut = np.inf, -1, -1
    if last - first <= _LEAF:
        return axis, cut
    for k in range(3):
        if not work.span[1, k] > work.span[0, k]:
            continue
        for j in range(_BINS):
            work.count[j] = 0
            for c in range(3):
                work.low[j, c], work.high[j, c] = np.inf, -np.inf
        for i in range(first, last):
            f = order[i]
            j = _bin(middle[f, k], work.span, k)
            work.count[j] += 1
            for c in range(3):
                work.low[j, c] = min(work.low[j, c], low[f, c])
                work.high[j, c] = max(work.high[j, c], high[f, c])
        for side in range(2):  # from above, and then from below
            inside = 0
            for c in range(3):
                work.span[2, c], work.span[3, c] = np.inf, -np.inf
            for step in range(_BINS - 1):
                j = step if side == 1 else _BINS - 1 - step
                inside += work.count[j]
                for c in range(3):
                    work.span[2, c] = min(work.span[2, c], work.low[j, c])
                    work.span[3, c] = max(work.span[3, c], work.high[j, c])
                a, b, d = (
                    work.span[3, 0] - work.span[2, 0],
                    work.span[3, 1] - work.span[2, 1],
                    work.span[3, 2] - work.span[2, 2],
                )
                cost = inside * (a * b + b * d + d * a) if inside > 0 else 0.0
                if side == 0:
                    work.right[j] = cost
                elif 0 < inside < last - first and cost + work.right[j + 1] < best:
                    best, axis, cut = cost + work.right[j + 1], k, j
    return axis, cut


class _Ray(NamedTuple):
    """A ray, and what its tests have in common."""

    origin: Vec3
    inverse: Vec3  # of the direction's components
    axis: int  # of the longest component, z of the triangle test; x and y follow it, or change places
    x: int
    y: int
    shear: Vec3  # of x and y along z; 1 over the direction's z


@part(forceinline=True)
def _as_ray(origin: Vec3, direction: Vec3) -> _Ray:
    dx, dy, dz = direction
    if abs(dx) >= abs(dy) and abs(dx) >= abs(dz):
        axis, x, y = 0, 1, 2
    elif abs(dy) >= abs(dz):
        axis, x, y = 1, 2, 0
    else:
        axis, x, y = 2, 0, 1
    along = _component(direction, axis)
    if along < 0.0:
        x, y = y, x
    shear = _component(direction, x) / along, _component(direction, y) / along, 1.0 / along
    inverse = (
        1.0 / (dx if dx != 0.0 else _TINY),
        1.0 / (dy if dy != 0.0 else _TINY),
        1.0 / (dz if dz != 0.0 else _TINY),
    )
    return _Ray(origin, inverse, axis, x, y, shear)


@part(forceinline=True)
def _component(a: Vec3, axis: int) -> float:
    return a[0] if axis == 0 else (a[1] if axis == 1 else a[2])


@part(forceinline=True)
def _enters(tree: Hierarchy, node: int, ray: _Ray, limit: float) -> bool:
    """Whether a ray is in a box somewhere from its origin to `limit`."""
    near, far = 0.0, limit
    for k in range(3):
        o, r = _component(ray.origin, k), _component(ray.inverse, k)
        a, b = (tree.box[node, k] - o) * r, (tree.box[node, 3 + k] - o) * r
        near, far = max(near, min(a, b)), min(far, max(a, b))
    return near <= far


@part(forceinline=True)
def _meets(tree: Hierarchy, i: int, ray: _Ray) -> float:
    """Distance at which a ray meets triangle i, less than 0 where it does not. Of an edge that two triangles share,
    both compute the same number with opposite signs, so that none lets a ray through."""
    o, z = ray.origin, ray.axis
    oz, ox, oy = _component(o, z), _component(o, ray.x), _component(o, ray.y)
    az = tree.corners[i, z] - oz
    bz = tree.corners[i, 3 + z] - oz
    cz = tree.corners[i, 6 + z] - oz
    sx, sy, sz = ray.shear
    ax, ay = tree.corners[i, ray.x] - ox - sx * az, tree.corners[i, ray.y] - oy - sy * az
    bx, by = tree.corners[i, 3 + ray.x] - ox - sx * bz, tree.corners[i, 3 + ray.y] - oy - sy * bz
    cx, cy = tree.corners[i, 6 + ray.x] - ox - sx * cz, tree.corners[i, 6 + ray.y] - oy - sy * cz
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
        return -1.0
    whole = u + v + w
    if whole == 0.0:
        return -1.0
    t = (u * az + v * bz + w * cz) * sz / whole
    return t if t >= 0.0 else -1.0  # NaN is no hit


@part
def _follow(
    tree: Hierarchy, origin: Vec3, direction: Vec3, limit: float, any_hit: bool
) -> tuple[float, int]:
    """(distance, row of the mesh) of the nearest hit, or of the first that is found; (inf, -1) if there is none."""
    ray = _as_ray(origin, direction)
    best, found = limit, -1
    node, came = 0, _DOWN
    while True:
        if came == _UP:
            parent = tree.link[node, 0]
            if parent < 0:
                break
            first = tree.link[parent, 1]
            near = first + (1 if _component(ray.inverse, tree.link[parent, 3]) < 0.0 else 0)
            if node == near:
                node, came = 2 * first + 1 - near, _ACROSS
            else:
                node = parent
            continue
        count, first = tree.link[node, 2], tree.link[node, 1]
        if _enters(tree, node, ray, best):
            if count == 0:
                turned = _component(ray.inverse, tree.link[node, 3]) < 0.0
                node, came = first + (1 if turned else 0), _DOWN
                continue
            for i in range(first, first + count):
                t = _meets(tree, i, ray)
                if t >= 0.0 and (t < best or (t == best and (found < 0 or tree.face[i] < found))):
                    best, found = t, tree.face[i]
            if any_hit and found >= 0:
                break
        parent = tree.link[node, 0]
        if parent < 0:
            break
        if came == _DOWN:
            node, came = 2 * tree.link[parent, 1] + 1 - node, _ACROSS
        else:
            node, came = parent, _UP
    if found < 0:
        return math.inf, -1
    return best, found


@part
def intersect(tree: Hierarchy, origin: Vec3, direction: Vec3, limit: float) -> tuple[float, int]:
    """Nearest hit of a ray within `limit`: (distance, triangle), or (inf, -1)."""
    return _follow(tree, origin, direction, limit, False)


@part
def occluded(tree: Hierarchy, origin: Vec3, direction: Vec3, limit: float) -> bool:
    """True if anything lies on a ray before `limit`."""
    return _follow(tree, origin, direction, limit, True)[1] >= 0
