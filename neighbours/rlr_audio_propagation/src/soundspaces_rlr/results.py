"""The part of `Context` that hands out what was simulated."""

from __future__ import annotations

import operator
from pathlib import Path

import numpy as np

from soundspaces_rlr import output
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.records import Config


class Results:
    """Responses of the last simulation, as arrays and files."""

    config: Config

    def get_listener_count(self) -> int:
        """Number of listeners."""
        raise NotImplementedError

    def get_source_count(self) -> int:
        """Number of sources."""
        raise NotImplementedError

    def __init__(self) -> None:
        self._responses: list[list[np.ndarray]] = []  # [listener][source] (C, n)

    def get_ir_count(self) -> int:
        """Number of pairs that were simulated."""
        return sum(len(row) for row in self._responses)

    def get_ir_channel_count(self, listener_index: int, source_index: int) -> int:
        """Channels of a pair's response; 0 if it was not simulated."""
        pair = self._find(listener_index, source_index)
        return 0 if pair is None else len(pair)

    def get_ir_sample_count(self, listener_index: int, source_index: int) -> int:
        """Samples of a pair's response; 0 if it was not simulated."""
        pair = self._find(listener_index, source_index)
        return 0 if pair is None else pair.shape[1]

    def get_ir_channel(self, listener_index: int, source_index: int, channel_index: int) -> np.ndarray:
        """(n,) float64 of one channel."""
        pair = self._pair(listener_index, source_index)
        channel = operator.index(channel_index)
        if not 0 <= channel < len(pair):
            raise RlrError(f"channel {channel} is not among the {len(pair)} of this response")
        return np.array(pair[channel])

    def get_listener_source_channel_audio(
        self, listener_index: int, source_index: int, channel_index: int
    ) -> np.ndarray:
        """(n,) float64 of one channel."""
        return self.get_ir_channel(listener_index, source_index, channel_index)

    def get_listener_source_audio(self, listener_index: int, source_index: int) -> np.ndarray:
        """(C, n) float64 of one pair; (0,) before `simulate`, as the original has it."""
        if not self._responses and self._known(listener_index, source_index):
            return np.zeros(0)
        return np.array(self._pair(listener_index, source_index))

    def get_listener_audio(self, listener_index: int) -> np.ndarray:
        """(S, C, n) float64 of one listener, padded with zeros; (S, 0) before `simulate`."""
        if not self._responses and self._known(listener_index, None):
            return np.zeros((self.get_source_count(), 0))
        self._pair(listener_index, 0)
        return output.stack(self._responses[listener_index])

    def get_source_audio(self, source_index: int) -> np.ndarray:
        """(L, C, n) float64 of one source, padded with zeros; all listeners need as many channels. (L, 0) before
        `simulate`."""
        if not self._responses and self._known(None, source_index):
            return np.zeros((self.get_listener_count(), 0))
        self._pair(0, source_index)
        return output.stack([row[source_index] for row in self._responses])

    def get_audio(self) -> np.ndarray:
        """(L, S, C, n) float64, padded with zeros; all listeners need as many channels. (L, S, 0) before
        `simulate`, as the original has it."""
        if not self._responses:
            return np.zeros((self.get_listener_count(), self.get_source_count(), 0))
        flat = output.stack([pair for row in self._responses for pair in row])
        return flat.reshape(len(self._responses), -1, *flat.shape[1:])

    def get_channel_counts(self) -> list[list[int]]:
        """Channels of every pair, [listener][source]."""
        return [[len(pair) for pair in row] for row in self._responses]

    def write_ir_wave(self, listener_index: int, source_index: int, output_file_path: str) -> None:
        """Write a response as a float32 WAV file."""
        pair = self._pair(listener_index, source_index)
        output.write_wave(pair, round(self.config.sample_rate), Path(output_file_path))

    def write_ir_metrics(self, listener_index: int, source_index: int, output_file_path: str) -> None:
        """Write the level of each band in steps of 5 ms, dB, as a text table per channel, to
        `output_file_path` + " ch0 etc.txt" and so on."""
        pair = self._pair(listener_index, source_index)
        output.write_metrics(pair, self.config, output_file_path)

    def _known(self, listener: int | None, source: int | None) -> bool:
        """Whether there are a listener and a source of these indices."""
        return all(
            index is None or 0 <= operator.index(index) < count
            for index, count in (
                (listener, self.get_listener_count()),
                (source, self.get_source_count()),
            )
        )

    def _find(self, listener: int, source: int) -> np.ndarray | None:
        inside = 0 <= listener < len(self._responses) and 0 <= source < len(self._responses[listener])
        return self._responses[listener][source] if inside else None

    def _pair(self, listener: int, source: int) -> np.ndarray:
        pair = self._find(operator.index(listener), operator.index(source))
        if pair is None:
            sources = len(self._responses[0]) if self._responses else 0
            raise RlrError(
                f"no response for listener {listener} and source {source}: {len(self._responses)} listeners "
                f"and {sources} sources have been simulated; call simulate()"
            )
        return pair
