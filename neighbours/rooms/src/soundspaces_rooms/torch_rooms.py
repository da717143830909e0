"""`RoomStream` as PyTorch wants it (extra ``torch``): iterable-style, any number of workers, fork or spawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info

from soundspaces_rooms.room_stream import Item, RoomStream


class TorchRoomStream(IterableDataset[Item]):
    """Items of a stream: of each room alone with ``DataLoader(…, batch_size=None)``, or of several, stacked, with
    ``DataLoader(…, batch_size=8, collate_fn=TorchRoomStream.collate_fn)``. Workers take rooms in turn; none makes
    one of another's.

    `set_epoch` is seen by workers that start after it: with ``persistent_workers`` give the loader a new stream.
    """

    def __init__(self, stream: RoomStream) -> None:
        self.stream = stream

    def set_epoch(self, epoch: int) -> None:
        """Other rooms from the next iteration on."""
        self.stream.set_epoch(epoch)

    @staticmethod
    def collate_fn(items: Sequence[Item]) -> dict[str, Any]:
        """Items of several rooms, which differ in talkers, microphones and length, as one: arrays are tensors with
        an axis for the rooms before the others. Where a room has less, signals are zero and numbers NaN;
        ``source_count``, ``microphone_count`` and ``length`` (rooms,) say how much of ``rir`` each has. Texts are
        lists."""
        out: dict[str, Any] = {}
        for name in items[0]:
            values = [item[name] for item in items]
            out[name] = (
                values if isinstance(values[0], str) else torch.from_numpy(_stacked(name, values))
            )
        sizes = np.array([item["rir"].shape for item in items])
        for k, name in enumerate(("source_count", "microphone_count", "length")):
            out[name] = torch.from_numpy(sizes[:, k].copy())
        return out

    def __iter__(self) -> Iterator[Item]:
        info = get_worker_info()
        return iter(self.stream if info is None else self.stream.share(info.id, info.num_workers))


#: Items that are samples: of a talker or a microphone that a room has not, zeros.
_SIGNALS = ("rir", "direct", "early", "mixture", "reverberant", "early_speech", "direct_speech")


def _stacked(name: str, values: Sequence[Any]) -> np.ndarray:
    """(rooms, …) arrays or numbers, filled up to the largest."""
    arrays = [np.asarray(value) for value in values]
    shape = np.max([a.shape for a in arrays], axis=0, initial=0).astype(int) if arrays[0].ndim else ()
    missing = 0.0 if name in _SIGNALS or arrays[0].dtype.kind in "iu" else np.nan
    out = np.full((len(arrays), *shape), missing, arrays[0].dtype)
    for row, array in zip(out if arrays[0].ndim else out[:, None], arrays, strict=True):
        row[tuple(slice(n) for n in array.shape) or 0] = array
    return out
