"""The floor plan of a scene, cut at listener height: what maps are drawn on. It travels with a dataset."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from soundspaces_sim.errors import DatasetError
from soundspaces_sim.grid import Grid
from soundspaces_sim.materials import normalise_label
from soundspaces_sim.scene import Scene
from soundspaces_sim.walkable import footprints

NAME = "floorplan.hdf5"
_CELL = 0.05  # m
#: Labels that are no furniture: what rooms are made of, and what lies flat on the floor.
_STRUCTURE = frozenset(
    "floor wall ceiling mat rug carpet door window beam column pillar panel stair stairs railing handrail blinds "
    "curtain void lighting lamp vent pipe".split()
)


@dataclass(frozen=True)
class FloorPlan:
    """`walls`: per storey (n, 4) m, x0 y0 x1 y1 of what the mesh leaves at listener height. `furniture`:
    (storeys, nx, ny) row of `labels` seen from there, looking down, -1 for none; cell (i, j) begins at
    `origin` + `cell` * (i, j).
    """

    walls: tuple[np.ndarray, ...]
    furniture: np.ndarray
    labels: tuple[str, ...]
    origin: np.ndarray
    cell: float = _CELL


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


def encode_floorplan(plan: FloorPlan) -> bytes:
    """The plan as an HDF5 file."""
    with h5py.File("plan in memory", "w", driver="core", backing_store=False) as file:
        for i, walls in enumerate(plan.walls):
            file.create_dataset(f"walls_{i}", data=walls, compression="gzip", shuffle=True)
        file.create_dataset("furniture", data=plan.furniture, compression="gzip", shuffle=True)
        file.attrs["labels"] = "\n".join(plan.labels)
        file.attrs["origin"] = plan.origin
        file.attrs["cell"] = plan.cell
        file.flush()
        return bytes(file.id.get_file_image())


def read_floorplan(folder: Path) -> FloorPlan:
    """The plan beside a dataset's shards. Raises `DatasetError`."""
    try:
        with h5py.File(folder / NAME, "r") as file:
            count = len(file["furniture"])
            labels = tuple(str(file.attrs["labels"]).split("\n"))
            return FloorPlan(
                tuple(file[f"walls_{i}"][...] for i in range(count)), file["furniture"][...], labels,
                np.array(file.attrs["origin"]), float(file.attrs["cell"]),
            )  # fmt: skip
    except (OSError, KeyError) as error:
        raise DatasetError(
            f"{folder / NAME}: no floor plan of this dataset ({error}); plot its scene instead"
        ) from error
