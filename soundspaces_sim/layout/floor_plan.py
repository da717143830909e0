"""Making the floor plan of a scene, cut at listener height: what maps are drawn on."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.layout.records import FloorPlan, Grid
from soundspaces_sim.scene.heightfield import Cells, footprints
from soundspaces_sim.scene.labels import normalise_label
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.scene.section import section

_CELL = 0.05  # m
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
    for floor in grid.floors:
        height = float(floor) + grid.height
        walls.append(np.round(section(scene.corners, height), 3).astype(np.float32))
        corners, labels = scene.corners[chosen], scene.face_label[chosen]
        maps.append(footprints(corners, labels, cells, float(floor) + 0.05, height).astype(np.int16))
    return FloorPlan(tuple(walls), np.stack(maps), scene.labels, low.copy(), cell)
