"""Signals of sources that sound for a while, block by block."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import scipy.fft

from soundspaces_sim.parts import BlockCache

_KEPT = BlockCache(50_000_000)


class Blocks(Protocol):
    """How a renderer cuts time: samples of a block, of a window, and of its transform."""

    block: int
    window: int
    size: int


class SourceSignal:
    """A clip that is repeated from sample `onset` to before `offset`; silence else. `name` tells clips apart."""

    def __init__(self, name: str, clip: np.ndarray, onset: int, offset: int) -> None:
        self.name, self.clip, self.onset, self.offset = name, clip, onset, offset

    def samples(self, first: int, count: int) -> np.ndarray:
        """(count,) float32 from sample `first` on, which may be before the clip begins."""
        out = np.zeros(count, np.float32)
        low, high = max(first, self.onset), min(first + count, self.offset)
        if low < high:
            at = np.arange(low - self.onset, high - self.onset) % len(self.clip)
            out[low - first : high - first] = self.clip[at]
        return out

    def has_begun(self, number: int, blocks: Blocks) -> bool:
        """Whether the window of block `number` goes beyond the onset."""
        return (number - 1) * blocks.block + blocks.window > self.onset

    def spectrum(self, number: int, blocks: Blocks) -> np.ndarray | None:
        """(F,) complex64 of the window of block `number`, which begins a block earlier; None if it is silent."""
        first = (number - 1) * blocks.block
        last = first + blocks.window
        if not self.has_begun(number, blocks) or first >= self.offset:
            return None
        whole = self.onset <= first and last <= self.offset
        at = (first - self.onset) % len(self.clip) if whole else first
        ends = () if whole else (self.onset, self.offset)
        key = (self.name, id(self.clip), at, ends, blocks.block, blocks.size)
        made = _KEPT.get(
            key,
            lambda: {
                "x": _transform(self.samples(first, blocks.window), blocks.size),
                "clip": self.clip,
            },
        )
        return made["x"]


def _transform(samples: np.ndarray, size: int) -> np.ndarray:
    return np.asarray(scipy.fft.rfft(samples, size), np.complex64)
