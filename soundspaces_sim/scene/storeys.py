"""The storeys of a scene: which of its level surfaces are floors that people are on.

Large level surfaces are candidates. The lowest is a storey. A higher one is a storey if one can walk onto it from
the storey with the most floor and most of it lies above other floor (the upper rows of an auditorium do not), or if
it has enough floor of its own to be one that is reached otherwise (a lift, a stair that the mesh lacks). Tops of
furniture and lamps are neither; nor is the back of a ceiling: a sheet that faces the other way than the lowest
floor does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from soundspaces_sim.scene.enclosure import ENCLOSED, closedness
from soundspaces_sim.scene.heightfield import Cells, too_large
from soundspaces_sim.scene.rays.diffuse_walk import drop
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.triangles import points_on
from soundspaces_sim.scene.walkable import Columns, find_floors, neighbours

_SLAB = 0.1  # m
_LARGE = 0.1  # of the largest slab's area, from which on a slab may be a floor
_SEEN = 0.25  # share of a floor that is in sight from above
_SAMPLES = 512
_THICK = 0.6  # m, of a slab with what is in it
CELL, STEP = 0.1, 0.2  # m
_AGENT, BODY = 0.1, 0.3  # m, half the width of who walks there, and of who stays
TIER, _TIER_AREA = 0.6, 2.0  # m up to which a tier of seats rises above the one before; m² of each
_APART = 0.45  # m between places to stand on two of them
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


class Ground(NamedTuple):
    """The floors that people walk on, in cells of `CELL`: `columns`; of each of its k floors `column` (k,) and
    `component` (k,), the number of what hangs together by steps of up to `STEP`, or by tiers of seats; `steps` (k,
    k), m, from one to the next, on one side of the diagonal."""

    columns: Columns
    column: np.ndarray
    component: np.ndarray
    steps: csr_array


class _Level(NamedTuple):
    height: float  # m
    free: float  # m² that are in sight from above
    faces: float  # -1 to 1: mean sign of the normals, of what is in sight
    sheet: bool  # whether most of it has no underside
    indoors: bool = True


def find_storeys(scene: Scene, height: float = 1.5, ground: Ground | None = None) -> Storeys:
    """The storeys of a scene, by people who need `height` m of headroom; `ground` is found unless it is given.

    Level faces (within ~18 degrees) are summed in slabs of 10 cm. A floor has at least a tenth of the area of the
    largest slab, and a quarter of it is in sight from above: the underside of a floor slab is not. Every floor but
    the lowest lies `height` or more above the one before, what is seen of it lies mostly indoors (a roof is no
    storey), and one can walk onto it, in steps of at most 20 cm, and it lies above another floor, or places to
    stand (free for 30 cm all around) are a quarter of the area of the largest floor.
    """
    levels = _levels(scene, height)
    ground = ground or find_ground(scene, height)
    if ground is not None:
        levels = _with_main_floor(ground, levels)
    floors = np.array([level.height for level in levels] or [scene.bounds[0, 2]], float)
    if ground is None or len(levels) <= 1:
        return Storeys(floors, np.ones(len(floors), bool), np.full(len(floors), np.nan))
    walked, above, area = _walked_and_area(ground, levels)
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
        elif above[k] or not walked[k]:
            kept.append(k)
    return Storeys(floors[kept], walked[kept], area[kept], tuple(left_out))


def floor_heights(scene: Scene, height: float = 1.5) -> np.ndarray:
    """(K,) heights of the floors of `find_storeys`, m, ascending."""
    return find_storeys(scene, height).floors


def above_no_floor(scene: Scene, points: np.ndarray, floors: np.ndarray) -> np.ndarray:
    """(N,) whether the surface straight below each of `points` (N, 3) lies more than a step below the floor of its
    storey, `floors` (N,) m: a void, in a storey that is a gallery, or beside stairs."""
    below = drop(scene.plain_geometry, points - scene.center) + scene.center[2]
    return below < floors - STEP


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
        u, v = rng.random((2, len(chosen)))
        points = points_on(scene.corners[chosen], u, v)
        points[:, 2] = floor + height
        below = drop(scene.plain_geometry, points - scene.center) + scene.center[2]
        seen = np.abs(below - floor) < 0.5 * _SLAB
        if seen.mean() <= _SEEN:
            continue
        indoors = bool(
            (closedness(scene, points[seen], 64, 10, scene.plain_geometry)[0] >= ENCLOSED).mean() >= 0.5
        )
        if found and not indoors:
            continue
        faces = float(np.sign(scene.normals[chosen[seen], 2]).mean())
        points[:, 2] = floor - 0.5 * _SLAB
        under = drop(scene.plain_geometry, points[seen] - scene.center) + scene.center[2]
        sheet = bool((under < floor - _THICK).mean() > 0.5)
        found.append(_Level(floor, float(area.sum() * seen.mean()), faces, sheet, indoors))
    return found


def find_ground(scene: Scene, height: float) -> Ground | None:
    """Where people walk, under `height` m of headroom; None for scenes too large for the cells."""
    if too_large(scene.corners, CELL):
        return None
    columns = find_floors(scene.corners, CELL, height, _AGENT, STEP)
    column = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
    links, length = neighbours(columns, STEP)
    count = len(columns.floor)
    steps = coo_array((length, (links[:, 0], links[:, 1])), shape=(count, count)).tocsr()
    component = connected_components(steps, directed=False)[1]
    return Ground(columns, column, _joined_tiers(columns, column, component, links), steps)


def _joined_tiers(
    columns: Columns, column: np.ndarray, component: np.ndarray, links: np.ndarray
) -> np.ndarray:
    """(k,) components of floors, of which those of a flight are one: four or more large ones, each beside the next
    and higher by up to `TIER`. A bed with a table beside it is none. `links` (E, 2) as of `neighbours`."""
    count = int(component.max(initial=-1)) + 1
    large = np.bincount(component[columns.stand], minlength=count) * CELL**2 >= _TIER_AREA
    ways = np.bincount(links.ravel(), minlength=len(component))
    border = np.flatnonzero(columns.stand & large[component] & (ways < ways.max(initial=0)))
    if large.sum() < 3 or len(border) == 0:
        return component
    from scipy.spatial import cKDTree  # here, because it takes long, and few scenes need it

    plan = np.column_stack(np.divmod(column[border], columns.cells.ny))
    pairs = border[cKDTree(plan).query_pairs(_APART / CELL, output_type="ndarray")]
    rise = columns.floor[pairs[:, 1]] - columns.floor[pairs[:, 0]]
    pairs[rise < 0.0] = pairs[rise < 0.0, ::-1]
    low, high = component[pairs[(np.abs(rise) > STEP) & (np.abs(rise) <= TIER)]].T
    between = np.intersect1d(low, high)
    span = np.full((2, count), -np.inf)
    np.maximum.at(span[0], component, columns.floor)
    np.maximum.at(span[1], component, -columns.floor)
    level = np.flatnonzero(span.sum(axis=0) <= STEP)
    tiers = np.intersect1d(between, level)
    core = np.isin(low, tiers) & np.isin(high, tiers)  # three tiers above a floor have such a step
    inner = np.union1d(low[core], high[core])
    edge = np.isin(low, inner) | np.isin(high, inner)
    flights = coo_array((np.ones(int(edge.sum())), (low[edge], high[edge])), shape=(count, count))
    return connected_components(flights, directed=False)[1][component]


def _with_main_floor(ground: Ground, levels: list[_Level]) -> list[_Level]:
    """The levels, and below them the foot of the largest indoor floor that people walk on if none is a level of it:
    a floor that rises all the way, beside whose area in any slab that of a ceiling is large."""
    columns = ground.columns
    indoors = columns.stand & ~columns.sky
    if not indoors.any():
        return levels
    main = indoors & (ground.component == np.bincount(ground.component[indoors]).argmax())
    foot, top = (float(columns.floor[main].min()), float(columns.floor[main].max()))
    if any(foot - STEP <= level.height <= top + STEP for level in levels):
        return levels
    area = float(main.sum() * CELL**2)
    return [_Level(foot, area, 0.0, False), *(l for l in levels if l.indoors and l.height > foot)]


def _walked_and_area(ground: Ground, levels: list[_Level]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(K,) whether one can walk between levels and the one with the most floor, whether most of each lies above a
    floor that is walked on too, and (K,) m² to stand on."""
    columns, column = ground.columns, ground.column
    on = [np.abs(columns.floor - level.height) <= STEP for level in levels]
    area = np.array([free_area(columns.cells, column[here]) for here in on])
    standing = [here & columns.stand for here in on]
    main = int(np.argmax([level.free for level in levels]))
    reached = np.isin(ground.component, np.unique(ground.component[standing[main]])) & columns.stand
    walked = np.array([bool(reached[here].any()) for here in standing])
    walked[main] = True
    lowest = np.full(len(columns.start) - 1, np.inf)
    np.minimum.at(lowest, column[reached], columns.floor[reached])
    above = [
        bool((lowest[column[here]] < columns.floor[here] - STEP).mean() > 0.5) if here.any() else False
        for here in (x & reached for x in standing)
    ]
    return walked, np.array(above), area


def free_area(cells: Cells, column: np.ndarray) -> float:
    """m² of these columns that are free of others for half a person's width all around."""
    free = np.zeros(cells.nx * cells.ny, bool)
    free[column] = True
    plan = free.reshape(cells.nx, cells.ny)
    inner = scipy.ndimage.distance_transform_edt(plan) * CELL > BODY
    return float(inner.sum() * CELL**2)
