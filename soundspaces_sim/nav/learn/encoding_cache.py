"""Pictures that agents meet more than once, kept and encoded once.

Who bumps, turns back or crosses another's way sees and hears what was seen and heard before: of the steps of a
rollout in furnished flats a fifth to a third have views of their own, and two fifths to two thirds spectrograms.
"""

from __future__ import annotations

import torch
from torch import Tensor

from soundspaces_sim.nav.learn.net import Encoder


class EncodingCache:
    """The distinct pictures that an encoder has met, in the order in which they came, and what it makes of them as
    long as it does not learn."""

    def __init__(self, encoder: Encoder) -> None:
        self._encoder = encoder
        self._numbers: dict[bytes, int] = {}
        self._features: list[Tensor] = []
        self._shape: torch.Size | None = None

    def encode(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """(n,) numbers of pictures (n, …) float32, alike to the bit where they are alike, and (n, features)."""
        self._shape = pictures.shape[1:]
        numbers: list[int] = []
        new: list[int] = []
        for row, picture in enumerate(pictures.numpy()):
            number = self._numbers.setdefault(picture.tobytes(), len(self._numbers))
            if number == len(self._features) + len(new):
                new.append(row)
            numbers.append(number)
        if new:
            self._features.extend(self._encoder(pictures[new]).unbind())
        return torch.tensor(numbers), torch.stack([self._features[number] for number in numbers])

    def pictures(self) -> Tensor:
        """(m, …) float32, by number."""
        assert self._shape is not None, "nothing was looked at"
        content = bytearray(b"".join(self._numbers))
        return torch.frombuffer(content, dtype=torch.float32).reshape(-1, *self._shape)
