"""Discrete paths: a table of them, room in which kernels store them, and the loop over the pairs of a tile.

A discrete path is one that a pair of points has of itself, such as a reflection or a diffracted path: it has a
length, a direction at either end and an energy per band. Directions are unit vectors from an end outward.
Energies are J/m² at one end for 1 J from the other, as 1 / (4 pi r²) is in the free field; `PathTable` has the
air's share in them, `PathSlots` has not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.echogram.echogram import REVERSE_KIND, reverse_order, reverse_planes

WAVE_POINTS = 3  # per band, at which a path's pressure is known


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
    #: (n, b, `WAVE_POINTS`) complex: its pressure at points of each band (`diffraction.spectrum`), without the
    #: phase of its length, over the root of the mean square; 1, as by default, for what is reflected only
    wave: np.ndarray = field(default_factory=lambda: np.empty((0, 0, 0), np.complex64))

    def __post_init__(self) -> None:
        if len(self.groups) != len(self.pair):
            object.__setattr__(self, "groups", np.full((len(self.pair), 3), -1))
        if self.wave.shape[:2] != self.energy.shape:
            object.__setattr__(self, "wave", np.ones((*self.energy.shape, WAVE_POINTS), np.complex64))

    @classmethod
    def concatenate(cls, parts: Sequence[PathTable], bands: int) -> PathTable:
        """The paths of several tables, of none perhaps, one after the other."""
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
        columns = zip(*(vars(table).values() for table in [none, *parts]), strict=True)
        return cls(*(np.concatenate(column) for column in columns))

    def rows(self, rows: np.ndarray) -> PathTable:
        """Some of the paths, by number or by flag."""
        return PathTable(*(column[rows] for column in vars(self).values()))

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
            wave=self.wave,
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

    def scale(self, rows: np.ndarray, factor: np.ndarray, wave: np.ndarray) -> None:
        """Multiply the energies of some paths (m,) by factors (m, b), and their waves by `wave`, in place."""
        self.energy[rows] *= factor
        self.wave[rows] *= wave.astype(np.complex64)

    def sorted(self) -> PathTable:
        """The same paths by pair, then by length."""
        return self.rows(
            np.lexsort((*self.wedges.T[::-1], self.kind, *self.planes.T[::-1], self.length, self.pair))
        )


class PathSlots(NamedTuple):
    """Room for some paths of each of n pairs, which kernels fill by `store`. Columns as in `PathTable`."""

    number: np.ndarray  # (n,) paths that were found, whether or not there was room
    length: np.ndarray  # (n, slots) m
    at_b: np.ndarray  # (n, slots, 3)
    at_a: np.ndarray  # (n, slots, 3)
    energy: np.ndarray  # (n, slots, b), without air
    planes: np.ndarray  # (n, slots, 2)
    kind: np.ndarray  # (n, slots)
    wedges: np.ndarray  # (n, slots, 2)
    groups: np.ndarray  # (n, slots, 3)
    wave: np.ndarray  # (n, slots, b, `WAVE_POINTS`) complex


def make_slots(pairs: int, slots: int, bands: int) -> PathSlots:
    """Empty room for `slots` paths of each pair."""
    shape = pairs, slots
    return PathSlots(
        number=np.zeros(pairs, np.int64),
        length=np.empty(shape),
        at_b=np.empty((*shape, 3)),
        at_a=np.empty((*shape, 3)),
        energy=np.empty((*shape, bands)),
        planes=np.empty((*shape, 2), np.int64),
        kind=np.empty(shape, np.int64),
        wedges=np.empty((*shape, 2), np.int64),
        groups=np.empty((*shape, 3), np.int64),
        wave=np.empty((*shape, bands, WAVE_POINTS), np.complex64),
    )


class FoundPath(NamedTuple):
    """A path as kernels find it, its energy apart. Columns as in `PathTable`."""

    length: float
    at_b: Vec3
    at_a: Vec3
    planes: tuple[int, int]
    kind: int
    wedges: tuple[int, int]
    groups: tuple[int, int, int]


@part(forceinline=True)
def with_group(path: FoundPath, group: int) -> FoundPath:
    """A path of at most two reflections with the group of one more."""
    one, two, three = path.groups
    if one < 0:
        one = group
    elif two < 0:
        two = group
    else:
        three = group
    return FoundPath(
        path.length, path.at_b, path.at_a, path.planes, path.kind, path.wedges, (one, two, three)
    )


@part
def store(slots: PathSlots, pair: int, path: FoundPath, energy: np.ndarray) -> None:
    """Add a path and its energy (b,) to those of row `pair`; if there is no room, only count it."""
    s = slots.number[pair]
    slots.number[pair] = s + 1
    if s >= slots.length.shape[1]:
        return
    slots.length[pair, s], slots.kind[pair, s] = path.length, path.kind
    for axis in range(3):
        slots.at_b[pair, s, axis], slots.at_a[pair, s, axis] = path.at_b[axis], path.at_a[axis]
    for order in range(2):
        slots.planes[pair, s, order] = path.planes[order]
        slots.wedges[pair, s, order] = path.wedges[order]
    for order in range(3):
        slots.groups[pair, s, order] = path.groups[order]
    for b in range(len(energy)):
        slots.energy[pair, s, b] = energy[b]
        for n in range(slots.wave.shape[3]):
            slots.wave[pair, s, b, n] = 1.0


@part
def store_wave(
    slots: PathSlots, pair: int, path: FoundPath, energy: np.ndarray, wave: np.ndarray
) -> None:
    """`store` of a path whose pressure changes with frequency, as `PathTable.wave` (b, n) says."""
    s = slots.number[pair]
    store(slots, pair, path, energy)
    if s < slots.length.shape[1]:
        for b in range(len(energy)):
            for n in range(slots.wave.shape[3]):
                slots.wave[pair, s, b, n] = wave[b, n]
