"""Which points sound can reach from a place where a person can stand: the others lie in solids or between them.

The rule, for any mesh: a place to stand is a level spot of floor, free all around to a person's width, under
headroom, and not inside a solid. A point belongs to the scene if it sees such a place, or if diffuse walks
from it come to see one. Inside a partition, a closed wardrobe or the gap between two skins of a wall there is
no room to stand, and no way out; a hole in a mesh, or furniture without a bottom, lets sound through and keeps
the point, as does a mesh without any place to stand. So the rule prunes too little rather than too much.

A solid so large that one could stand in it (a pillar, a lift shaft) is told from a room by four signs: it winds
around the places in it (generalised winding number; Jacobson et al. 2013), nothing else is in it, no sound
gets out, and most of its sides face indoor places to stand that are in no such solid. A closed room that
stands alone or beside others has no such places around it, and is kept.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.rng import combine, point_keys, uniform
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.scene.enclosure import ENCLOSED, closedness
from soundspaces_sim.scene.rays.directions import sample_cosine_hemisphere, sample_sphere
from soundspaces_sim.scene.rays.geometry import Geometry, before, intersect, unoccluded
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import pieces_of, welded_faces
from soundspaces_sim.scene.walkable import find_floors

_CELL, _STEP = 0.1, 0.2  # m
_BODY = 0.3  # m, half the width that a person takes
_NEAR = 16  # places that are tried first
_WALKS, _BOUNCES = 64, 20
_ENOUGH = 2  # walks that must come to see a place: one may slip through an edge
_INSIDE = 0.9  # winding number
_SAMPLES = 64
_PARTS = 0.2  # m by which parts of a solid may stick out
_SKIN = 0.15  # m within which faces belong to a solid's shell
_FACING = 0.6  # share of a solid's sides before which one can stand
_MOST_ANGLES = 200_000_000  # solid angles worth computing for one piece, …
_TOGETHER = 10_000  # … of which so many are computed at once


def reachable(scene: Scene, points: np.ndarray, height: float) -> np.ndarray:
    """(N,) whether sound gets from points (N, 3) m to a place to stand under `height` m of headroom; True for all
    where a scene has no such place. Raises `SceneError` for scenes too large (see `find_floors`)."""
    places = standing_places(scene, height)
    if len(places) == 0 or len(points) == 0:
        return np.ones(len(points), bool)
    places = places[~_in_solids(scene, places, height)]
    return _reach(scene, points, places)


def standing_places(scene: Scene, height: float) -> np.ndarray:
    """(W, 3) m, half of `height` above the spots of floor where a person can stand, solids not looked at."""
    columns = find_floors(scene.corners, _CELL, height, _BODY, _STEP)
    column = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))[columns.stand]
    middles = columns.cells.middles(*np.divmod(column, columns.cells.ny))
    level = columns.floor[columns.stand].astype(float) + 0.5 * height
    return np.stack([*middles, level], axis=1)


def winding_numbers(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,) how often triangles (F, 3, 3) wind around points (N, 3): 1 in a closed surface whose normals point
    outward, 0 outside (solid angles; van Oosterom and Strackee 1983)."""
    out, together = np.empty(len(points)), max(_TOGETHER // len(corners), 1)
    for first in range(0, len(points), together):
        some = slice(first, first + together)
        a, b, c = np.moveaxis(corners - points[some, None, None], 2, 0)  # (n, F, 3) each
        la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
        ab, bc, ca = ((x * y).sum(axis=2) for x, y in ((a, b), (b, c), (c, a)))
        volume = (a * np.cross(b, c)).sum(axis=2)
        angle = np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
        out[some] = angle.sum(axis=1) / (2.0 * np.pi)
    return out


def _reach(scene: Scene, points: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(N,) whether any of the places is seen from points, or from where walks from there get to."""
    if len(places) == 0:
        return np.zeros(len(points), bool)
    _, near = cKDTree(places).query(points, k=min(_NEAR, len(places)))
    keys = point_keys(np.ascontiguousarray(points), 0)
    out = np.zeros(len(points), np.bool_)
    near = np.ascontiguousarray(near.reshape(len(points), -1))
    centred, seen = points - scene.center, places - scene.center
    over_rows(_walk_to_places, len(points), scene.geometry, centred, keys, seen, near, out)
    return out


@kernel
def _walk_to_places(
    first: int,
    last: int,
    geometry: Geometry,
    points: np.ndarray,
    keys: np.ndarray,
    places: np.ndarray,
    near: np.ndarray,
    out: np.ndarray,
) -> None:
    """Flag `out` (N,): point i sees one of the `places` (W, 3) in rows `near` (N, K), or enough diffuse walks from
    it (random streams `keys`) come to see one."""
    for i in range(first, last):
        point = row(points, i)
        for k in range(near.shape[1]):
            if not out[i] and unoccluded(geometry, point, row(places, near[i, k])):
                out[i] = True
        found = 0
        for walk in range(_WALKS):
            if out[i]:
                break
            stream = combine(keys[i], walk)
            stream, u = uniform(stream)
            stream, v = uniform(stream)
            direction = sample_sphere(u, v)
            origin = point
            for _ in range(_BOUNCES):
                hit = intersect(geometry, origin, direction, np.inf)
                if hit.triangle < 0:
                    break
                origin = before(geometry, hit, direction)
                stream, u = uniform(stream)
                stream, v = uniform(stream)
                a = row(places, near[i, int(u * near.shape[1])])
                b = row(places, int(v * len(places)))
                if unoccluded(geometry, origin, a) or unoccluded(geometry, origin, b):
                    found += 1
                    break
                stream, u = uniform(stream)
                stream, v = uniform(stream)
                direction = sample_cosine_hemisphere(hit.normal, u, v)
            out[i] = found >= _ENOUGH


def _in_solids(scene: Scene, places: np.ndarray, height: float) -> np.ndarray:
    """(W,) whether a place to stand lies in a solid, by the four signs of the module's description."""
    points, faces = welded_faces(scene.vertices, scene.faces, 5)
    piece = pieces_of(faces, len(points))
    order = np.argsort(piece, kind="stable")
    start = np.searchsorted(piece[order], np.arange(piece.max() + 1))
    low = np.minimum.reduceat(scene.corners.min(axis=1)[order], start)
    high = np.maximum.reduceat(scene.corners.max(axis=1)[order], start)
    large = ((high - low)[:, :2] >= 2.0 * _BODY).all(axis=1) & (high[:, 2] - low[:, 2] >= height)
    closed: list[tuple[np.ndarray, np.ndarray, float]] = []  # faces, places inside, sense of winding
    for p in np.flatnonzero(large):
        # Doors, feet and handles are pieces of their own.
        own = ((low >= low[p] - _PARTS) & (high <= high[p] + _PARTS)).all(axis=1)
        rows = np.flatnonzero(own[piece])
        inside, sense = _sealed_inside(scene, rows, places, low[p], high[p])
        if len(inside):
            closed.append((rows, inside, sense))
    within = np.zeros(len(places), bool)
    for _, inside, _ in closed:
        within[inside] = True
    open_places = places[~within]
    out = np.zeros(len(places), bool)
    for rows, inside, sense in closed:
        out[inside] = _is_surrounded(scene, rows, sense, open_places)
    return out


def _sealed_inside(
    scene: Scene, rows: np.ndarray, places: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, float]:
    """Rows of the places in a solid (faces `rows` between `low` and `high`) that is sealed and empty, none if it is
    not, and the sign of its winding."""
    none = np.empty(0, np.int64), 0.0
    boxed = ((places > low) & (places < high)).all(axis=1)
    here = np.flatnonzero(boxed)
    if len(here) == 0 or len(here) == len(places):
        return none
    middle = scene.corners.mean(axis=1)
    if ((middle > low + _SKIN) & (middle < high - _SKIN)).all(axis=1).any():
        return none  # something is in it
    corners = scene.corners[rows]
    few = here[np.linspace(0, len(here) - 1, min(len(here), _SAMPLES)).astype(int)]
    winding = winding_numbers(places[few], corners)
    in_few = np.abs(winding) > _INSIDE
    if not in_few.any() or len(here) * len(rows) > _MOST_ANGLES:
        return none
    outside = np.concatenate([places[~boxed], places[few[~in_few]]])
    if _reach(scene, places[few[in_few]], outside).any():
        return none
    inside = np.abs(winding_numbers(places[here], corners)) > _INSIDE
    return here[inside], float(np.sign(winding[in_few][0]))


def _is_surrounded(scene: Scene, rows: np.ndarray, sense: float, places: np.ndarray) -> bool:
    """Whether most of a piece's sides face indoor places to stand."""
    sides = rows[np.abs(scene.normals[rows, 2]) < 0.5]
    if len(sides) == 0 or len(places) == 0:
        return False
    rng = np.random.default_rng(0)
    chosen = rng.choice(sides, _SAMPLES, p=scene.areas[sides] / scene.areas[sides].sum())
    u, v = np.sqrt(rng.random((_SAMPLES, 1))), rng.random((_SAMPLES, 1))
    c = scene.corners[chosen]
    before = c[:, 0] * (1 - u) + c[:, 1] * u * (1 - v) + c[:, 2] * u * v
    before += 0.02 * sense * scene.normals[chosen]
    _, near = cKDTree(places).query(before, k=min(8, len(places)))
    near = near.reshape(_SAMPLES, -1)
    known, inverse = np.unique(near, return_inverse=True)
    indoors = closedness(scene, places[known], 64, 10)[0] >= ENCLOSED
    seen = sees(scene, before, places[near])
    return bool((seen & indoors[inverse.reshape(near.shape)]).any(axis=1).mean() >= _FACING)


def sees(scene: Scene, points: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(N, K) whether each of points (N, 3) m sees its places (N, K, 3) m."""
    seen = np.zeros(places.shape[:2], np.bool_)
    _see(scene.geometry, points - scene.center, places - scene.center, seen)
    return seen


@kernel
def _see(geometry: Geometry, points: np.ndarray, places: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (N, K): whether each point (N, 3) sees its places (N, K, 3)."""
    for i in range(len(points)):
        for k in range(places.shape[1]):
            out[i, k] = unoccluded(geometry, row(points, i), row(places[i], k))
