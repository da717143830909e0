"""`RoomStream` as PyTorch wants it (extra ``torch``): iterable-style, any number of workers, fork or spawn."""

from __future__ import annotations

from collections.abc import Iterator

from torch.utils.data import IterableDataset, get_worker_info

from soundspaces_sim.build.room_stream import Item, RoomStream


class TorchRoomStream(IterableDataset[Item]):
    """Items of a stream, for ``DataLoader(…, batch_size=None)`` or a `collate_fn` of one's own, as rooms differ in
    talkers, microphones and length. Workers take rooms in turn; none makes one of another's.

    `set_epoch` is seen by workers that start after it: with ``persistent_workers`` give the loader a new stream.
    """

    def __init__(self, stream: RoomStream) -> None:
        self.stream = stream

    def set_epoch(self, epoch: int) -> None:
        """Other rooms from the next iteration on."""
        self.stream.set_epoch(epoch)

    def __iter__(self) -> Iterator[Item]:
        info = get_worker_info()
        return iter(self.stream if info is None else self.stream.share(info.id, info.num_workers))
