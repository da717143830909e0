"""Echograms of pairs as tensors on a device (extra ``torch``): the bytes of a whole dataset kept there, unpacked
pair by pair, or read from files when they are wanted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from soundspaces_sim import DatasetError, Echogram, RirDataset
from soundspaces_sim.parts import FAILED_PAIR as FAILED, EchogramShard, Shard
from soundspaces_torch.signals import EchogramBatch, fixed

_AFTER_S = 0.01  # of a response, after its last arrival: as `ambisonics.response_length`


class Kept(NamedTuple):
    """What `KeptEchograms` holds of all N² pairs, by source and listener."""

    peak: Tensor  # (N²,) float32
    energy: Tensor  # (N², bins, b) codes
    moments: Tensor  # (N², bins, b, 8) codes
    first: np.ndarray  # (N²,) row of the first arrival, the direct sound
    arrival_count: np.ndarray  # (N²,)
    delay: Tensor  # (rows,)
    arrivals: Tensor  # (rows, b)
    direction: Tensor  # (rows, 3)
    last: np.ndarray  # (N²,) s, end of the last arrival
    failed: np.ndarray  # (N²,)


def double(device: torch.device) -> torch.dtype:
    """The most precise numbers of a device."""
    return torch.float32 if device.type == "mps" else torch.float64


class KeptEchograms:
    """All echograms of a dataset in a device's memory, 9 bytes a bin and band; a resource."""

    def __init__(self, ds: RirDataset, device: torch.device) -> None:
        shards: list[dict[str, Any]] = ds.stored.shards.of_every_shard("echogram", _bytes_of)
        first = shards[0]
        self.time_edges: np.ndarray = first["time_edges"]
        for other in shards[1:]:
            if not np.array_equal(other["time_edges"], self.time_edges):
                raise DatasetError(
                    f"{ds.path}: shards have different time grids, {other['where']} first"
                )
        n = len(ds.points)
        whole: dict[str, np.ndarray] = {}
        for name in ("peak", "energy", "moments", "count", "first", "last", "failed"):
            whole[name] = np.empty((n, n, *first[name].shape[2:]), first[name].dtype)
        rows = 0
        for shard in shards:
            place = np.ix_(shard["source_index"], shard["listener_index"])
            for name, values in whole.items():
                values[place] = shard[name]
            whole["first"][place] += rows
            rows += len(shard["delay"])

        def all_pairs(name: str) -> np.ndarray:
            return whole[name].reshape(n * n, *whole[name].shape[2:])

        def every(name: str) -> Tensor:
            values = np.concatenate([s[name] for s in shards])
            if device.type == "mps" and values.dtype == np.float64:
                values = values.astype(np.float32)
            return torch.from_numpy(values).to(device)

        self.device, self._points = device, n
        self._level = torch.from_numpy(first["level"]).to(double(device)).to(device)
        self.kept = Kept(
            torch.from_numpy(all_pairs("peak")).to(device),
            torch.from_numpy(all_pairs("energy")).to(device),
            torch.from_numpy(all_pairs("moments")).to(device),
            all_pairs("first"),
            all_pairs("count"),
            every("delay"),
            every("arrivals"),
            every("direction"),
            all_pairs("last"),
            all_pairs("failed"),
        )

    @staticmethod
    def size(ds: RirDataset) -> int:
        """Bytes that it takes without arrivals."""
        bands = len(ds.manifest.config.simulation.bands) - 1
        bins = ds.stored.shards.echogram(0, 0, lambda shard, *_: len(shard.time_edges) - 1)
        return len(ds) * bins * bands * 9

    def batch(self, pairs: np.ndarray) -> tuple[EchogramBatch, np.ndarray]:
        """Echograms of (k, 2) pairs, and when their last arrivals end, (k,) s. Raises `DatasetError`."""
        kept = self.kept
        rows = pairs[:, 0] * self._points + pairs[:, 1]
        failed = kept.failed[rows]
        if failed.any():
            s, l = pairs[int(np.argmax(failed))].tolist()
            raise DatasetError(f"the simulation of pair ({s}, {l}) failed")
        at = torch.from_numpy(rows).to(self.device)
        level = self._level[kept.energy[at].int()]
        energy = (kept.peak[at].to(level.dtype)[:, None, None] * level).float()  # (k, bins, b)
        moments = kept.moments[at] * (energy / torch.full_like(energy, 127.0))[..., None]
        table = torch.cat([energy[..., None], moments], -1).permute(0, 2, 3, 1)
        count = kept.arrival_count[rows]
        column = np.arange(max(int(count.max(initial=1)), 1))
        there = column < count[:, None]
        place = torch.from_numpy(np.where(there, kept.first[rows][:, None] + column, 0)).to(self.device)
        inside = torch.from_numpy(there).to(self.device)[..., None]
        arrivals = kept.arrivals[place] * inside
        delay = kept.delay[place] * inside[..., 0]
        return EchogramBatch(table, delay, arrivals, kept.direction[place]), kept.last[rows]


def _bytes_of(shard: Shard) -> dict[str, Any]:
    """What is kept of a shard. Delays and arrivals have the direct sound of each pair before its early ones."""
    assert isinstance(shard, EchogramShard)
    offset = shard.sources[:, None] - shard.listeners[None]
    distance = np.linalg.norm(offset, axis=2)
    towards = np.divide(
        offset, distance[..., None], out=np.zeros_like(offset), where=distance[..., None] > 0.0
    )
    start, shape = shard.early_start, offset.shape[:2]
    direct = np.asarray(shard.direct_energy, float).reshape(-1, shard.direct_energy.shape[2])
    heard = np.asarray((direct > 0.0).any(axis=1))
    late = np.where(heard, distance.ravel() / shard.speed_of_sound, 0.0)
    before = start[:-1]
    delay = np.insert(np.asarray(shard.early["delay"], float), before, late)
    first = start[:-1] + np.arange(len(start) - 1)
    return {
        "where": shard.where,
        "time_edges": shard.time_edges,
        "source_index": shard.source_index,
        "listener_index": shard.listener_index,
        "level": shard.level,
        "peak": np.asarray(shard.energy_peak, np.float32),
        "energy": shard.read("energy"),
        "moments": shard.read("moments"),
        "first": first.reshape(shape),
        "count": (np.diff(start) + 1).reshape(shape),
        "delay": fixed(delay),
        "arrivals": np.insert(
            np.asarray(shard.early["energy"], np.float32),
            before,
            np.where(heard[:, None], direct, 0.0),
            axis=0,
        ).astype(np.float32),
        "direction": np.insert(
            np.asarray(shard.early["direction"], float), before, towards.reshape(-1, 3), axis=0
        ),
        "last": (np.maximum.reduceat(delay, first) + _AFTER_S).reshape(shape),
        "failed": shard.pairs["status"] == FAILED,
    }


def as_batch(echograms: Sequence[Echogram], device: torch.device) -> tuple[EchogramBatch, np.ndarray]:
    """Echograms on a device, and when their last arrivals end, (k,) s. The first arrival is the direct sound, of no
    energy where there is none."""
    bands = len(echograms[0].bands) - 1
    most = 1 + max(len(e.early) for e in echograms)
    delay, energy = np.zeros((len(echograms), most)), np.zeros((len(echograms), most, bands), np.float32)
    direction = np.zeros((len(echograms), most, 3))
    for k, echogram in enumerate(echograms):
        first, early = echogram.direct, echogram.early
        if first is not None:
            delay[k, 0], energy[k, 0], direction[k, 0] = first.delay, first.energy, first.direction
        n = 1 + len(early)
        delay[k, 1:n], energy[k, 1:n], direction[k, 1:n] = early.delay, early.energy, early.direction
    last = delay.max(axis=1) + _AFTER_S
    table = np.stack([e.energy for e in echograms]).astype(np.float32).transpose(0, 3, 2, 1)
    kind = np.float32 if device.type == "mps" else np.float64
    arrays = np.ascontiguousarray(table), fixed(delay), energy, direction.astype(kind)
    return EchogramBatch(*(torch.from_numpy(x).to(device) for x in arrays)), last
