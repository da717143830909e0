"""Waveform shards: responses as samples, int16 with a scale per response, or float32.

They are made from an echogram shard, of some of its sources: what is stored is what a reader of the
echograms would render.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.base.errors import DatasetError
from soundspaces_sim.storage.echogram_shard import EchogramShard
from soundspaces_sim.storage.shard import STORAGE, Shard, ShardWriter

_LEAST_SCALE = 1e-37


def encode_waveforms(
    shard: EchogramShard,
    sources: slice,
    attributes: Mapping[str, Any],
    headings: tuple[float, ...],
    sample_format: str,
    render: Callable[[int], list[tuple[np.ndarray, np.ndarray]]],
) -> bytes:
    """The file of a waveform shard of an echogram shard's `sources`.

    `render(s)`: responses (9, n) and (H, 2, n) of the shard's source s at every listener, at
    attributes["rate"]; `headings` (H,) degrees; `sample_format`: int16 or float32.
    """
    writer = ShardWriter("waveform", attributes)
    positions = shard.sources[sources]
    shape = len(positions), len(shard.listeners)
    distance = np.linalg.norm(positions[:, None] - shard.listeners[None], axis=2)
    onset = distance / float(attributes["speed_of_sound"])
    samples = math.ceil((shard.latest + 0.01) * attributes["rate"])
    writer.put("source_index", shard.read("source_index")[sources])
    writer.put("source_position", positions)
    for name in ("listener_index", "listener_position", "band_edges"):
        writer.put(name, shard.read(name))
    for name, values in shard.pairs.items():
        writer.put(name, values[sources])
    writer.put("onset", onset.astype(np.float32))
    writer.put("headings", np.array(headings, float))

    kinds = {"ambisonic": (9, samples), "binaural": (len(headings), 2, samples)}
    scale = {name: np.ones(shape, np.float32) for name in kinds}
    length = np.zeros(shape, np.int32)
    for name, tail in kinds.items():
        chunks: Any = (1, 1, *tail) if 0 not in tail else True
        writer.file.create_dataset(name, (*shape, *tail), sample_format, chunks=chunks, **STORAGE)
    for i, s in enumerate(range(*sources.indices(len(shard.sources)))):
        for j, responses in enumerate(render(s)):
            length[i, j] = responses[0].shape[-1]
            for (name, tail), response in zip(kinds.items(), responses, strict=True):
                if response.size == 0:
                    continue
                padded = np.zeros(tail, np.float32)
                padded[..., : response.shape[-1]] = response
                if sample_format == "int16":
                    scale[name][i, j] = max(float(np.abs(padded).max()) / 32767.0, _LEAST_SCALE)
                    padded = np.rint(padded / scale[name][i, j])
                writer.file[name][i, j] = padded.astype(sample_format)
    for name, factors in scale.items():
        writer.put(f"{name}_scale", factors)
    writer.put("length", length)
    return writer.finish()


class WaveformShard(Shard):
    """An open waveform shard."""

    def __init__(self, source: Path | bytes) -> None:
        super().__init__(source, "waveform")
        self.rate = int(self.file.attrs["rate"])
        self.headings = tuple(float(h) for h in self.read("headings"))
        self._length = self.read("length")
        self._scale = {name: self.read(f"{name}_scale") for name in ("ambisonic", "binaural")}

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
        return np.asarray(samples * self._scale[name][s, l], np.float32)
