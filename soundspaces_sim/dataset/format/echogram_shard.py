"""Echogram shards: quantised energies and moments on the time grid, and discrete arrivals."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.limits import LONGEST
from soundspaces_sim.core.numerics.air import Air
from soundspaces_sim.dataset.format.counts import StoredCounts
from soundspaces_sim.dataset.format.low import StoredLow
from soundspaces_sim.dataset.format.schema import REBUILD
from soundspaces_sim.dataset.format.shard import Shard
from soundspaces_sim.echogram.echogram import KINDS, Arrivals, Echogram, direct_arrival

#: Of early arrivals: the row (S L + 1,) of each pair's first, columns of real numbers, columns of whole ones.
_EARLY = "start", "delay", "energy", "direction", "planes", "kind", "edges", "groups"


class EchogramShard(Shard):
    """An open echogram shard. `air`: see `Echogram`; the manifest knows it."""

    def __init__(self, source: Path | bytes, air: Air | None = None) -> None:
        self._air = air
        super().__init__(source, "echogram")

    def _read_own(self) -> None:
        self.time_edges = self.read("time_edges")
        self.speed_of_sound = float(self.attribute("speed_of_sound"))
        step = float(self.attribute("energy_step_db"))
        if not 0.0 < step <= 10.0 or not 0.0 < self.speed_of_sound < 1e5:
            raise DatasetError(
                f"{self.where}: {step} dB per step or {self.speed_of_sound} m/s cannot be; {REBUILD}"
            )
        codes = np.arange(256.0)
        self.level = np.where(codes > 0.0, 10.0 ** ((codes - 255.0) * step / 10.0), 0.0)
        self.energy_peak = self.read("energy_peak")  # (S, L) energy of the largest code
        self.direct_energy = self.read("direct_energy")  # (S, L, b)
        self.early = {name: self.read(f"early_{name}") for name in _EARLY}
        self.early_start = self.early["start"]
        if self.version < 8:  # it has room for two reflections
            groups = self.early["groups"]
            self.early["groups"] = np.pad(groups, ((0, 0), (0, 1)), constant_values=-1)
        self.counts = StoredCounts(self)
        self.low = StoredLow(self)
        self._check_arrivals()

    def _check_arrivals(self) -> None:
        early, edges = self.early, self.time_edges
        within = np.isfinite(edges) & (edges >= 0.0) & (edges <= LONGEST)
        self.require(within, "time_edges", f"0 to {LONGEST:g} s")
        self.require((np.diff(edges) > 0.0) & (len(edges) > 1), "time_edges", "rising times")
        self.require_energies("energy_peak", self.energy_peak)
        self.require_energies("direct_energy", self.direct_energy)
        self.require_energies("early_energy", early["energy"], of_pairs=False)
        delay, start = early["delay"], early["start"]
        self.require((delay >= 0.0) & (delay <= LONGEST), "early_delay", f"0 to {LONGEST:g} s")
        rows = start[0] == 0 and start[-1] == len(delay)
        self.require((np.diff(start) >= 0) & rows, "early_start", f"rising rows from 0 to {len(delay)}")
        self.require(early["kind"] < len(KINDS), "early_kind", f"0 to {len(KINDS) - 1}")
        most = len(self.counts.groups.names) if self.counts.groups is not None else 0
        ok = (early["groups"] >= -1) & (early["groups"] < most)
        self.require(ok, "early_groups", f"-1 to {most - 1}")
        self.require(np.abs(early["direction"]) <= 1.001, "early_direction", "unit vectors")
        expected = f"sound that arrives within {LONGEST:g} s"
        self.require(self.latest <= LONGEST, "source_position", expected)

    @property
    def latest(self) -> float:
        """When the last energy of any pair arrives, s; not before the end of the time grid."""
        farthest = np.linalg.norm(self.sources[:, None] - self.listeners[None], axis=2).max(initial=0.0)
        early = self.early["delay"].max(initial=0.0)
        return max(float(self.time_edges[-1]), float(early), float(farthest) / self.speed_of_sound)

    def echogram(self, s: int, l: int, counts: bool = False) -> Echogram:
        """The echogram of local source `s` and listener `l`; with `counts` of reflections, if there are any."""
        self.check_pair(s, l)
        energy = (self.energy_peak[s, l] * self.level[self.read("energy", (s, l))]).astype(np.float32)
        table = np.empty((len(energy), 9, energy.shape[1]), np.float32)
        table[:, 0] = energy
        ratio = self.read("moments", (s, l)).transpose(0, 2, 1)
        np.multiply(ratio, (energy / np.float32(127.0))[:, None], out=table[:, 1:])
        offset = self.sources[s] - self.listeners[l]
        distance, of_direct = float(np.linalg.norm(offset)), self.direct_energy[s, l].astype(float)
        direct = direct_arrival(offset, distance, of_direct, self.speed_of_sound)
        pair = s * len(self.listeners) + l
        rows = slice(int(self.early_start[pair]), int(self.early_start[pair + 1]))
        reals = (self.early[name][rows].astype(float) for name in _EARLY[1:4])
        early = Arrivals(*reals, *(self.early[name][rows].astype(np.int64) for name in _EARLY[4:]))
        return Echogram(
            self.bands,
            self.time_edges,
            table,
            direct,
            early,
            self.pairs["relative_error"][s, l].astype(np.float32),
            bool(self.pairs["walls"][s, l] == 0),
            air=self._air,
            counts=self.counts.of_pair(s, l) if counts else None,
            low=self.low.of_pair(s, l),
        )
