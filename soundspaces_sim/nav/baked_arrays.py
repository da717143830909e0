"""Observations computed ahead: arrays in an HDF5 file beside the dataset, mapped into memory."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.core.io.hdf5 import (
    attribute,
    create_hdf5,
    open_hdf5,
    plain_dataset,
    put_text,
    written,
)

VIEWS = "views.h5"  # depth pictures, beside a dataset
_REMEDY = "delete this file, then `soundspaces-sim nav bake` makes it anew"


def write_arrays(path: Path, belongs: Mapping[str, str], arrays: Mapping[str, np.ndarray]) -> Path:
    """Publish arrays; `belongs`: texts that say what they were made of. Returns the path."""
    content = io.BytesIO()
    with create_hdf5(content) as file:
        for name, text in belongs.items():
            put_text(file, name, text)
        for name, array in arrays.items():
            file.create_dataset(name, data=array)
    publish(path, written(content, path.name))
    return path


def read_arrays(
    path: Path, what: str, belongs: Mapping[str, str], shapes: Mapping[str, tuple[int | None, ...]]
) -> dict[str, np.ndarray] | None:
    """The arrays of a file of `write_arrays`, mapped into memory; None if there is no file.

    `what`: for messages; `belongs`: what the file must say that it was made of; `shapes`: of each array, None
    where any size will do. Raises `DatasetError`.
    """
    if not path.exists():
        return None
    with open_hdf5(path, DatasetError, f"file of {what}", _REMEDY, follow=False) as file:
        for name, text in belongs.items():
            if attribute(file, name, str(path), DatasetError, _REMEDY) != text:
                raise DatasetError(f"{path}: these are {what} of another {name}; {_REMEDY}")
        return {name: _mapped(file, path, name, shape) for name, shape in shapes.items()}


def _mapped(file: h5py.File, path: Path, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    item = plain_dataset(file, name, str(path), DatasetError, _REMEDY)
    offset = item.id.get_offset()
    wanted = len(item.shape) == len(shape) and all(
        n is None or n == m for n, m in zip(shape, item.shape, strict=True)
    )
    if not wanted or offset is None or offset + item.nbytes > file.id.get_filesize():
        raise DatasetError(
            f"{path}: dataset '{name}' has shape {item.shape}, expected {shape}, unpacked; {_REMEDY}"
        )
    assert math.prod(item.shape) > 0  # an offset is given to what has one
    # Rows of a plain array are taken several times as fast as those of a `memmap`.
    return np.asarray(np.memmap(path, item.dtype, "r", offset, item.shape))
