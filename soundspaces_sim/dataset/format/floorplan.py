"""The floor plan beside a dataset's shards: maps are drawn on it where the scene is not at hand."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.io.hdf5 import (
    attribute,
    create_hdf5,
    numbers,
    open_hdf5,
    plain_dataset,
    put_text,
    read_numbers,
    written,
)
from soundspaces_sim.layout.records import FloorPlan

NAME = "floorplan.hdf5"
_REMEDY = "plot the dataset's scene instead"


def encode_floorplan(plan: FloorPlan) -> bytes:
    """The plan as an HDF5 file."""
    content = io.BytesIO()
    with create_hdf5(content) as file:
        for i, walls in enumerate(plan.walls):
            file.create_dataset(f"walls_{i}", data=walls, compression="gzip", shuffle=True).id.close()
        file.create_dataset(
            "furniture", data=plan.furniture, compression="gzip", shuffle=True
        ).id.close()
        put_text(file, "labels", "\n".join(plan.labels))
        file.attrs["origin"] = plan.origin
        file.attrs["cell"] = plan.cell
        if plan.heights is not None:
            file.attrs["heights"] = plan.heights
    return written(content, "floor plan")


def read_floorplan(folder: Path) -> FloorPlan:
    """The plan beside a dataset's shards. Raises `DatasetError`."""
    path = folder / NAME
    with open_hdf5(path, DatasetError, "floor plan", _REMEDY, follow=False) as file:

        def read(name: str, dimensions: int) -> np.ndarray:
            item = plain_dataset(file, name, str(path), DatasetError, _REMEDY)
            values = read_numbers(item, ..., f"{path}: dataset '{name}'", DatasetError, _REMEDY)
            if values.ndim != dimensions or not np.isfinite(values).all():
                raise DatasetError(f"{path}: dataset '{name}' is no part of a floor plan; {_REMEDY}")
            return values

        furniture = read("furniture", 3)
        walls = tuple(read(f"walls_{i}", 2) for i in range(len(furniture)))
        names = str(attribute(file, "labels", str(path), DatasetError, _REMEDY) or "")
        cell = attribute(file, "cell", str(path), DatasetError, _REMEDY)
        origin = numbers(file, "origin", 2, str(path), DatasetError, _REMEDY)
        heights = None
        if "heights" in file.attrs:
            heights = numbers(file, "heights", len(walls), str(path), DatasetError, _REMEDY)
    labels = tuple(names.split("\n"))
    if any(w.shape[1] != 4 for w in walls) or furniture.dtype.kind not in "iu" or not walls:
        raise DatasetError(f"{path}: not a floor plan of this version; {_REMEDY}")
    if furniture.size and not (furniture.min() >= -1 and furniture.max() < len(labels)):
        raise DatasetError(f"{path}: furniture has labels that are not there; {_REMEDY}")
    if not np.isfinite(origin).all() or not isinstance(cell, float) or not 0.0 < cell < 1e3:
        raise DatasetError(f"{path}: the plan's origin or cell cannot be; {_REMEDY}")
    if heights is not None and not (np.isfinite(heights).all() and (np.diff(heights) > 0).all()):
        raise DatasetError(f"{path}: the storeys' heights cannot be; {_REMEDY}")
    return FloorPlan(walls, furniture, labels, origin, cell, heights)
