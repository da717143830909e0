"""Responses as the files of a dataset hold them: echograms and waveforms of pairs, and the table.

Light: neither the renderer nor the tracer is imported.
"""

from __future__ import annotations

from functools import cached_property
from operator import index
from pathlib import Path
from typing import SupportsIndex

import numpy as np

from soundspaces_sim.core.errors import DatasetError, PairIndexError
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.manifest import Manifest, read_manifest, rebuild_command
from soundspaces_sim.dataset.format.schema import Form
from soundspaces_sim.dataset.format.shard import Shard
from soundspaces_sim.dataset.format.table import concatenate_tables, shard_table
from soundspaces_sim.dataset.handles import ShardHandles
from soundspaces_sim.dataset.materials import (
    ChangeableMaterials,
    Furnishing,
    changeable,
    furnishing,
)
from soundspaces_sim.dataset.remote import Remote
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.low_response import LowResponse
from soundspaces_sim.echogram.reflection_counts import MaterialGroups
from soundspaces_sim.echogram.refurnish import Materials

_PAIRS = 8  # whose counts decide the ranges of materials


class StoredResponses:
    """The files of a finished dataset: a resource that opens them lazily. Raises `DatasetError`."""

    def __init__(
        self, where: str | Path, materials: Materials | None = None, force: bool = False
    ) -> None:
        fetch = None
        self._remote = isinstance(where, str) and "://" in where
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
        self._furnishing = self.furnishing(materials, force)

    @property
    def plain(self) -> bool:
        """Whether another process that opens `path` reads the same: files on this machine, materials as stored."""
        return not self._remote and self._furnishing is None

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

    def furnishing(self, materials: Materials | None, force: bool) -> Furnishing | None:
        """What `materials` ask of this dataset, checked. Raises `DatasetError`, `MaterialError`."""
        if materials is None:
            return None
        bands = tuple(self.manifest.config.simulation.bands)
        command = rebuild_command(self.manifest)
        return furnishing(self.groups, bands, self.path, command, materials, force)

    @property
    def groups(self) -> MaterialGroups | None:
        """The materials whose reflections were counted; None if none were."""
        if not self.shards.has("echogram"):
            return None
        return self.shards.echogram(0, 0, lambda shard, *_: shard.counts.groups)

    @cached_property
    def materials(self) -> ChangeableMaterials:
        """Those of which the absorption can be chosen, with ranges that hold for some pairs."""
        groups = self.groups
        if groups is None:
            return ChangeableMaterials()
        n = len(self.points)
        pairs = {
            (k % n, (7 * k + 1) % n) for k in np.linspace(0, n - 1, min(n, _PAIRS)).astype(int).tolist()
        }
        found = [
            self.shards.echogram(s, l, lambda shard, i, j: shard.echogram(i, j, counts=True))
            for s, l in sorted(pairs)
        ]
        return changeable(groups, found)

    def echogram(
        self,
        s: SupportsIndex,
        l: SupportsIndex,
        materials: Materials | None = None,
        force: bool = False,
    ) -> Echogram:
        """The echogram of a pair; with `materials`, these instead of those of the dataset. Raises `PairIndexError`,
        `DatasetError`, `MaterialError`."""
        s, l = self.row(s, "source"), self.row(l, "listener")
        if not self.shards.has("echogram"):
            raise DatasetError(
                f"{self.path} stores waveforms alone; build it with STORE=both for echograms"
            )
        chosen = self._furnishing if materials is None else self.furnishing(materials, force)
        if chosen is None:
            return self.shards.echogram(s, l, lambda shard, i, j: shard.echogram(i, j))
        return self.shards.echogram(s, l, chosen.echogram)

    def counted(self, s: SupportsIndex, l: SupportsIndex) -> Echogram:
        """The echogram of a pair as simulated, with its counts of reflections. Raises `PairIndexError`,
        `DatasetError` if there are none."""
        s, l = self.row(s, "source"), self.row(l, "listener")
        if self.groups is None:
            raise DatasetError(
                f"{self.path}: holds no counts of reflections; make it anew with `[simulation.materials] enabled = "
                "true`"
            )
        return self.shards.echogram(s, l, lambda shard, i, j: shard.echogram(i, j, counts=True))

    def low(self, s: SupportsIndex, l: SupportsIndex) -> LowResponse:
        """The waves of a pair. Raises `PairIndexError`, `DatasetError` if there are none."""
        s, l = self.row(s, "source"), self.row(l, "listener")
        found = None
        if self.shards.has("echogram"):
            found = self.shards.echogram(s, l, lambda shard, i, j: shard.low.of_pair(i, j))
        if found is None:
            raise DatasetError(
                f'{self.path}: holds no waves; make it anew with `[simulation.low] method = "waves"`'
            )
        return found

    def measure_error(self, s: int, l: int) -> np.ndarray:
        """(M, bands) standard errors of `MEASURES` of a pair."""
        return self.shards.echogram(s, l, lambda shard, i, j: shard.pairs["measure_error"][i, j])

    def has_waveforms(self, rate: int, renderer: str) -> bool:
        """Whether waveforms at this rate by this renderer are stored. Raises `DatasetError` if waveforms alone
        are stored, at another rate."""
        if not self.shards.has("waveform") or self._furnishing is not None:
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

        def rows(shard: Shard) -> np.ndarray:
            if self._furnishing is None or not isinstance(shard, EchogramShard):
                return shard_table(shard)
            return shard_table(shard, self._furnishing.columns(shard))

        return concatenate_tables(self.shards.of_every_shard(form, rows), collocated)
