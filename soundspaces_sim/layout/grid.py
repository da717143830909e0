"""Where sources and listeners stand: placement on a grid, and pruning.

The seed paper's rule ("Grid construction"): a regular square grid over the bounding box at a height
above the floor; a point is dropped if it lies outside, which is judged by how *closed* its
surroundings are, C = H / (R * B): R uniform rays are reflected diffusely up to B times and hit geometry
H times in all; and if the shortest of the R initial rays is shorter than d_min. By default the height is
above the floor under each point (`layout.ground`), and points inside solids are dropped
(`layout.reachability`).
"""

from __future__ import annotations

import logging

import msgspec
import numpy as np

from soundspaces_sim.core.config import GridConfig
from soundspaces_sim.core.errors import ConfigError, SceneError
from soundspaces_sim.layout.ground import flat_floors, floors_under
from soundspaces_sim.layout.reachability import reachable
from soundspaces_sim.layout.records import KEPT, OUTSIDE, TOO_CLOSE, UNREACHABLE, Grid
from soundspaces_sim.scene.enclosure import check_inside, closedness
from soundspaces_sim.scene.scene import Scene, check_scene
from soundspaces_sim.scene.storeys import find_ground, find_storeys

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


def grid_at(scene: Scene, points: np.ndarray, config: GridConfig | None = None) -> Grid:
    """A grid of given points (N, 3), none of which is dropped. Raises `PointError` for points outside.

    Each belongs to the highest floor that lies below it; `spacing` and `height` are the config's.
    """
    config = config or GridConfig()
    check_inside(scene, points, "points")
    storeys = find_storeys(scene, config.height)
    floors = storeys.floors
    storey = np.maximum(np.searchsorted(floors, points[:, 2] - 0.5 * config.height, "right") - 1, 0)
    closed, clearance = closedness(scene, points, config.rays, config.bounces)
    kept = np.full(len(points), KEPT)
    return Grid(
        points, config.spacing, config.height, floors, storey, points, kept, closed, clearance, storeys
    )
