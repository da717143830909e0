"""Where a plane has triangles, drawn into cells: what says cheaply that there is nothing to reflect."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, part
from soundspaces_sim.core.numerics.vec3 import Vec3, dot, row
from soundspaces_sim.transport.arrivals.specular_planes import SpecularPlanes, faces_of_planes, in_plane

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


def _widened(covered: np.ndarray, cells: int) -> np.ndarray:
    """With all cells that are so near to one along either axis."""
    for _ in range(2):
        total = np.cumsum(np.pad(covered, ((cells + 1, cells), (0, 0))), axis=0)
        covered = (total[2 * cells + 1 :] > total[: -2 * cells - 1]).T
    return np.asarray(covered)


def make_cover(of_face: np.ndarray, corners: np.ndarray, planes: SpecularPlanes) -> Cover:
    """Of the triangles (F, 3, 3) m of planes; `of_face` (F,): plane of each, -1 for none."""
    order, start = faces_of_planes(of_face, len(planes.offset))
    bases, firsts, sizes, cells = [], [], [], [np.empty((0, 0), np.uint8)]
    for a, (low, high) in enumerate(pairwise(start)):
        basis = in_plane(planes.normal[a])
        flat = corners[order[low:high]] @ basis.T
        least, most = np.zeros(2), np.zeros(2)
        if len(flat):
            least, most = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
        size = max(
            _CELL, float(np.sqrt(np.prod(most - least) / _MOST)), float((most - least).max()) / _MOST
        )
        near, there = int(np.ceil(_NEAR / size)), 1 + int(planes.margin[a] / size)
        border = near + there + 1
        first = least - border * size
        covered = np.zeros(np.ceil((most - least) / size).astype(int) + 2 * border, np.bool_)
        draw((flat - first) / size, _BESIDE, covered)
        bases.append(basis)
        firsts.append(first)
        sizes.append(size)
        cells.append(_widened(covered, there).astype(np.uint8) + _widened(covered, near))
    shapes = np.array([c.shape for c in cells[1:]], np.int64).reshape(-1, 2)
    return Cover(
        np.array(bases).reshape(-1, 2, 3),
        np.array(firsts).reshape(-1, 2),
        np.array(sizes, float),
        shapes,
        np.append(0, np.cumsum(shapes.prod(axis=1)))[:-1],
        np.concatenate([c.ravel() for c in cells]),
    )


@part(forceinline=True)
def cover_at(cover: Cover, a: int, x: Vec3) -> int:
    """What `Cover.cell` has at a place in plane `a`."""
    i = int((dot(row(cover.basis[a], 0), x) - cover.corner[a, 0]) / cover.size[a])
    j = int((dot(row(cover.basis[a], 1), x) - cover.corner[a, 1]) / cover.size[a])
    nx, ny = cover.shape[a]
    return cover.cell[cover.start[a] + i * ny + j] if 0 <= i < nx and 0 <= j < ny else 0
