"""Making the floor plan of a scene, cut at listener height: what maps are drawn on."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.places.records import FloorPlan, Grid
from soundspaces_sim.places.walkable import footprints
from soundspaces_sim.scene.materials import normalise_label
from soundspaces_sim.scene.scene import Scene

_CELL = 0.05  # m
#: Labels that are no furniture: what rooms are made of, and what lies flat on the floor.
_STRUCTURE = frozenset(
    "floor wall ceiling mat rug carpet door window beam column pillar panel stair stairs railing handrail blinds "
    "curtain void lighting lamp vent pipe".split()
)


def make_floorplan(scene: Scene, grid: Grid) -> FloorPlan:
    """The plan of every storey of a grid."""
    low, high = scene.bounds[:, :2]
    nx, ny = (int(n) for n in np.ceil((high - low) / _CELL).astype(int) + 1)
    furniture = [normalise_label(label) not in _STRUCTURE for label in scene.labels]
    chosen = np.array([*furniture, False])[scene.face_label]
    walls, maps = [], []
    for floor in grid.floors:
        height = float(floor) + grid.height
        walls.append(np.round(_cut(scene.corners, height), 3).astype(np.float32))
        maps.append(
            footprints(
                scene.corners[chosen], scene.face_label[chosen], float(low[0]), float(low[1]), _CELL, nx, ny,
                float(floor) + 0.05, height,
            ).astype(np.int16)
        )  # fmt: skip
    return FloorPlan(tuple(walls), np.stack(maps), scene.labels, low.copy())


def _cut(corners: np.ndarray, height: float) -> np.ndarray:
    """(n, 4) segments in which triangles (F, 3, 3) cross the plane z = height."""
    z = corners[:, :, 2] - height
    z = np.where(z == 0.0, 1e-9, z)
    below = z < 0.0
    crossing = below.any(axis=1) & ~below.all(axis=1)
    c, z, below = corners[crossing], z[crossing], below[crossing]
    lone = np.where(below.sum(axis=1) == 1, below.argmax(axis=1), (~below).argmax(axis=1))
    rows = np.arange(len(c))
    ends = []
    for step in (1, 2):
        other = (lone + step) % 3
        t = z[rows, lone] / (z[rows, lone] - z[rows, other])
        ends.append(c[rows, lone, :2] + t[:, None] * (c[rows, other, :2] - c[rows, lone, :2]))
    return np.concatenate(ends, axis=1)
