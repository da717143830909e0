"""One shard: some sources × some listeners in one HDF5 file, whole or absent.

What both forms share: opening a file, and reading it with errors a user understands. `writing` makes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.io.hdf5 import attribute, in_our_words, open_hdf5, read_numbers
from soundspaces_sim.dataset.format import schema
from soundspaces_sim.dataset.format.manifest import FARTHEST, ShardEntry
from soundspaces_sim.dataset.format.schema import REBUILD, Form
from soundspaces_sim.echogram.measure_names import MEASURES

OK, SILENT, FAILED = 0, 1, 2


class Shard:
    """An open shard of one form: a resource. `source` is a path, or the bytes of one.

    Raises `DatasetError` if it is missing or not what the schema says.
    """

    def __init__(self, source: Path | bytes, form: Form) -> None:
        self.where = str(source) if isinstance(source, Path) else "shard in memory"
        self.file = open_hdf5(source, DatasetError, "shard", REBUILD, follow=False)
        self._items: dict[str, h5py.Dataset] = {}
        try:
            self.version = schema.check(self.file, self.where, form)
            self.key = str(self.attribute("key"))
            self.bands = tuple(float(e) for e in self.read("band_edges"))
            self.sources, self.source_index = self.read("source_position"), self.read("source_index")
            self.listeners = self.read("listener_position")
            self.listener_index = self.read("listener_index")
            names = "status", "walls", "relative_error", "measure_error", "geodesic", *MEASURES
            self.pairs = {name: self.read(name) for name in names}
            self._check_values()
            self._read_own()
        except BaseException:
            self.file.close()
            raise

    def _read_own(self) -> None:
        """What this form has besides, read and checked."""

    def attribute(self, name: str) -> Any:
        """An attribute: one number, or a text. Raises `DatasetError`."""
        return attribute(self.file, name, self.where, DatasetError, REBUILD)

    def read(self, name: str, where: Any = ...) -> np.ndarray:
        """A dataset or part of it. Raises `DatasetError` if its bytes are damaged."""
        what = f"{self.where}: dataset '{name}'"
        item = self._items.get(name)
        if item is None:
            with in_our_words(what, DatasetError, REBUILD):
                item = self.file[name]
            if (
                where is not ...
            ):  # another pair's part is next, and to find it takes as long as to read it
                self._items[name] = item
        return read_numbers(item, where, what, DatasetError, REBUILD)

    def require(self, ok: Any, name: str, expected: str) -> None:
        """Raise `DatasetError` unless all of `ok` is true."""
        if not np.all(ok):
            raise DatasetError(
                f"{self.where}: dataset '{name}' holds values that cannot be, expected {expected}; {REBUILD}"
            )

    def require_energies(self, name: str, values: np.ndarray, of_pairs: bool = True) -> None:
        """Raise `DatasetError` unless energies are finite and not negative; those of failed pairs may be NaN."""
        ok = np.isfinite(values) & (values >= 0.0)
        if of_pairs:
            ok |= np.expand_dims(self.pairs["status"] == FAILED, tuple(range(2, values.ndim)))
        self.require(ok, name, "finite energies, none negative")

    def _check_values(self) -> None:
        bands = np.array(self.bands)
        self.require(np.isfinite(bands) & (bands >= 0.0), "band_edges", "frequencies in Hz")
        self.require((np.diff(bands) > 0.0) & (len(bands) > 1), "band_edges", "rising frequencies in Hz")
        for name, points in (("source_position", self.sources), ("listener_position", self.listeners)):
            self.require(np.abs(points) <= FARTHEST, name, f"metres, at most {FARTHEST:g}")
        self.require(self.pairs["status"] <= FAILED, "status", f"{OK}, {SILENT} or {FAILED}")
        for name in ("relative_error", "measure_error"):
            self.require(~(self.pairs[name] < 0.0), name, "none negative")
        self.require(~(self.pairs["geodesic"] < 0.0), "geodesic", "none negative")

    def check_identity(self, entry: ShardEntry, points: np.ndarray, bands: Sequence[float]) -> None:
        """Raise `DatasetError` unless this is the shard that an entry of a manifest names, of points (N, 3) and
        `bands`."""
        ends = (
            ("source", entry.sources, self.source_index, self.sources),
            ("listener", entry.listeners, self.listener_index, self.listeners),
        )
        for end, span, index, places in ends:
            if not np.array_equal(index, np.arange(*span)):
                raise DatasetError(
                    f"{self.where}: holds other {end}s than {span[0]} to {span[1] - 1}, which the manifest says; "
                    f"{REBUILD}"
                )
            if not np.array_equal(places, points[slice(*span)]):
                raise DatasetError(
                    f"{self.where}: its {end}s stand elsewhere than the manifest's points; {REBUILD}"
                )
        if self.bands != tuple(bands):
            raise DatasetError(
                f"{self.where}: has bands at {self.bands} Hz, the manifest at {tuple(bands)}; {REBUILD}"
            )
        if entry.key and self.key != entry.key:
            raise DatasetError(
                f"{self.where}: made from something else (key {self.key[:12]}, expected {entry.key[:12]}); "
                f"{REBUILD}"
            )

    def check_pair(self, s: int, l: int) -> None:
        """Raise `DatasetError` if the simulation of this pair failed."""
        if self.pairs["status"][s, l] == FAILED:
            raise DatasetError(f"{self.where}: the simulation of pair ({s}, {l}) failed")

    def close(self) -> None:
        self._items.clear()
        self.file.close()


def is_valid(path: Path, form: Form, key: str, every_byte: bool = True) -> bool:
    """True if `path` is a complete shard with this key; with `every_byte`, one that can be read throughout."""
    if not path.is_file():
        return False
    try:
        with open_hdf5(path, DatasetError, "shard", REBUILD, follow=False) as file:
            version = schema.check(file, str(path), form)
            if attribute(file, "key", str(path), DatasetError, REBUILD) != key:
                return False
            for name in schema.schema(form, version)["datasets"] if every_byte else ():
                what = f"{path}: dataset '{name}'"  # every chunk is read, so that fletcher32 sees it
                read_numbers(file[name], ..., what, DatasetError, REBUILD)
    except DatasetError:
        return False
    return True
