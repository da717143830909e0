"""Whether arrays from the disk cache (`disk_cache`) may be given to kernels, which check no index: types,
shapes, finite numbers, and every index within what it indexes.

Expected arrays are written as ``"f8 P 3"``: type and shape, where letters are sizes, the same wherever they stand.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def like(record: Any, expected: Mapping[str, str], sizes: dict[str, int]) -> bool:
    """Whether the arrays of a record have these types and shapes and are finite; sizes that are not known yet are
    added to `sizes`."""
    for name, text in expected.items():
        array, (kind, *shape) = getattr(record, name), text.split()
        if array.dtype.str[1:] != kind or array.ndim != len(shape):
            return False
        for letter, size in zip(shape, array.shape, strict=True):
            if (int(letter) if letter.isdigit() else sizes.setdefault(letter, size)) != size:
                return False
        if kind[0] == "f" and not np.isfinite(array).all():
            return False
    return True


def within(array: np.ndarray, least: float, most: float) -> bool:
    return bool(((array >= least) & (array <= most)).all())


def are_starts(start: np.ndarray, count: int) -> bool:
    """Whether these are the first rows of consecutive groups of `count` rows, and the end of the last."""
    return bool(start[0] == 0 and start[-1] == count and (np.diff(start) >= 0).all())
