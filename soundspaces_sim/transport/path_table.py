"""Discrete paths: a table of them.

A discrete path is one that a pair of points has of itself, such as a reflection or a diffracted path: it has a
length, a direction at either end and an energy per band. Directions are unit vectors from an end outward.
Energies are J/m² at one end for 1 J from the other, as 1 / (4 pi r²) is in the free field, less what air takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from soundspaces_sim.core.numerics.rows import lexsorted, taken
from soundspaces_sim.echogram.echogram import REVERSE_KIND, reverse_order, reverse_planes


@dataclass(frozen=True)
class PathTable:
    """n discrete paths of a tile of A × B pairs, in any order. Units: m, J/m² for 1 J."""

    pair: np.ndarray  # (n,) i * B + j
    length: np.ndarray  # (n,) m
    at_b: np.ndarray  # (n, 3) unit
    at_a: np.ndarray  # (n, 3) unit
    energy: np.ndarray  # (n, b), air included
    planes: np.ndarray  # (n, 2) specular planes in order from a, -1 for none
    kind: np.ndarray  # (n,) row of `echogram.KINDS`
    wedges: np.ndarray  # (n, 2) diffracting wedges in order from a, -1 for none
    #: (n, 3) groups in which its reflections are counted, in any order, -1 for none, as by default
    groups: np.ndarray = field(default_factory=lambda: np.empty((0, 3), np.int64))

    def __post_init__(self) -> None:
        if len(self.groups) != len(self.pair):
            object.__setattr__(self, "groups", np.full((len(self.pair), 3), -1))

    @classmethod
    def concatenate(cls, parts: Sequence[PathTable], bands: int) -> PathTable:
        """The paths of several tables, of none perhaps, one after the other."""
        some = [table for table in parts if len(table.pair)]
        if len(some) == 1:
            return some[0]
        none = cls(
            pair=np.empty(0, np.int64),
            length=np.empty(0),
            at_b=np.empty((0, 3)),
            at_a=np.empty((0, 3)),
            energy=np.empty((0, bands)),
            planes=np.empty((0, 2), np.int64),
            kind=np.empty(0, np.int64),
            wedges=np.empty((0, 2), np.int64),
        )
        columns = zip(*(vars(table).values() for table in [none, *some]), strict=True)
        return cls(*(np.concatenate(column) for column in columns))

    def rows(self, rows: np.ndarray) -> PathTable:
        """Some of the paths, by number or by flag."""
        numbers = np.flatnonzero(rows) if rows.dtype == bool else rows
        return PathTable(*(taken(column, numbers) for column in vars(self).values()))

    def reversed(self, distance: np.ndarray) -> PathTable:
        """The same paths from b to a, of pairs whose ends are so far apart, (A, B) m.

        From a place to itself the paths of one direction are those of the other, and stay as they are: by the edge
        of a right angle there is one path, whose reverse would be the same with its planes in the other order.
        """
        rows, columns = distance.shape
        pair = self.pair % columns * rows + self.pair // columns
        back = PathTable(
            pair=pair,
            length=self.length,
            at_b=self.at_a,
            at_a=self.at_b,
            energy=self.energy,
            planes=reverse_planes(self.planes, self.kind),
            kind=REVERSE_KIND[self.kind],
            wedges=reverse_order(self.wedges),
            groups=self.groups,
        )
        itself = distance.ravel()[self.pair] == 0.0
        if not itself.any():
            return back
        return PathTable.concatenate(
            [back.rows(~itself), replace(self, pair=pair).rows(itself)], self.energy.shape[1]
        )

    def both_directions(self, distance: np.ndarray) -> PathTable:
        """Paths of pairs i <= j of one side, whose points are so far apart, (N, N) m, and the reverse ones of its
        pairs i < j."""
        back, points = self.reversed(distance), len(distance)
        other = back.pair // points != back.pair % points
        return PathTable.concatenate([self, back.rows(other)], self.energy.shape[1])

    def sorted(self) -> PathTable:
        """The same paths by pair, then by length."""
        first = *self.wedges.T[::-1], self.kind, *self.planes.T[::-1], self.length
        return self.rows(lexsorted((*first, self.pair)))
