"""What a tile consists of on its way from points to echograms: two sides, and the tables between them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.echogram.denoise import first_late
from soundspaces_sim.echogram.echogram import REVERSE_KIND, reverse_order
from soundspaces_sim.transport.model import Model, Once
from soundspaces_sim.transport.paths.detector import make_detectors
from soundspaces_sim.transport.state import Ends
from soundspaces_sim.transport.tables import BATCHES, CHANNELS


@dataclass(frozen=True)
class Side(Once):
    """The points on one side of a tile. Techniques keep on it what they make of them (`Side.once`)."""

    model: Model
    ends: Ends


@dataclass(frozen=True)
class EarlyPaths:
    """Discrete paths of a tile, in any order. Directions are unit vectors from the end outward."""

    pair: np.ndarray  # (n,) i * columns + j
    length: np.ndarray  # (n,) m
    at_b: np.ndarray  # (n, 3)
    at_a: np.ndarray  # (n, 3)
    energy: np.ndarray  # (n, b), air included
    planes: np.ndarray  # (n, 2) in order from a, -1 for none
    kind: np.ndarray  # (n,) see echo.echogram
    edges: np.ndarray  # (n, 2) in order from a, -1 for none

    def reversed(self, rows: int, columns: int) -> EarlyPaths:
        """The same paths from b to a, of a tile of rows × columns pairs."""
        pair = self.pair % columns * rows + self.pair // columns
        return EarlyPaths(
            pair, self.length, self.at_a, self.at_b, self.energy, reverse_order(self.planes),
            REVERSE_KIND[self.kind], reverse_order(self.edges),
        )  # fmt: skip

    def rows(self, rows: np.ndarray) -> EarlyPaths:
        """Some of them."""
        return EarlyPaths(*(column[rows] for column in vars(self).values()))

    def sorted(self) -> EarlyPaths:
        """The same paths by (pair, length)."""
        order = np.lexsort(
            (*self.edges.T[::-1], self.kind, *self.planes.T[::-1], self.length, self.pair)
        )
        return self.rows(order)


def join_paths(parts: list[EarlyPaths], bands: int) -> EarlyPaths:
    """Paths of several techniques as one record."""
    none = EarlyPaths(
        np.empty(0, np.int64), np.empty(0), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, bands)),
        np.empty((0, 2), np.int64), np.empty(0, np.int64), np.empty((0, 2), np.int64),
    )  # fmt: skip
    columns = zip(*(vars(part).values() for part in [none, *parts]), strict=True)
    return EarlyPaths(*(np.concatenate(column) for column in columns))


@dataclass
class Tile:
    """All that is between two sides; `a is b` for all pairs of one side.

    Techniques add to `to_b` (A, B, bins, 9, b), energy a -> b; to `to_a` (B, A, bins, 9, b), which has no bins if
    it is not wanted; to `batches` (A, B, BATCHES, windows, b); to `difference` (A, B, late bins, b), without bins
    if they are not smoothed, half of what both ends' estimates differ by; and set the direct sound: `direct`
    (A, B, b) with air, `walls` (A, B) that it crosses. `discrete`: discrete paths by the technique's name.
    """

    model: Model
    a: Side
    b: Side
    distance: np.ndarray  # (A, B) m
    to_b: np.ndarray
    to_a: np.ndarray
    batches: np.ndarray
    difference: np.ndarray
    direct: np.ndarray
    walls: np.ndarray
    discrete: dict[str, EarlyPaths] = field(default_factory=dict)

    @property
    def same(self) -> bool:
        return self.a is self.b

    @property
    def pairs(self) -> np.ndarray:
        """(n, 2) rows of a and b; each pair of one side once."""
        shape = len(self.a.ends.points), len(self.b.ends.points)
        return np.argwhere(np.tri(shape[0], dtype=bool).T if self.same else np.ones(shape, bool))


def make_side(model: Model, points: np.ndarray) -> Side:
    """A side of (N, 3) points in m."""
    local = np.ascontiguousarray(points - model.scene.center)
    keys = point_keys(points, model.seed)
    detectors = make_detectors(model.world.geometry, local, keys, model.world.radii)
    return Side(model, Ends(local, keys, detectors))


def make_tile(model: Model, a: Side, b: Side, both_ways: bool) -> Tile:
    """An empty tile between two sides."""
    shape, bands = (len(a.ends.points), len(b.ends.points)), model.world.air.shape[1]
    p, q = a.ends.points[:, None], b.ends.points[None]
    distance = np.sqrt(((q - p) ** 2).sum(axis=2))
    to_b = empty_table(model, *shape)
    to_a = to_b if a is b else empty_table(model, shape[1], shape[0], both_ways)
    late = 0
    if model.config.smooth:
        late = len(model.time_edges) - 1 - first_late(model.time_edges, model.config.join_window)
    return Tile(
        model, a, b, distance, to_b, to_a,
        np.zeros((*shape, BATCHES, model.windows, bands), np.float32), np.zeros((*shape, late, bands), np.float32),
        np.zeros((*shape, bands)), np.zeros(shape, np.int64),
    )  # fmt: skip


def empty_table(model: Model, rows: int, columns: int, wanted: bool = True) -> np.ndarray:
    """(rows, columns, bins, 9, b) zeros; no bins unless `wanted`."""
    bins = len(model.time_edges) - 1 if wanted else 0
    return np.zeros((rows, columns, bins, CHANNELS, model.world.air.shape[1]), np.float32)
