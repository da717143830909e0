"""Echogram shards: quantised energies and moments on the time grid, and discrete arrivals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.echo.echogram import Arrivals, Echogram, Echograms, direct_arrival
from soundspaces_sim.storage.shard import Shard, ShardWriter, identity_fields, pair_fields

STEP_DB = 0.4
_LOWEST = 1  # code of the least energy that is kept: 254 steps below the peak


def encode_echograms(
    echoes: Echograms,
    source_index: np.ndarray,
    listener_index: np.ndarray,
    attributes: Mapping[str, Any],
    geodesic: np.ndarray | None = None,
) -> bytes:
    """The shard's file. Energies to `STEP_DB`, moment ratios to 1/127; `geodesic` (S, L) m."""
    energy = echoes.energy[:, :, :, 0]
    peak = energy.max(axis=(2, 3))
    safe = np.where(peak > 0.0, peak, 1.0)[:, :, None, None]
    with np.errstate(divide="ignore"):
        level = 10.0 * np.log10(energy / safe)
    code = np.where(energy > 0.0, np.rint(255.0 + level / STEP_DB), 0.0)
    code = np.where(code >= _LOWEST, code, 0.0).astype(np.uint8)
    ratio = np.divide(
        echoes.energy[:, :, :, 1:], energy[:, :, :, None], out=np.zeros_like(echoes.energy[:, :, :, 1:]),
        where=(code > 0)[:, :, :, None],
    )  # fmt: skip
    moments = np.rint(np.clip(ratio, -1.0, 1.0) * 127.0).astype(np.int8).transpose(0, 1, 2, 4, 3)

    writer = ShardWriter("echogram", {"energy_step_db": STEP_DB, **attributes})
    fields = {
        **identity_fields(echoes, source_index, listener_index),
        "time_edges": echoes.time_edges,
        "energy_peak": peak.astype(np.float32),
        "direct_energy": echoes.direct_energy.astype(np.float32),
        "early_start": echoes.early_start.astype(np.int64),
        "early_delay": echoes.early.delay,
        "early_energy": echoes.early.energy.astype(np.float32),
        "early_direction": echoes.early.direction.astype(np.float32),
        "early_planes": echoes.early.planes.astype(np.int16),
        **pair_fields(echoes, geodesic),
    }
    for name, value in fields.items():
        writer.put(name, value)
    writer.put("energy", code, pairwise=True)
    writer.put("moments", moments, pairwise=True)
    return writer.finish()


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
