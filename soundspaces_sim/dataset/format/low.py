"""Waves below an edge as echogram shards hold them: a byte per sample, to the largest one of its block.

Blocks are 40 ms at the default edge, so that what quantising adds decays as the sound does: 42 dB under it and
more. Pressure and velocity have peaks of their own: the pressure there and back is the same to the last bit.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.limits import LONGEST
from soundspaces_sim.dataset.format.schema import REBUILD
from soundspaces_sim.dataset.format.shard import Shard
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.low_response import CHANNELS, LowResponse, response_samples

_BLOCK = 16  # samples
_MOST = 127.0  # code of a block's largest sample
_HIGHEST = 1e5  # Hz, of an edge
_ROWS = np.array([0, 1, 1, 1])  # of the peaks, by channel


def low_fields(echoes: Echograms) -> tuple[float, np.ndarray, np.ndarray]:
    """The edge, Hz, 0 without waves; codes and peaks of all pairs, empty without."""
    low, edge = echoes.low, echoes.low_edge
    if low is None or edge is None:
        none = np.empty((*echoes.shape, CHANNELS, 0), np.int8)
        return 0.0, none, np.empty((*echoes.shape, 2, 0), np.float32)
    count = low.shape[3]
    blocks = -(-count // _BLOCK)
    padded = np.zeros((*low.shape[:3], blocks * _BLOCK), np.float32)
    padded[..., :count] = low
    padded = padded.reshape(*low.shape[:3], blocks, _BLOCK)
    of_channel = np.abs(padded).max(axis=4)
    peak = np.stack([of_channel[:, :, 0], of_channel[:, :, 1:].max(axis=2)], axis=2)
    scale = np.where(peak > 0.0, peak, 1.0)[:, :, _ROWS, :, None]
    code = np.rint(_MOST * (padded / scale)).astype(np.int8)
    return float(edge), code.reshape(*low.shape[:3], -1)[..., :count], peak


def stored_bytes(samples: int) -> float:
    """About what a pair's waves of so many samples take, compressed."""
    return float(CHANNELS * samples + 2 * 4 * -(-samples // _BLOCK))


class StoredLow:
    """The waves of an open shard: None of any pair if there are none. Raises `DatasetError`."""

    def __init__(self, shard: Shard) -> None:
        self._shard = shard
        self.edge = float(shard.attribute("low_edge"))
        if not (self.edge == 0.0 or 0.1 <= self.edge <= _HIGHEST):
            raise DatasetError(
                f"{shard.where}: waves up to {self.edge} Hz, expected 0 (none) to {_HIGHEST:g}; {REBUILD}"
            )

    @cached_property
    def _peak(self) -> np.ndarray:
        peak = self._shard.read("low_peak")
        ok = np.isfinite(peak) & (peak >= 0.0)
        self._shard.require(ok, "low_peak", "finite numbers, none negative")
        return peak

    def of_pair(self, s: int, l: int) -> LowResponse | None:
        """Those of local source `s` and listener `l`."""
        if self.edge == 0.0:
            return None
        code, peak = self._shard.read("low", (s, l)), self._peak[s, l]
        count, most = code.shape[1], response_samples(self.edge, LONGEST)
        fits = 0 < count <= most and peak.shape[1] == -(-count // _BLOCK)
        self._shard.require(fits, "low", f"1 to {most} samples, {_BLOCK} to a peak")
        scale = np.repeat(peak[_ROWS], _BLOCK, axis=1)[:, :count]
        return LowResponse(self.edge, code * (scale / np.float32(_MOST)))
