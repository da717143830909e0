"""What an encoder makes of observations, by their numbers in a `StateTable`: each is encoded once.

While an encoder does not learn, what it makes of a picture is the same for ever: whole blocks of states are encoded
together, always the same ones, so that the order in which they are met changes no bit. While it learns, an update
keeps the pictures that it meets, and encodes those anew in every minibatch.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from soundspaces_agents.learn.state_table import StateTable


class Encodings:
    """Of one sensor, on one device. `learning`: whether the encoder learns."""

    def __init__(self, sensor: str, encoder: nn.Module, table: StateTable, device: torch.device) -> None:
        self.sensor, self.table, self.device = sensor, table, device
        self._encoder = encoder
        self.begin(learning=False)

    def begin(self, learning: bool) -> None:
        """Forget: the encoder is another one, or learns from now on."""
        self.learning = learning
        self._row = np.full(0, -1)
        self._features: list[Tensor] = []
        self._pictures: list[Tensor] = []
        self._count = 0

    def of(self, numbers: np.ndarray) -> Tensor:
        """(n, features) of observations by number, without gradients."""
        self._grow()
        missing = np.unique(numbers[self._row[numbers] < 0])
        if len(missing):
            for block in [missing] if self.learning else self._blocks_of(missing):
                self._encode(block)
        if len(self._features) > 1:
            self._features = [torch.cat(self._features)]
        return self._features[0][torch.from_numpy(self._row[numbers])]

    def pictures(self, numbers: Tensor) -> tuple[Tensor, Tensor]:
        """The distinct observations (m, …) of numbers (…) that were met since `begin`, and which each is (…)."""
        if len(self._pictures) > 1:
            self._pictures = [torch.cat(self._pictures)]
        rows, at = torch.unique(torch.from_numpy(self._row)[numbers.cpu()], return_inverse=True)
        return self._pictures[0][rows].to(self.device), at.to(self.device)

    def _grow(self) -> None:
        more = self.table.size(self.sensor) - len(self._row)
        if more:
            self._row = np.concatenate([self._row, np.full(more, -1)])

    def _blocks_of(self, missing: np.ndarray) -> list[np.ndarray]:
        wanted = np.zeros(len(self._row), bool)
        wanted[missing] = True
        return [block for block in self.table.blocks(self.sensor) if wanted[block].any()]

    @torch.no_grad()
    def _encode(self, block: np.ndarray) -> None:
        pictures = torch.from_numpy(self.table.observe(self.sensor, block))
        self._features.append(self._encoder(pictures.to(self.device)))
        if self.learning:
            self._pictures.append(pictures)
        self._row[block] = self._count + np.arange(len(block))
        self._count += len(block)
