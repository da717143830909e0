"""Where sources and listeners stand: placement on a grid, and pruning.

The seed paper's rule ("Grid construction"): a regular square grid over the bounding box at a height
above the floor; a point is dropped if it lies outside, which is judged by how *closed* its
surroundings are, C = H / (R * B): R uniform rays are reflected diffusely up to B times and hit geometry
H times in all; and if the shortest of the R initial rays is shorter than d_min. By default the height is
above the floor under each point (below), and points inside solids are dropped
(`layout.reachability`).
"""

from __future__ import annotations

import logging
from typing import NamedTuple

import msgspec
import numpy as np
import scipy
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from soundspaces_sim.core.config import GridConfig
from soundspaces_sim.core.errors import ConfigError, SceneError
from soundspaces_sim.layout.reachability import reachable, sees
from soundspaces_sim.layout.records import KEPT, OUTSIDE, TOO_CLOSE, UNREACHABLE, Grid
from soundspaces_sim.scene.enclosure import check_inside, closedness
from soundspaces_sim.scene.rays.diffuse_walk import drop
from soundspaces_sim.scene.scene import Scene, check_scene
from soundspaces_sim.scene.storeys import (
    BODY,
    CELL,
    STEP,
    TIER,
    Ground,
    Storeys,
    find_ground,
    find_storeys,
    free_area,
)
from soundspaces_sim.scene.walkable import standable

# The floor under every place of a storey, which may slope and have steps, stages and balconies.
#
# Where people stand is a height field over the cells of `scene.walkable`: the floors that one can walk onto from
# a storey's level, and platforms large enough to be one (a stage whose steps the mesh lacks). Where a person has
# no room, along walls and on low furniture, the field is that of the nearest place on foot where one has; under
# other furniture the floor goes on as it is nearby. What is narrower than a person (a shoe, a door sill) is no
# floor: the field is opened (morphology) by a person's width, which leaves slopes and stairs as they are. A
# point's floor is then the surface nearest to the field straight below it.

_PLATFORM = 4.0  # m² that are free for a person, from which on a platform is a floor
_ROOM = 1.0  # m², the least that one can walk about in
_LEVEL = 0.02  # m; rugs and the like are no other floor
_NEAR = 1.5 * STEP  # m, of the field
_SURFACES = 6  # looked at below a place
_SAMPLES = 64


class Places(NamedTuple):
    """`row` (n,) of the places asked for, `storey` (n,) and `floor` (n,) m: by place, then from below."""

    row: np.ndarray
    storey: np.ndarray
    floor: np.ndarray


def flat_floors(storeys: Storeys, count: int) -> Places:
    """Every storey's one height at `count` places: the seed paper's slices."""
    levels = len(storeys.floors)
    storey = np.tile(np.arange(levels), count)
    return Places(np.repeat(np.arange(count), levels), storey, storeys.floors[storey])


def floors_under(
    scene: Scene, ground: Ground, storeys: Storeys, places: np.ndarray, height: float
) -> Places:
    """The floors under `height` m of headroom at places (P, 2) m. The lowest storey goes on everywhere, others
    where there is something to stand on."""
    storey = _storey_of(storeys, ground.columns.floor)
    used = _walked(ground, storeys)
    used |= _platforms(scene, ground, used, storey, height)
    cells = ground.columns.cells
    at = np.floor((places - [cells.x0, cells.y0]) / cells.size).astype(np.int64)
    i, j = (np.clip(at[:, k], 0, n - 1) for k, n in ((0, cells.nx), (1, cells.ny)))
    base = _standing_height(ground, used)
    found = []
    for s, level in enumerate(storeys.floors):
        here = used & (storey == s)
        rank = _rank(ground, here)
        for layer in range(max(int(rank[here].max(initial=0)), 0) + 1):
            chosen = here & (rank == layer)
            field = _field(ground, base, chosen, level)
            beside = _beside(ground, chosen)[i, j]
            rows = np.arange(len(places)) if layer == 0 else np.flatnonzero(beside)
            guess = field[i[rows], j[rows]]
            floor, lies_on, below = _surface(scene, places[rows], guess, beside[rows])
            floor[np.abs(floor - level) <= _LEVEL] = level
            kept = lies_on
            if layer == 0:
                kept = lies_on | (s == 0) | np.isneginf(below)
            found.append((rows[kept], np.full(kept.sum(), s), floor[kept], lies_on[kept]))
    row, of, floor, sure = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    order = np.lexsort((floor, of, row))
    row, of, floor, sure = row[order], of[order], floor[order], sure[order]
    # A floor that goes on unseen ends where another one takes its headroom.
    above = np.append((row[1:] == row[:-1]) & sure[1:] & (floor[1:] < floor[:-1] + height), False)
    kept = sure | ~above
    order = np.lexsort((of, floor, row))  # a floor that two storeys reach is one, of the lower
    again = (row[order][1:] == row[order][:-1]) & (np.diff(floor[order]) <= _LEVEL)
    kept[order[1:][again]] = False
    return Places(row[kept], of[kept], floor[kept])


def _storey_of(storeys: Storeys, floor: np.ndarray) -> np.ndarray:
    """The storey that floors (k,) m belong to: the highest that does not begin above them."""
    return np.maximum(np.searchsorted(storeys.floors, floor + STEP, "right") - 1, 0)


def _walked(ground: Ground, storeys: Storeys) -> np.ndarray:
    """(k,) what one can walk onto from the level of a storey; insides of furniture are too small to walk in."""
    floor, stand = ground.columns.floor, ground.columns.stand
    begun = (np.abs(floor[:, None] - storeys.floors).min(axis=1) <= STEP) & stand
    large = np.bincount(ground.component[stand], minlength=len(floor)) * CELL**2 >= _ROOM
    reached = np.isin(ground.component, np.unique(ground.component[begun]))
    return reached & stand & large[ground.component]


def _platforms(
    scene: Scene, ground: Ground, used: np.ndarray, storey: np.ndarray, height: float
) -> np.ndarray:
    """(k,) floors of indoor platforms that nobody can walk onto, within `height` of the floor around, and closed
    below: a table is open."""
    columns, cells = ground.columns, ground.columns.cells
    out = np.zeros(len(used), bool)
    left = np.flatnonzero(columns.stand & ~used)
    sizes = np.bincount(ground.component[left], minlength=1)
    for component in np.flatnonzero(sizes * CELL**2 >= _PLATFORM):
        rows = left[ground.component[left] == component]
        around = np.flatnonzero(used & (storey == np.median(storey[rows])))
        large = free_area(cells, ground.column[rows]) >= _PLATFORM
        if not large or len(around) == 0 or columns.sky[rows].mean() > 0.5:
            continue
        few = rows[np.linspace(0, len(rows) - 1, min(len(rows), _SAMPLES)).astype(int)]
        places, beside = _middles(ground, few), _middles(ground, around)
        _, near = cKDTree(beside[:, :2]).query(places[:, :2])
        rise = places[:, 2] - beside[near, 2]
        under, over = places.copy(), beside[near]
        under[:, 2] = over[:, 2] = 0.5 * (places[:, 2] + beside[near, 2])
        seen = sees(scene, under, over[:, None])[:, 0] & (rise > 0.0)
        out[rows] = np.abs(np.median(rise)) <= height and seen.mean() < 0.5
    return out


def _middles(ground: Ground, rows: np.ndarray) -> np.ndarray:
    """(n, 3) m, the middles of floors."""
    cells = ground.columns.cells
    middles = cells.middles(*np.divmod(ground.column[rows], cells.ny))
    return np.column_stack([*middles, ground.columns.floor[rows]])


def _standing_height(ground: Ground, used: np.ndarray) -> np.ndarray:
    """(k,) m, of the used floors: that of the place nearest on foot where a person has room, which is where all
    floor within half a person's width lies within two steps."""
    out = ground.columns.floor.astype(float)
    roomy = np.flatnonzero(used & standable(ground.columns, BODY, 2.0 * STEP))
    if len(roomy):
        _, _, source = dijkstra(
            ground.steps, directed=False, indices=roomy, min_only=True, return_predecessors=True
        )
        reached = used & (source >= 0)
        out[reached] = out[source[reached]]
    return out


def _rank(ground: Ground, here: np.ndarray) -> np.ndarray:
    """(k,) how many of the chosen floors lie below each in its column."""
    before = np.concatenate([[0], np.cumsum(here)])
    return before[:-1] - before[ground.columns.start[ground.column]]


def _beside(ground: Ground, chosen: np.ndarray) -> np.ndarray:
    """(nx, ny) cells of the chosen floors, and those next to them, where a wall or an edge leaves no room to
    stand."""
    cells = ground.columns.cells
    plan = np.zeros(cells.nx * cells.ny, bool)
    plan[ground.column[chosen]] = True
    return scipy.ndimage.binary_dilation(
        plan.reshape(cells.nx, cells.ny), np.ones((3, 3), bool), iterations=2
    )


def _field(ground: Ground, base: np.ndarray, chosen: np.ndarray, level: float) -> np.ndarray:
    """(nx, ny) m, heights `base` (k,) of the chosen floors, at most one per column, opened; elsewhere that of the
    nearest, or `level` if there is none."""
    cells = ground.columns.cells
    height = np.full((cells.nx, cells.ny), level)
    known = np.zeros((cells.nx, cells.ny), bool)
    height.ravel()[ground.column[chosen]] = base[chosen]
    known.ravel()[ground.column[chosen]] = True
    if not known.any():
        return height
    reach = round(BODY / CELL)
    size = (2 * reach + 1,) * 2
    lower = scipy.ndimage.grey_erosion(np.where(known, height, np.inf), size, mode="nearest")
    opened = scipy.ndimage.grey_dilation(np.where(known, lower, -np.inf), size, mode="nearest")
    for _ in range(reach):  # gives corners of platforms back
        grown = scipy.ndimage.grey_dilation(np.where(known, opened, -np.inf), (3, 3), mode="nearest")
        opened = np.minimum(grown, height)
    nearest = scipy.ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return opened[tuple(nearest)]


def _surface(
    scene: Scene, places: np.ndarray, guess: np.ndarray, beside: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of places (n, 2) m whose floor is about at `guess` (n,): the height of the surface nearest to it, the first
    within a tier below it where a place is `beside` (n,) its floor and none is near, or the guess; whether there is
    such a surface; and the height of the first one from there on down."""
    start = np.column_stack([places, guess + _NEAR]) - scene.center
    best, off = guess.copy(), np.full(len(guess), np.inf)
    first = below = drop(scene.geometry, start) + scene.center[2]
    for _ in range(_SURFACES):
        distance = np.abs(below - guess)
        nearer = distance < np.minimum(off, _NEAR + 1e-6)
        best[nearer], off[nearer] = below[nearer], distance[nearer]
        start[:, 2] = np.where(np.isfinite(below), below - scene.center[2] - 1e-3, start[:, 2])
        below = drop(scene.geometry, start) + scene.center[2]
    # A cell at an edge is as high as the next tier.
    edge = beside & np.isinf(off) & (first <= guess) & (first >= guess - TIER)
    best[edge], off[edge] = first[edge], guess[edge] - first[edge]
    return best, np.isfinite(off), first


MOST_CANDIDATES = 250_000  # of a grid: 250 x 250 m at 0.5 m
_FEW = 0.2  # share of the candidates that survive in a sound scene
_log = logging.getLogger(__name__)


def make_grid(scene: Scene, spacing: float | None = None, config: GridConfig | None = None) -> Grid:
    """Place and prune points on every storey; `spacing` in m overrides the config's.

    Raises `SceneError` if no point survives, saying why and what to change (a warning says it if few do), and
    `ConfigError` if the spacing makes more than `MOST_CANDIDATES` candidates.
    """
    check_scene(scene)
    config = config or GridConfig()
    if spacing is not None:
        config = msgspec.structs.replace(config, spacing=spacing)
    low, high = scene.bounds
    # Cells of the grid tile the box, so points lie half a cell inside and centred.
    counts = np.maximum((high - low)[:2] / config.spacing + 1e-9, 1.0).astype(np.int64)
    _check_count(scene, config.spacing, counts, 1)
    axes = []
    for axis, count in enumerate(counts.tolist()):
        margin = 0.5 * (high[axis] - low[axis] - (count - 1) * config.spacing)
        axes.append(np.round(low[axis] + margin + np.arange(count) * config.spacing, 6))
    ground = find_ground(scene, config.height)
    storeys = find_storeys(scene, config.height, ground)
    floors = storeys.floors
    if ground is None and config.follow_floor:
        _log.warning(
            "%s: the scene is too large to follow its floors: points stand above one height per storey",
            scene.name,
        )
    for reason in storeys.left_out:
        _log.info("%s: %s", scene.name, reason)
    _check_count(scene, config.spacing, counts, len(floors))
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    if config.follow_floor and ground is not None:
        found = floors_under(scene, ground, storeys, places, config.height)
    else:
        found = flat_floors(storeys, len(places))
    storey = found.storey
    candidates = np.column_stack([places[found.row], np.round(found.floor + config.height, 6)]) + 0.0
    closed, clearance = closedness(scene, candidates, config.rays, config.bounces)
    status = np.full(len(candidates), KEPT)
    status[closed < config.min_closedness] = OUTSIDE
    status[(status == KEPT) & (clearance < config.min_distance)] = TOO_CLOSE
    if config.reachable:
        kept = np.flatnonzero(status == KEPT)
        status[kept[~reachable(scene, candidates[kept], config.height)]] = UNREACHABLE
    kept = status == KEPT
    grid = Grid(
        np.ascontiguousarray(candidates[kept]),
        config.spacing,
        config.height,
        floors,
        storey[kept],
        candidates,
        status,
        closed,
        clearance,
        storeys,
    )
    if not kept.any():
        raise SceneError(f"{scene.name}: none {pruning_text(grid, config)}")
    if is_sparse(grid):
        _log.warning("%s: only %d %s", scene.name, len(grid), pruning_text(grid, config))
    return grid


def is_sparse(grid: Grid) -> bool:
    """Whether so few candidates survived that something may be wrong with the scene or the settings."""
    return len(grid) < _FEW * len(grid.candidates)


def pruning_text(grid: Grid, config: GridConfig) -> str:
    """What became of a grid's candidates, and what to do if it is not what was meant."""
    status = grid.status
    outside = grid.closedness[status == OUTSIDE]
    seen = (
        f" (closed-ness at most {outside.max():.2f}, needed {config.min_closedness})"
        if len(outside)
        else ""
    )
    return (
        f"of {len(status)} grid points {grid.height} m above the floor at "
        f"{', '.join(f'{f:.2f}' for f in grid.floors)} m survived: "
        f"{(status == OUTSIDE).sum()} lie outside{seen}, {(status == TOO_CLOSE).sum()} are closer than "
        f"{config.min_distance} m to a surface, {(status == UNREACHABLE).sum()} are inside something solid. "
        "Check the unit and up axis (--unit, --up), or set grid.min_closedness lower for open scenes (0.1 "
        "for patios) or a smaller spacing"
    )


def _check_count(scene: Scene, spacing: float, counts: np.ndarray, storeys: int) -> None:
    """Raise `ConfigError` before a grid of too many candidates is made."""
    total = float(np.prod(counts.astype(float))) * storeys
    if total > MOST_CANDIDATES:
        size = scene.bounds[1] - scene.bounds[0]
        coarser = spacing * (total / MOST_CANDIDATES) ** 0.5
        raise ConfigError(
            f"grid.spacing: {spacing} m over {size[0]:.5g} x {size[1]:.5g} m on {storeys} storey(s) makes "
            f"{total:,.0f} grid points, where {MOST_CANDIDATES:,} are the most; take {coarser:.2g} m or more "
            "(--spacing), or check the scene's unit (--unit)"
        )


def grid_at(scene: Scene, points: np.ndarray, config: GridConfig) -> Grid:
    """A grid of given points (N, 3), none of which is dropped. Raises `PointError` for points outside.

    Each belongs to the highest floor that lies below it; `spacing` and `height` are the config's.
    """
    check_inside(scene, points, "points")
    storeys = find_storeys(scene, config.height)
    floors = storeys.floors
    storey = np.maximum(np.searchsorted(floors, points[:, 2] - 0.5 * config.height, "right") - 1, 0)
    closed, clearance = closedness(scene, points, config.rays, config.bounces)
    kept = np.full(len(points), KEPT)
    return Grid(
        points, config.spacing, config.height, floors, storey, points, kept, closed, clearance, storeys
    )
