"""The reflections that image sources have given a tile, which diffraction attenuates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.echogram.echogram import MIRRORS_AND_BACK, reverse_planes
from soundspaces_sim.transport.tile import Tile


class Reflections(NamedTuple):
    """Specular paths of a tile: rows start[k]:start[k + 1] are those of pair k = i * B + j, by their planes."""

    start: np.ndarray  # (A * B + 1,)
    plane: np.ndarray  # (n,) ascending for a pair
    then: np.ndarray  # (n,) the second plane, -1 for none; ascending for a plane
    back: np.ndarray  # (n,) whether the first plane is met again after the second one
    row: np.ndarray  # (n,) of the table of image sources


def no_reflections(pairs: int) -> Reflections:
    """Of so many pairs, none."""
    none = np.empty(0, np.int64)
    return Reflections(np.zeros(pairs + 1, np.int64), none, none, none > 0, none)


def first_order_reflections(tile: Tile) -> Reflections:
    """What `image_source` has found with one plane."""
    return _reflections(tile, 1)


def specular_reflections(tile: Tile) -> Reflections:
    """What `image_source` has found. In a tile of one side planes of pairs i > j are in order from j, so that those
    of (i, j) and (j, i) are in one order."""
    return _reflections(tile, 2)


def _reflections(tile: Tile, most: int) -> Reflections:
    found, pairs = tile.discrete.get("image_source"), tile.walls.size
    if found is None:
        return no_reflections(pairs)
    row = np.arange(len(found.pair)) if most > 1 else np.flatnonzero(found.planes[:, 1] < 0)
    pair, planes, kind = found.pair[row], found.planes[row], found.kind[row]
    if tile.same:
        n = len(tile.a.ends.points)
        planes = np.where((pair // n > pair % n)[:, None], reverse_planes(planes, kind), planes)
    back = kind == MIRRORS_AND_BACK
    order = np.lexsort((back, planes[:, 1], planes[:, 0], pair))
    start = np.searchsorted(pair[order], np.arange(pairs + 1))
    plane, then = np.ascontiguousarray(planes[order].T)
    return Reflections(start, plane, then, back[order], row[order])


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
        # the same planes in the other direction
        reverse = of.start[j * n + i] + np.arange(len(pair)) - of.start[pair]
        upper = (i <= j)[:, None]
        factor = np.where(upper, factor, factor[reverse])
        wave = np.where(upper[:, :, None], wave, wave[reverse])
    found.scale(of.row, factor, wave)
