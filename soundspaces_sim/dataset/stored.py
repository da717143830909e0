"""Responses as the files of a dataset hold them: echograms and waveforms of pairs, and the table.

Light: neither the renderer nor the tracer is imported.
"""

from __future__ import annotations

from operator import index
from pathlib import Path
from typing import SupportsIndex

import numpy as np

from soundspaces_sim.core.errors import DatasetError, PairIndexError
from soundspaces_sim.dataset.format.manifest import Manifest, read_manifest
from soundspaces_sim.dataset.format.schema import Form
from soundspaces_sim.dataset.format.shard import Shard
from soundspaces_sim.dataset.format.table import concatenate_tables, shard_table
from soundspaces_sim.dataset.handles import ShardHandles
from soundspaces_sim.dataset.remote import Remote
from soundspaces_sim.echogram.echogram import Echogram


class StoredResponses:
    """The files of a finished dataset: a resource that opens them lazily. Raises `DatasetError`."""

    def __init__(self, where: str | Path) -> None:
        fetch = None
        if isinstance(where, str) and "://" in where:
            remote = Remote(where)
            where, fetch = remote.folder, remote.fetch
        self.path = Path(where)
        self.manifest: Manifest = read_manifest(self.path)
        if not self.manifest.complete:
            raise DatasetError(
                f"{self.path}: this dataset is not finished; run the same `make rirs` again to go on"
            )
        self.points = np.array(self.manifest.points, float).reshape(-1, 3)
        self.shards = ShardHandles(self.path, self.manifest, fetch)

    def close(self) -> None:
        """Close the files; the next read opens them again."""
        self.shards.close()

    def row(self, point: SupportsIndex, what: str) -> int:
        """The number of a point. Raises `PairIndexError` unless there is such a point."""
        try:
            row = index(point)
        except TypeError:
            raise PairIndexError(f"{what}: expected the number of a point, got {point!r}") from None
        if not 0 <= row < len(self.points):
            raise PairIndexError(
                f"{what} {row} is out of range: {self.path} has points 0 to {len(self.points) - 1}"
            )
        return row

    def echogram(self, s: SupportsIndex, l: SupportsIndex) -> Echogram:
        """The echogram of a pair. Raises `PairIndexError`, `DatasetError`."""
        s, l = self.row(s, "source"), self.row(l, "listener")
        if not self.shards.has("echogram"):
            raise DatasetError(
                f"{self.path} stores waveforms alone; build it with STORE=both for echograms"
            )
        return self.shards.echogram(s, l, lambda shard, i, j: shard.echogram(i, j))

    def measure_error(self, s: int, l: int) -> np.ndarray | None:
        """(M, bands) standard errors of `MEASURES` of a pair; None in datasets of older versions."""

        def read(shard: Shard, i: int, j: int) -> np.ndarray | None:
            found = shard.pairs.get("measure_error")
            return None if found is None else found[i, j]

        return self.shards.echogram(s, l, read)

    def has_waveforms(self, rate: int, renderer: str) -> bool:
        """Whether waveforms at this rate by this renderer are stored. Raises `DatasetError` if waveforms alone
        are stored, at another rate."""
        if not self.shards.has("waveform"):
            return False
        own = self.manifest.config.dataset
        if rate != own.rate and not self.shards.has("echogram"):
            raise DatasetError(
                f"{self.path} stores waveforms at {own.rate} Hz alone, {rate} Hz was asked for; resample them, "
                "or build the dataset with STORE=both"
            )
        return rate == own.rate and renderer == own.renderer

    def ambisonic(self, s: int, l: int) -> np.ndarray:
        """(9, n) the stored response of a pair."""
        return self.shards.waveform(s, l, lambda shard, i, j: shard.ambisonic(i, j))

    def binaural(self, s: int, l: int, headings_deg: np.ndarray) -> np.ndarray:
        """(k, 2, n) the stored responses of a pair, for k of the headings of the dataset."""
        return self.shards.waveform(
            s, l, lambda shard, i, j: np.stack([shard.binaural(i, j, h) for h in headings_deg])
        )

    def table(self, collocated: bool) -> np.ndarray:
        """One row per pair: see `RirDataset.table`."""
        form: Form = "echogram" if self.shards.has("echogram") else "waveform"
        return concatenate_tables(self.shards.of_every_shard(form, shard_table), collocated)
