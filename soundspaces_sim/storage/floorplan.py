"""The floor plan beside a dataset's shards: maps are drawn on it where the scene is not at hand."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from soundspaces_sim.base.errors import DatasetError
from soundspaces_sim.places.records import FloorPlan

NAME = "floorplan.hdf5"


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
