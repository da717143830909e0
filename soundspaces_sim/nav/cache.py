"""A bounded memory of arrays: what was used longest ago goes first."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable

import numpy as np

Block = dict[str, np.ndarray]


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
