"""Triangles of plane polygons, convex or not."""

from __future__ import annotations

import numpy as np

from soundspaces_sim import SceneError

MOST_CORNERS = 256  # of a polygon: ears are looked for in the square of their number


def newell_normal(corners: np.ndarray) -> np.ndarray:
    """(3,) twice the area times the normal of a polygon (n, 3), which its corners go round counter-clockwise."""
    return np.asarray(np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0))


def triangulate(corners: np.ndarray, what: str) -> np.ndarray:
    """(k, 3) rows of the corners (n, 3) of the triangles of a simple polygon, k = n - 2, by cutting off ears.

    Corners on a line with their neighbours are allowed. Raises `SceneError`, which begins with `what`, for fewer
    than 3 or more than `MOST_CORNERS` corners, for no area, and for sides that cross so that ears run out.
    """
    count = len(corners)
    if not 3 <= count <= MOST_CORNERS:
        raise SceneError(f"{what}: expected 3 to {MOST_CORNERS} corners, got {count}")
    normal = newell_normal(corners - corners[0])
    size = float(np.abs(corners - corners[0]).max())
    if not float(np.linalg.norm(normal)) > 1e-12 * size**2:
        raise SceneError(f"{what}: the polygon has no area")
    if count == 3:
        return np.array([[0, 1, 2]])
    drop = int(np.abs(normal).argmax())
    flat = np.delete(corners - corners[0], drop, axis=1)
    if (normal[drop] > 0.0) == (
        drop == 1
    ):  # seen from the side on which it goes round counter-clockwise
        flat = flat[:, ::-1]
    left, out, slack = list(range(count)), [], 1e-12 * size**2
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(flat, left, i, slack)), None)
        if ear is None:
            raise SceneError(f"{what}: the sides of the polygon cross")
        out.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    if float(_cross(*flat[left])) < -slack:
        raise SceneError(f"{what}: the sides of the polygon cross")
    return np.array([*out, left])


def _cross(o: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Twice the signed area of triangles o, a, b; (…, 2) each."""
    u, v = a - o, b - o
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])


def _is_ear(flat: np.ndarray, left: list[int], i: int, slack: float) -> bool:
    """Whether the triangle at the i-th corner that is left turns left, or is flat, and holds no other corner."""
    a, b, c = flat[left[i - 1]], flat[left[i]], flat[left[(i + 1) % len(left)]]
    turn = float(_cross(a, b, c))
    if turn < -slack:
        return False
    others = [n for k, n in enumerate(left) if k not in (i, (i - 1) % len(left), (i + 1) % len(left))]
    points = flat[others]
    same = ((points == a) | (points == b) | (points == c)).all(
        axis=1
    )  # corners that meet, as beside a slit
    if turn <= slack:  # no area: a corner on the line between its neighbours, unless it is a spike
        return bool((b - a) @ (c - b) >= 0.0)
    inside = (
        (_cross(a, b, points) >= -slack)
        & (_cross(b, c, points) >= -slack)
        & (_cross(c, a, points) >= -slack)
        & ~same
    )
    return not inside.any()
