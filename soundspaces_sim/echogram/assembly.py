"""Assembly of one table of echograms from those of tiles, and tiles cut out of one."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from soundspaces_sim.echogram.echogram import Arrivals, Echograms
from soundspaces_sim.echogram.reflection_counts import ReflectionCounts

_OF_PAIRS = "energy", "direct_energy", "direct_length", "walls", "relative_error", "measure_error", "low"
_OF_ALL = ("bands", "speed_of_sound", "time_edges", "air", "low_edge")


class Assembly:
    """Echograms of S sources (S, 3) × L listeners (L, 3), as tiles of them come in, in any order."""

    def __init__(self, sources: np.ndarray, listeners: np.ndarray) -> None:
        self._sources, self._listeners = sources, listeners
        self._columns: dict[str, Any] = {}
        self._pairs: list[np.ndarray] = []  # of early arrivals
        self._early: list[Arrivals] = []
        self._common: dict[str, Any] = {}  # to all tiles
        self._counts: ReflectionCounts | None = None

    def put(self, rows: slice, columns: slice, tile: Echograms) -> None:
        """Copy the echograms of some sources and listeners."""
        shape = len(self._sources), len(self._listeners)
        for name in _OF_PAIRS:
            part = getattr(tile, name)
            if part is None:
                continue
            if name not in self._columns:
                self._columns[name] = np.zeros((*shape, *part.shape[2:]), part.dtype)
            self._columns[name][rows, columns] = part
        if tile.counts is not None:
            if self._counts is None:
                self._counts = tile.counts.of_shape(shape)
            self._counts.put((rows, columns), tile.counts)
        number = np.arange(shape[0])[rows, None] * shape[1] + np.arange(shape[1])[columns]
        self._pairs.append(np.repeat(number.ravel(), np.diff(tile.early_start)))
        self._early.append(tile.early)
        self._common = {name: getattr(tile, name) for name in _OF_ALL}

    def table(self) -> Echograms:
        """All of them."""
        pair = np.concatenate(self._pairs)
        order = np.argsort(pair, kind="stable")
        early = Arrivals(
            *(np.concatenate([getattr(e, f.name) for e in self._early])[order] for f in fields(Arrivals))
        )
        start = np.searchsorted(pair[order], np.arange(len(self._sources) * len(self._listeners) + 1))
        return Echograms(
            sources=self._sources,
            listeners=self._listeners,
            early_start=start,
            early=early,
            counts=self._counts,
            **self._common,
            **self._columns,
        )


def cut(table: Echograms, rows: slice, columns: slice) -> Echograms:
    """The echograms of some of the sources and listeners of a table without records of its ends."""
    pairs = np.arange(len(table)).reshape(table.shape)[rows, columns].ravel()
    first = table.early_start[pairs]
    number = table.early_start[pairs + 1] - first
    start = np.concatenate([[0], np.cumsum(number)])
    early = np.repeat(first - start[:-1], number) + np.arange(start[-1])
    whole = {name: getattr(table, name) for name in _OF_PAIRS}
    of_pairs: dict[str, Any] = {name: x if x is None else x[rows, columns] for name, x in whole.items()}
    return replace(
        table,
        sources=table.sources[rows],
        listeners=table.listeners[columns],
        early_start=start,
        early=Arrivals(*(getattr(table.early, f.name)[early] for f in fields(Arrivals))),
        counts=None if table.counts is None else table.counts.pairs(rows, columns),
        **of_pairs,
    )
