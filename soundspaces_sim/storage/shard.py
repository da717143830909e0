"""One shard: some sources × some listeners in one HDF5 file, whole or absent.

What both forms share: making a file's bytes, opening it, and reading it with errors a user understands.
A shard holds no clock times: the same content is the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from soundspaces_sim.base.errors import DatasetError
from soundspaces_sim.echo.echogram import Echograms
from soundspaces_sim.echo.measures import echograms_measures
from soundspaces_sim.storage import schema
from soundspaces_sim.storage.schema import Form

OK, SILENT, FAILED = 0, 1, 2
STORAGE: dict[str, Any] = {
    "shuffle": True, "compression": "gzip", "compression_opts": 4, "fletcher32": True,
}  # fmt: skip


def pair_fields(echoes: Echograms, geodesic: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Datasets about each pair that every shard has; `geodesic` (S, L) m."""
    counts = np.diff(echoes.early_start).reshape(echoes.shape)
    energy = echoes.energy[:, :, :, 0]
    silent = (energy.max(axis=(2, 3)) <= 0.0) & (echoes.direct_energy.max(axis=2) <= 0.0) & (counts == 0)
    failed = ~np.isfinite(echoes.energy).all(axis=(2, 3, 4))
    measures = echograms_measures(echoes)
    return {
        "walls": np.minimum(echoes.walls, 65535).astype(np.uint16),
        "relative_error": np.minimum(echoes.relative_error, 6e4).astype(np.float16),
        "status": np.where(failed, FAILED, np.where(silent, SILENT, OK)).astype(np.uint8),
        "geodesic": np.asarray(
            np.full(echoes.shape, np.nan) if geodesic is None else geodesic, np.float32
        ),
        **{name: values.astype(np.float32) for name, values in measures.items()},
    }


def identity_fields(
    echoes: Echograms, source_index: np.ndarray, listener_index: np.ndarray
) -> dict[str, np.ndarray]:
    """Datasets that say which pairs a shard holds."""
    return {
        "source_index": source_index.astype(np.int64),
        "listener_index": listener_index.astype(np.int64),
        "source_position": echoes.sources,
        "listener_position": echoes.listeners,
        "band_edges": np.array(echoes.bands),
    }


class ShardWriter:
    """An HDF5 file in memory; `finish` checks it against the schema and returns its bytes."""

    def __init__(self, form: Form, attributes: Mapping[str, Any]) -> None:
        self._form: Form = form
        self.file = h5py.File(f"{form} in memory", "w", driver="core", backing_store=False)
        for name, value in {**schema.fixed_attributes(form), **attributes}.items():
            self.file.attrs[name] = value

    def put(self, name: str, value: np.ndarray, pairwise: bool = False) -> None:
        """Add a dataset; `pairwise`: one chunk per pair, which is what a reader asks for."""
        if pairwise and value.size:
            chunks: Any = (1, 1, *value.shape[2:])
        else:
            chunks = True if value.size == 0 else value.shape
        self.file.create_dataset(name, data=value, chunks=chunks, maxshape=value.shape, **STORAGE)

    def finish(self) -> bytes:
        try:
            schema.check(self.file, "the shard that was to be written", self._form)
            self.file.flush()
            return bytes(self.file.id.get_file_image())
        finally:
            self.file.close()


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
            if "filter" in str(error) and "not" in str(error) and "available" in str(error):
                raise DatasetError(
                    f"{self.where}: dataset '{name}' needs an HDF5 filter that is not installed ({error}); "
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


def is_valid(path: Path, form: Form, key: str) -> bool:
    """True if `path` is a complete shard with this key, all of whose bytes can be read."""
    if not path.is_file():
        return False
    try:
        with h5py.File(path, "r") as file:
            version = schema.check(file, str(path), form)
            if file.attrs["key"] != key:
                return False
            for name in schema.schema(form, version)["datasets"]:
                file[name][...]  # reads every chunk, so that fletcher32 sees it
    except (OSError, DatasetError):
        return False
    return True
