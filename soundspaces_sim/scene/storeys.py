"""The storeys of a scene: which of its level surfaces are floors that people are on.

Large level surfaces are candidates. The lowest is a storey. A higher one is a storey if one can walk onto it from
the storey with the most floor, or if it has enough floor of its own to be one that is reached otherwise (a lift, a
stair that the mesh lacks). Tops of furniture and lamps are neither; nor is the back of a ceiling: a sheet that
faces the other way than the lowest floor does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.scene.enclosure import ENCLOSED, closedness
from soundspaces_sim.scene.heightfield import too_large
from soundspaces_sim.scene.rays.diffuse_walk import drop
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.walkable import Columns, find_floors, neighbours

_SLAB = 0.1  # m
_LARGE = 0.1  # of the largest slab's area, from which on a slab may be a floor
_SEEN = 0.25  # share of a floor that is in sight from above
_SAMPLES = 512
_THICK = 0.6  # m, of a slab with what is in it
_CELL, _STEP = 0.1, 0.2  # m
_AGENT, _BODY = 0.1, 0.3  # m, half the width of who walks there, and of who stays
_SHARE = 0.25  # of the largest floor, from which on a floor that nobody can walk onto is a storey


class Storeys(NamedTuple):
    """`floors` (K,) m, ascending; `walked` (K,) whether one can walk between each and the one with the
    most floor; `area` (K,) m² on which a person can stand, NaN for a single storey and for scenes too large.
    `left_out`: in words, what large level surfaces are no storeys, and why.
    """

    floors: np.ndarray
    walked: np.ndarray
    area: np.ndarray
    left_out: tuple[str, ...] = ()


class _Level(NamedTuple):
    height: float  # m
    free: float  # m² that are in sight from above
    faces: float  # -1 to 1: mean sign of the normals, of what is in sight
    sheet: bool  # whether most of it has no underside


def find_storeys(scene: Scene, height: float = 1.5) -> Storeys:
    """The storeys of a scene, by people who need `height` m of headroom.

    Level faces (within ~18 degrees) are summed in slabs of 10 cm. A floor has at least a tenth of the area of the
    largest slab, and a quarter of it is in sight from above: the underside of a floor slab is not. Every floor but
    the lowest lies `height` or more above the one before, what is seen of it lies mostly indoors (a roof is no
    storey), and one can walk onto it, in steps of at most 20 cm, or places to stand (free for 30 cm all around) are
    a quarter of the area of the largest floor.
    """
    levels = _levels(scene, height)
    if len(levels) <= 1:
        floors = np.array([level.height for level in levels] or [scene.bounds[0, 2]], float)
        return Storeys(floors, np.ones(1, bool), np.full(1, np.nan))
    floors = np.array([level.height for level in levels])
    if too_large(scene.corners, _CELL):
        return Storeys(floors, np.ones(len(floors), bool), np.full(len(floors), np.nan))
    walked, area = _walked_and_area(scene, levels, height)
    largest = max(level.free for level in levels)
    kept, left_out = [0], []
    for k, level in enumerate(levels[1:], 1):
        reason = ""
        if not walked[k] and area[k] < _SHARE * largest:
            reason = f"one cannot walk onto it, and {area[k]:.1f} m2 of it are free to stand on"
        elif not walked[k] and level.sheet and level.faces * levels[0].faces < -0.5:
            reason = "one cannot walk onto it, and it is the back of a ceiling"
        if reason:
            left_out.append(f"the level at {level.height:.2f} m is no storey: {reason}")
        else:
            kept.append(k)
    return Storeys(floors[kept], walked[kept], area[kept], tuple(left_out))


def floor_heights(scene: Scene, height: float = 1.5) -> np.ndarray:
    """(K,) heights of the floors of `find_storeys`, m, ascending."""
    return find_storeys(scene, height).floors


def above_no_floor(scene: Scene, points: np.ndarray, floors: np.ndarray) -> np.ndarray:
    """(N,) whether the surface straight below each of `points` (N, 3) lies more than a step below the floor of its
    storey, `floors` (N,) m: a void, in a storey that is a gallery, or beside stairs."""
    below = drop(scene.geometry, points - scene.center) + scene.center[2]
    out: np.ndarray = below < floors - _STEP
    return out


def _levels(scene: Scene, height: float) -> list[_Level]:
    """Large level surfaces, from the lowest up, that lie `height` apart and are seen from that far above."""
    level = np.flatnonzero(np.abs(scene.normals[:, 2]) > 0.95)
    if len(level) == 0:
        return []
    z = scene.corners[level, :, 2].mean(axis=1)
    slab = np.floor((z - z.min()) / _SLAB).astype(np.int64)
    total = np.bincount(slab, weights=scene.areas[level])
    total = total + np.append(total[1:], 0.0)  # a floor may lie on the boundary of two slabs
    rng = np.random.default_rng(0)
    found: list[_Level] = []
    for lowest in np.flatnonzero(total >= _LARGE * total.max()):
        members = level[(slab == lowest) | (slab == lowest + 1)]
        area = scene.areas[members]
        order = np.argsort(scene.corners[members, :, 2].mean(axis=1), kind="stable")
        middle = order[np.searchsorted(np.cumsum(area[order]), 0.5 * area.sum())]
        floor = float(scene.corners[members[middle], :, 2].mean())
        if found and floor < found[-1].height + height:
            continue
        chosen = rng.choice(members, _SAMPLES, p=area / area.sum())
        points = _points_on(scene.corners[chosen], rng)
        points[:, 2] = floor + height
        below = drop(scene.geometry, points - scene.center) + scene.center[2]
        seen = np.abs(below - floor) < 0.5 * _SLAB
        if seen.mean() <= _SEEN:
            continue
        if found and (closedness(scene, points[seen], 64, 10)[0] >= ENCLOSED).mean() < 0.5:
            continue
        faces = float(np.sign(scene.normals[chosen[seen], 2]).mean())
        points[:, 2] = floor - 0.5 * _SLAB
        under = drop(scene.geometry, points[seen] - scene.center) + scene.center[2]
        sheet = bool((under < floor - _THICK).mean() > 0.5)
        found.append(_Level(floor, float(area.sum() * seen.mean()), faces, sheet))
    return found


def _points_on(corners: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) m, one spread evenly over each of the triangles (N, 3, 3)."""
    u, v = np.sqrt(rng.random((len(corners), 1))), rng.random((len(corners), 1))
    points: np.ndarray = (
        corners[:, 0] * (1 - u) + corners[:, 1] * (u * (1 - v)) + corners[:, 2] * (u * v)
    )
    return points


def _walked_and_area(scene: Scene, levels: list[_Level], height: float) -> tuple[np.ndarray, np.ndarray]:
    """(K,) whether one can walk between levels and the one with the most floor, and (K,) m² to stand on."""
    columns = find_floors(scene.corners, _CELL, height, _AGENT, _STEP)
    column = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
    on = [np.abs(columns.floor - level.height) <= _STEP for level in levels]
    area = np.array([_standing_area(columns, column[here]) for here in on])
    component = _components(columns)
    standing = [here & columns.stand for here in on]
    main = int(np.argmax([level.free for level in levels]))
    reached = np.unique(component[standing[main]])
    walked = np.array([bool(np.isin(component[here], reached).any()) for here in standing])
    walked[main] = True
    return walked, area


def _components(columns: Columns) -> np.ndarray:
    """(k,) number of the connected part of the walkable cells in which each floor of the columns lies."""
    links, _ = neighbours(columns, _STEP)
    count = len(columns.floor)
    matrix = coo_array((np.ones(len(links), bool), (links[:, 0], links[:, 1])), shape=(count, count))
    found: np.ndarray = connected_components(matrix.tocsr(), directed=False)[1]
    return found


def _standing_area(columns: Columns, here: np.ndarray) -> float:
    """m² of these columns that are free of others for half a person's width all around."""
    free = np.zeros(columns.cells.nx * columns.cells.ny, bool)
    free[here] = True
    plan = free.reshape(columns.cells.nx, columns.cells.ny)
    inner = scipy.ndimage.distance_transform_edt(plan) * _CELL > _BODY
    return float(inner.sum() * _CELL**2)
