"""A bounded memory of arrays: what was used longest ago goes first."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

import numpy as np

Block = dict[str, np.ndarray]
_Key = TypeVar("_Key", bound=Hashable)
_Kept = TypeVar("_Kept")


class LastUsed(Generic[_Key, _Kept]):
    """What was made last by key, at most `most` of it. Not shared between threads."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._kept: OrderedDict[_Key, _Kept] = OrderedDict()

    def get(self, key: _Key, make: Callable[[], _Kept]) -> _Kept:
        """What is kept under `key`; made, and kept, if there is nothing."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        made = self._kept[key] = make()
        if len(self._kept) > self.most:
            self._kept.popitem(last=False)
        return made


class BlockCache:
    """Records of arrays by key, at most `limit` bytes of them. Not shared between threads."""

    def __init__(self, limit: int) -> None:
        self.limit, self.size = int(limit), 0
        self._blocks: OrderedDict[Hashable, Block] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], Block]) -> Block:
        """What is kept under `key`; made, and kept, if there is nothing."""
        found = self._blocks.get(key)
        if found is not None:
            self._blocks.move_to_end(key)
            return found
        made = make()
        self._blocks[key] = made
        self.size += _bytes(made)
        while self.size > self.limit and len(self._blocks) > 1:
            self.size -= _bytes(self._blocks.popitem(last=False)[1])
        return made


def _bytes(block: Block) -> int:
    return sum(array.nbytes for array in block.values())
