"""One shard: some sources × some listeners in one HDF5 file, whole or absent.

What both forms share: opening a file, and reading it with errors a user understands. `writing` makes them.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from soundspaces_sim.base.errors import DatasetError
from soundspaces_sim.storage import schema
from soundspaces_sim.storage.schema import Form

OK, SILENT, FAILED = 0, 1, 2


def _missing_filters(dataset: h5py.Dataset) -> str:
    """Numbers of the filters in a dataset's pipeline that this HDF5 library lacks; empty if none.

    HDF5's own words for it vary: without a folder of plugins it says that it cannot open that folder.
    """
    pipeline = dataset.id.get_create_plist()
    numbers = [pipeline.get_filter(i)[0] for i in range(pipeline.get_nfilters())]
    return ", ".join(str(n) for n in numbers if not h5py.h5z.filter_avail(n))


class Shard:
    """An open shard of one form: a resource. `source` is a path, or the bytes of one.

    Raises `DatasetError` if it is missing or not what the schema says.
    """

    def __init__(self, source: Path | bytes, form: Form) -> None:
        self.where = str(source) if isinstance(source, Path) else "shard in memory"
        try:
            self.file = h5py.File(
                source if isinstance(source, Path) else io.BytesIO(source), "r", rdcc_nbytes=0
            )
        except OSError as error:
            raise DatasetError(
                f"{self.where}: cannot open this shard ({error}); run the same `make rirs` again to rebuild it"
            ) from error
        try:
            self.version = schema.check(self.file, self.where, form)
            self.bands = tuple(float(e) for e in self.read("band_edges"))
            self.sources = self.read("source_position")
            self.listeners = self.read("listener_position")
            self.pairs = {
                name: self.read(name)
                for name in ("status", "walls", "relative_error", "geodesic", "t30", "edt", "c50", "drr")
                if name in self.file
            }
        except BaseException:
            self.file.close()
            raise

    def read(self, name: str, where: Any = ...) -> np.ndarray:
        """A dataset or part of it. Raises `DatasetError` if its bytes are damaged or a filter is missing."""
        try:
            return np.asarray(self.file[name][where])
        except OSError as error:
            if missing := _missing_filters(self.file[name]):
                raise DatasetError(
                    f"{self.where}: dataset '{name}' needs an HDF5 filter that is not installed ({missing}); "
                    "`pip install hdf5plugin` and import it first"
                ) from error
            raise DatasetError(
                f"{self.where}: dataset '{name}' is damaged ({error}); delete the file and run the same "
                "`make rirs` again to rebuild it"
            ) from error

    def check_pair(self, s: int, l: int) -> None:
        """Raise `DatasetError` if the simulation of this pair failed."""
        if self.pairs["status"][s, l] == FAILED:
            raise DatasetError(f"{self.where}: the simulation of pair ({s}, {l}) failed")

    def close(self) -> None:
        self.file.close()


def is_valid(path: Path, form: Form, key: str, every_byte: bool = True) -> bool:
    """True if `path` is a complete shard with this key; with `every_byte`, one that can be read throughout."""
    if not path.is_file():
        return False
    try:
        with h5py.File(path, "r") as file:
            version = schema.check(file, str(path), form)
            if file.attrs["key"] != key:
                return False
            for name in schema.schema(form, version)["datasets"] if every_byte else ():
                file[name][...]  # reads every chunk, so that fletcher32 sees it
    except (OSError, DatasetError):
        return False
    return True
