"""Making the floor plan of a scene, cut at listener height: what maps are drawn on."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from soundspaces_sim.layout.records import FloorPlan, Grid
from soundspaces_sim.scene.heightfield import Cells, footprints
from soundspaces_sim.scene.labels import normalise_label
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.section import section

_CELL = 0.05  # m
_CUT = 0.5  # m between cuts of a storey whose floor is not level
_PIECE = 0.25  # m
_MOST_CELLS = 4e6  # of all storeys; larger scenes have larger cells
#: Labels that are no furniture: what rooms are made of, and what lies flat on the floor.
_STRUCTURE = frozenset(
    "floor wall ceiling mat rug carpet door window beam column pillar panel stair stairs railing handrail blinds "
    "curtain void lighting lamp vent pipe".split()
)


def make_floorplan(scene: Scene, grid: Grid) -> FloorPlan:
    """The plan of every storey of a grid."""
    low, high = scene.bounds[:, :2]
    cell = max(_CELL, float(np.sqrt(len(grid.floors) * np.prod(high - low) / _MOST_CELLS)))
    cell = max(cell, float((high - low).max()) / _MOST_CELLS**0.5)
    nx, ny = (int(n) for n in np.ceil((high - low) / cell).astype(int) + 1)
    cells = Cells(float(low[0]), float(low[1]), cell, nx, ny)
    furniture = [normalise_label(label) not in _STRUCTURE for label in scene.labels]
    chosen = np.array([*furniture, False])[scene.face_label]
    walls, maps = [], []
    heights = grid.floors.astype(float) + grid.height
    for storey, height in enumerate(heights):
        points = grid.points[grid.storey == storey]
        cut = _section(scene, points, float(height))
        walls.append(np.round(cut, 3).astype(np.float32))
        corners, labels = scene.corners[chosen], scene.face_label[chosen]
        top = float(points[:, 2].max(initial=height))
        maps.append(
            footprints(corners, labels, cells, height - grid.height + 0.05, top).astype(np.int16)
        )
    return FloorPlan(tuple(walls), np.stack(maps), scene.labels, low.copy(), cell, heights)


def _section(scene: Scene, points: np.ndarray, height: float) -> np.ndarray:
    """(n, 4) m, x0 y0 x1 y1 of what the mesh leaves at the `height` of a storey's points or, where points stand
    higher or lower, of cuts at their heights, each where they are the nearest."""
    if len(points) == 0 or np.ptp([height, *points[:, 2]]) < _CUT:
        return section(scene.corners, height)
    low, high = points[:, 2].min() - height, points[:, 2].max() - height
    cuts = height + _CUT * np.arange(round(low / _CUT), round(high / _CUT) + 1)
    tree, found = cKDTree(points[:, :2]), []
    nearest = np.abs(points[:, 2, None] - cuts).argmin(axis=1)
    for k, cut in enumerate(cuts):
        pieces = _split(section(scene.corners, float(cut)))
        _, near = tree.query(0.5 * (pieces[:, :2] + pieces[:, 2:]))
        found.append(pieces[nearest[near] == k])
    return np.concatenate(found)


def _split(segments: np.ndarray) -> np.ndarray:
    """Segments (n, 4) in pieces of at most `_PIECE` m."""
    a, b = segments[:, :2], segments[:, 2:]
    count = np.maximum(np.ceil(np.linalg.norm(b - a, axis=1) / _PIECE).astype(int), 1)
    row = np.repeat(np.arange(len(segments)), count)
    part = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    at = (part / count[row])[:, None], ((part + 1) / count[row])[:, None]
    return np.concatenate([a[row] + (b - a)[row] * t for t in at], axis=1)
