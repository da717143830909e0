"""The first-order reflections that image sources have given a tile, which diffraction attenuates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.transport.tile import Tile


class Reflections(NamedTuple):
    """The paths of a tile by one plane: rows start[k]:start[k + 1] are those of pair k = i * B + j."""

    start: np.ndarray  # (A * B + 1,)
    plane: np.ndarray  # (n,) ascending for a pair
    row: np.ndarray  # (n,) of the table of image sources


def no_reflections(pairs: int) -> Reflections:
    """Of so many pairs, none."""
    return Reflections(np.zeros(pairs + 1, np.int64), np.empty(0, np.int64), np.empty(0, np.int64))


def first_order_reflections(tile: Tile) -> Reflections:
    """What `image_source` has found with one plane."""
    found, pairs = tile.discrete.get("image_source"), tile.walls.size
    if found is None:
        return no_reflections(pairs)
    row = np.flatnonzero(found.planes[:, 1] < 0)
    row = row[np.lexsort((found.planes[row, 0], found.pair[row]))]
    start = np.searchsorted(found.pair[row], np.arange(pairs + 1))
    return Reflections(start, np.ascontiguousarray(found.planes[row, 0]), row)


def scale_reflections(tile: Tile, of: Reflections, factor: np.ndarray, wave: np.ndarray) -> None:
    """Multiply the energies of reflections by factors (n, b), and their waves by `wave` (n, b, p); in a tile of one
    side those of (i, j), i <= j, count for both directions."""
    found = tile.discrete.get("image_source")
    if found is None or len(of.row) == 0:
        return
    if tile.same:
        n = len(tile.a.ends.points)
        pair = found.pair[of.row]
        i, j = pair // n, pair % n
        # the same plane in the other direction
        reverse = of.start[j * n + i] + np.arange(len(pair)) - of.start[pair]
        upper = (i <= j)[:, None]
        factor = np.where(upper, factor, factor[reverse])
        wave = np.where(upper[:, :, None], wave, wave[reverse])
    found.scale(of.row, factor, wave)
