"""Echogram shards: quantised energies and moments on the time grid, and discrete arrivals."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from soundspaces_sim.echo.echogram import Arrivals, Echogram, direct_arrival
from soundspaces_sim.storage.shard import Shard


class EchogramShard(Shard):
    """An open echogram shard."""

    def __init__(self, source: Path | bytes) -> None:
        super().__init__(source, "echogram")
        self.time_edges = self.read("time_edges")
        self._c = float(self.file.attrs["speed_of_sound"])
        codes = np.arange(256.0)
        self._level = np.where(
            codes > 0.0, 10.0 ** ((codes - 255.0) * float(self.file.attrs["energy_step_db"]) / 10.0), 0.0
        )
        self._table = {
            name: self.read(name)
            for name in (
                "energy_peak", "direct_energy", "early_start", "early_delay", "early_energy",
                "early_direction", "early_planes",
            )
        }  # fmt: skip

    @property
    def latest(self) -> float:
        """When the last energy of any pair arrives, s; not before the end of the time grid."""
        farthest = np.linalg.norm(self.sources[:, None] - self.listeners[None], axis=2).max()
        early = self._table["early_delay"].max(initial=0.0)
        return max(float(self.time_edges[-1]), float(early), float(farthest) / self._c)

    def echogram(self, s: int, l: int) -> Echogram:
        """The echogram of local source `s` and listener `l`."""
        self.check_pair(s, l)
        t = self._table
        energy = (t["energy_peak"][s, l] * self._level[self.read("energy", (s, l))]).astype(np.float32)
        table = np.empty((len(energy), 9, energy.shape[1]), np.float32)
        table[:, 0] = energy
        ratio = self.read("moments", (s, l)).transpose(0, 2, 1)
        np.multiply(ratio, (energy / np.float32(127.0))[:, None], out=table[:, 1:])
        offset = self.sources[s] - self.listeners[l]
        direct = direct_arrival(
            offset, float(np.linalg.norm(offset)), t["direct_energy"][s, l].astype(float), self._c
        )
        pair = s * len(self.listeners) + l
        rows = slice(int(t["early_start"][pair]), int(t["early_start"][pair + 1]))
        early = Arrivals(
            t["early_delay"][rows], t["early_energy"][rows].astype(float),
            t["early_direction"][rows].astype(float), t["early_planes"][rows].astype(np.int64),
        )  # fmt: skip
        return Echogram(
            self.bands, self.time_edges, table, direct, early,
            self.pairs["relative_error"][s, l].astype(np.float32), bool(self.pairs["walls"][s, l] == 0),
        )  # fmt: skip
