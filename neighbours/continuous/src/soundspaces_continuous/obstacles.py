"""What stands in an agent's way on a floor, as segments in the plane, and a disc that moves among them exactly.

An obstacle is every part of a triangle between a step above the floor and the agent's height. Its projection on the
floor is a convex polygon of at most five corners; for distances from outside, all segments between its corners
stand for it. A disc of the agent's radius touches a segment where its centre meets the segment's sides at a
distance of one radius, or a circle about one of its ends: contact is found in closed form, not by small steps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.parts import kernel, kernel_part as part, unique_rows

_CELL = 0.5  # m, of the table of segments
_ALIKE = 1e-5  # m, to which segments are compared
_SAME = 1e-9
SKIN = 1e-6  # m that stay between a disc and what it has touched
SLIDES = 4  # contacts in one move


class Obstacles(NamedTuple):
    """Segments in the plane, and which of them are near a cell."""

    segments: np.ndarray  # (n, 4) m: x0, y0, x1, y1
    start: np.ndarray  # (nx * ny + 1,) where each cell's rows of `near` start
    near: np.ndarray  # (k,) rows of `segments` within a radius of the cell
    origin: np.ndarray  # (2,) m
    shape: np.ndarray  # (2,) cells
    radius: float  # m, of the disc


class Contact(NamedTuple):
    """Where a disc first touches something on its way."""

    share: float  # of the way; inf: nothing
    x: float  # unit normal, away from the obstacle
    y: float


def make_obstacles(corners: np.ndarray, low: float, high: float, radius: float) -> Obstacles:
    """Obstacles of triangles (F, 3, 3) m between two heights, for a disc of `radius`."""
    z = corners[:, :, 2]
    among = corners[(z.max(axis=1) > low) & (z.min(axis=1) < high)]
    parts = [_segments(triangle, low, high) for triangle in among]
    segments = np.concatenate([np.empty((0, 4)), *parts])
    segments = np.round(segments / _ALIKE) * _ALIKE
    swap = (segments[:, 0] > segments[:, 2]) | (
        (segments[:, 0] == segments[:, 2]) & (segments[:, 1] > segments[:, 3])
    )
    segments[swap] = segments[swap][:, [2, 3, 0, 1]]
    if len(segments):
        segments = segments[np.sort(unique_rows(segments)[0])]
    return _in_cells(np.ascontiguousarray(segments), radius)


def _segments(triangle: np.ndarray, low: float, high: float) -> np.ndarray:
    """(n, 4) segments that stand for a triangle's part between two heights."""
    z = triangle[:, 2]
    points = [triangle[i, :2] for i in range(3) if low <= z[i] <= high]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        for level in (low, high):
            if (z[i] - level) * (z[j] - level) < 0.0:
                t = (level - z[i]) / (z[j] - z[i])
                points.append(triangle[i, :2] + t * (triangle[j, :2] - triangle[i, :2]))
    if len(points) < 2:
        return np.array([[*p, *p] for p in points]).reshape(-1, 4)
    flat = np.array(points)
    offset = flat - flat[0]
    axis = offset[np.abs(offset).sum(axis=1).argmax()]
    length = math.hypot(*axis)
    if length < _ALIKE or np.abs(offset @ np.array([-axis[1], axis[0]])).max() < _ALIKE * length:
        along = offset @ axis
        return np.array([[*flat[along.argmin()], *flat[along.argmax()]]])
    return np.array([[*flat[i], *flat[j]] for i in range(len(flat)) for j in range(i)])


def _in_cells(segments: np.ndarray, radius: float) -> Obstacles:
    low = np.minimum(segments[:, :2], segments[:, 2:]) - radius - _CELL * _SAME
    high = np.maximum(segments[:, :2], segments[:, 2:]) + radius + _CELL * _SAME
    origin = low.min(axis=0, initial=np.inf) if len(segments) else np.zeros(2)
    first = np.floor((low - origin) / _CELL).astype(np.int64)
    last = np.floor((high - origin) / _CELL).astype(np.int64)
    shape = last.max(axis=0) + 1 if len(segments) else np.ones(2, np.int64)
    cell, row = [], []
    for k, ((i0, j0), (i1, j1)) in enumerate(zip(first, last, strict=True)):
        i, j = np.meshgrid(np.arange(i0, i1 + 1), np.arange(j0, j1 + 1), indexing="ij")
        cell.append((i * shape[1] + j).ravel())
        row.append(np.full(i.size, k))
    cells = np.concatenate([np.empty(0, np.int64), *cell])
    rows = np.concatenate([np.empty(0, np.int64), *row])
    order = np.argsort(cells, kind="stable")
    start = np.searchsorted(cells[order], np.arange(int(shape.prod()) + 1))
    return Obstacles(segments, start, rows[order], origin, shape, radius)


@part
def _touch(
    ax: float, ay: float, bx: float, by: float, way: tuple[float, float, float, float, float]
) -> Contact:
    """First contact of a disc, `way` being x, y, dx, dy and its radius, with the segment from a to b."""
    x, y, dx, dy, r = way
    best, nx, ny = np.inf, 0.0, 0.0
    ex, ey = bx - ax, by - ay
    length = math.hypot(ex, ey)
    if length > _SAME:
        ex, ey = ex / length, ey / length
        h = (x - ax) * -ey + (y - ay) * ex
        side = 1.0 if h >= 0.0 else -1.0
        toward = -side * (dx * -ey + dy * ex)
        if toward > _SAME * (abs(dx) + abs(dy)):
            t = max((abs(h) - r) / toward, 0.0)
            u = (x + t * dx - ax) * ex + (y + t * dy - ay) * ey
            if 0.0 <= u <= length and abs(h) - t * toward >= r - 1e-3 * r:
                best, nx, ny = t, -ey * side, ex * side
    a = dx * dx + dy * dy
    for end in range(2):
        px, py = (ax, ay) if end == 0 else (bx, by)
        vx, vy = x - px, y - py
        b, c = vx * dx + vy * dy, vx * vx + vy * vy - r * r
        if b < 0.0 and b * b - a * c >= 0.0:
            t = max((-b - math.sqrt(b * b - a * c)) / a, 0.0)
            if t < best:
                cx, cy = vx + t * dx, vy + t * dy
                d = math.hypot(cx, cy)
                if d > 0.0:
                    best, nx, ny = t, cx / d, cy / d
    return Contact(best, nx, ny)


@part
def first_contact(obstacles: Obstacles, x: float, y: float, dx: float, dy: float) -> Contact:
    """Where a disc at (x, y) first touches something on its way by (dx, dy), of shares up to 1."""
    best = Contact(np.inf, 0.0, 0.0)
    if dx == 0.0 and dy == 0.0:
        return best
    cells = max(abs(dx), abs(dy)) / _CELL
    steps = int(math.ceil(cells)) + 1
    before_i, before_j = -1, -1
    for s in range(steps):
        # bounds of this part of the way: the cells that it may touch
        x0, y0 = x + dx * s / steps, y + dy * s / steps
        x1, y1 = x + dx * (s + 1) / steps, y + dy * (s + 1) / steps
        i0 = int(math.floor((min(x0, x1) - obstacles.origin[0]) / _CELL))
        i1 = int(math.floor((max(x0, x1) - obstacles.origin[0]) / _CELL))
        j0 = int(math.floor((min(y0, y1) - obstacles.origin[1]) / _CELL))
        j1 = int(math.floor((max(y0, y1) - obstacles.origin[1]) / _CELL))
        for i in range(max(i0, 0), min(i1, obstacles.shape[0] - 1) + 1):
            for j in range(max(j0, 0), min(j1, obstacles.shape[1] - 1) + 1):
                if i == before_i and j == before_j:
                    continue
                before_i, before_j = i, j
                cell = i * obstacles.shape[1] + j
                for k in range(obstacles.start[cell], obstacles.start[cell + 1]):
                    n = obstacles.near[k]
                    g = obstacles.segments
                    found = _touch(g[n, 0], g[n, 1], g[n, 2], g[n, 3], (x, y, dx, dy, obstacles.radius))
                    if found.share < best.share and found.share <= 1.0:
                        best = found
        if best.share <= (s + 1.0) / steps:
            return best
    return best


@part
def clearance(obstacles: Obstacles, x: float, y: float) -> float:
    """Distance of the nearest obstacle, m; inf if none is within a radius or more."""
    i = int(math.floor((x - obstacles.origin[0]) / _CELL))
    j = int(math.floor((y - obstacles.origin[1]) / _CELL))
    best = np.inf
    if i < 0 or j < 0 or i >= obstacles.shape[0] or j >= obstacles.shape[1]:
        return best
    cell = i * obstacles.shape[1] + j
    for k in range(obstacles.start[cell], obstacles.start[cell + 1]):
        ax, ay, bx, by = obstacles.segments[obstacles.near[k]]
        ex, ey = bx - ax, by - ay
        square = ex * ex + ey * ey
        u = 0.0 if square == 0.0 else min(max(((x - ax) * ex + (y - ay) * ey) / square, 0.0), 1.0)
        best = min(best, math.hypot(x - ax - u * ex, y - ay - u * ey))
    return best


@kernel
def move_disc(obstacles: Obstacles, pose: np.ndarray, way: np.ndarray, slide: bool) -> bool:
    """`step_disc`, called from Python."""
    return bool(step_disc(obstacles, pose, way, slide))


@part
def step_disc(obstacles: Obstacles, pose: np.ndarray, way: np.ndarray, slide: bool) -> bool:
    """Move a disc at `pose` (2,) by `way` (2,), in place; whether it touched something. It stops there or, with
    `slide`, goes on along it with what is left of its way in that direction, as Habitat's agents do."""
    first_x, first_y = way
    dx, dy = first_x, first_y
    collided = False
    for _ in range(SLIDES):
        length = math.hypot(dx, dy)
        if length < SKIN:
            break
        hit = first_contact(obstacles, pose[0], pose[1], dx, dy)
        if hit.share > 1.0:
            pose[0] += dx
            pose[1] += dy
            break
        collided = True
        # Back by as much as leaves a skin along the normal, but never behind the start.
        toward = max(-(dx * hit.x + dy * hit.y), 1e-3 * length)
        share = max(hit.share - SKIN / toward, 0.0)
        pose[0] += share * dx
        pose[1] += share * dy
        if not slide:
            break
        left = 1.0 - share
        dx, dy = left * dx, left * dy
        into = dx * hit.x + dy * hit.y
        if into < 0.0:
            dx, dy = dx - into * hit.x, dy - into * hit.y
        if dx * first_x + dy * first_y <= 0.0:
            break
    return collided


@kernel
def least_clearances(obstacles: Obstacles, places: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (N,) with the distance of the nearest obstacle of each place (N, 2), m; see `clearance`."""
    for k in range(len(places)):
        out[k] = clearance(obstacles, places[k, 0], places[k, 1])


@kernel
def are_free(obstacles: Obstacles, ways: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (N,): whether a disc moves straight along each of `ways` (N, 4), x0, y0, x1, y1, touching
    nothing."""
    for k in range(len(ways)):
        x, y, x1, y1 = ways[k]
        out[k] = not first_contact(obstacles, x, y, x1 - x, y1 - y).share <= 1.0
