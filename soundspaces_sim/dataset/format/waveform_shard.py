"""Waveform shards: responses as samples, int16 with a scale per response, or float32."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.dataset.format.shard import Shard


class WaveformShard(Shard):
    """An open waveform shard."""

    def __init__(self, source: Path | bytes) -> None:
        super().__init__(source, "waveform")

    def _read_own(self) -> None:
        self.rate = int(self.attribute("rate"))
        self.headings = tuple(float(h) for h in self.read("headings"))
        self._length = self.read("length")
        self._scale = {name: self.read(f"{name}_scale") for name in ("ambisonic", "binaural")}
        longest = self.file["ambisonic"].shape[-1]
        within = (self._length >= 0) & (self._length <= longest)
        self.require(within, "length", f"0 to {longest} samples")
        for name, scale in self._scale.items():
            self.require(np.isfinite(scale) & (scale > 0.0), f"{name}_scale", "positive numbers")
        self.require(np.isfinite(self.headings), "headings", "degrees")

    def ambisonic(self, s: int, l: int) -> np.ndarray:
        """(9, n) float32 response of local source `s` and listener `l`."""
        return self._samples("ambisonic", s, l, (slice(None),))

    def binaural(self, s: int, l: int, heading_deg: float) -> np.ndarray:
        """(2, n) float32 at a stored heading. Raises `DatasetError` if it is not stored."""
        if heading_deg % 360.0 not in self.headings:
            raise DatasetError(
                f"{self.where}: heading {heading_deg} is not among those stored, {self.headings}"
            )
        return self._samples("binaural", s, l, (self.headings.index(heading_deg % 360.0), slice(None)))

    def _samples(self, name: str, s: int, l: int, where: tuple[Any, ...]) -> np.ndarray:
        self.check_pair(s, l)
        samples = self.read(name, (s, l, *where, slice(int(self._length[s, l]))))
        self.require(np.isfinite(samples), name, "finite samples")
        return np.asarray(samples * self._scale[name][s, l], np.float32)
