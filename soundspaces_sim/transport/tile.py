"""What a tile consists of on its way from points to echograms: two sides, what their subpaths leave, and tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.echogram.denoise_plan import first_late
from soundspaces_sim.scene.rays.placing import off_faces
from soundspaces_sim.transport.bsdf.surface import group_count
from soundspaces_sim.transport.model import Model, Once
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.paths.detector import make_detectors
from soundspaces_sim.transport.radiance_transfer.first_reflections import Reflections
from soundspaces_sim.transport.state import Ends, Vertices
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, count_rows


@dataclass(frozen=True)
class Side(Once):
    """The points on one side of a tile. Techniques keep on it what they make of them (`Side.once`)."""

    model: Model
    given: np.ndarray  # (N, 3) m, the points in the scene's own frame
    ends: Ends


@dataclass(frozen=True)
class Walks(Once):
    """What subpaths of all points of a side have left. Techniques keep on it what they make of it
    (`Walks.once`)."""

    side: Side
    vertices: Vertices
    reflections: Reflections | None  # where radiance transfer takes part


@dataclass(frozen=True)
class Tile:
    """Two sides, whose pairs are wanted; `a is b` for all pairs of one side."""

    model: Model
    a: Side
    b: Side
    distance: np.ndarray  # (A, B) m

    @property
    def same(self) -> bool:
        return self.a is self.b

    @property
    def shape(self) -> tuple[int, int, int]:
        """(A, B, b): points of either side and bands."""
        return *self.distance.shape, self.model.world.air.shape[1]

    @property
    def pairs(self) -> np.ndarray:
        """(n, 2) rows of a and b; each pair of one side once."""
        shape = self.distance.shape
        chosen = np.tri(shape[0], dtype=bool).T if self.same else np.ones(shape, bool)
        # The layout of one pair, for one version of kernels.
        return np.ascontiguousarray(np.argwhere(chosen))


class Sums(NamedTuple):
    """The tables of a tile, to which walks and pairs of walks add."""

    to_b: np.ndarray  # (A, B, bins, 9, b), energy a -> b
    to_a: np.ndarray  # (B, A, bins, 9, b), `to_b` itself for one side; without bins if it is not wanted
    batches: np.ndarray  # (A, B, rows, windows, b), see `state.Tables`
    #: (A, B, late bins, b), without bins if they are not smoothed: half of what both ends' estimates differ by
    difference: np.ndarray


class Arrived(NamedTuple):
    """What arrives discretely between the points of a tile. The direct sound is not among the paths."""

    direct: np.ndarray  # (A, B, b) with air
    walls: np.ndarray  # (A, B) that the direct sound crosses
    paths: PathTable


def make_side(model: Model, points: np.ndarray) -> Side:
    """A side of (N, 3) points in m."""
    local = off_faces(model.world.geometry, points - model.scene.center)
    keys = point_keys(points, model.seed)
    detectors = make_detectors(model.world.geometry, local, keys, model.world.radii)
    return Side(model, points, Ends(local, keys, detectors))


def make_tile(a: Side, b: Side) -> Tile:
    """A tile between two sides."""
    p, q = a.given[:, None], b.given[None]
    return Tile(a.model, a, b, np.sqrt(((q - p) ** 2).sum(axis=2)))


def make_sums(tile: Tile, both_ways: bool) -> Sums:
    """Empty tables of a tile."""
    model, (rows, columns, bands) = tile.model, tile.shape
    to_b = empty_table(model, rows, columns)
    late = 0
    if model.config.denoise:
        late = len(model.time_edges) - 1 - first_late(model.time_edges, model.config.connections.window)
    return Sums(
        to_b,
        to_b if tile.same else empty_table(model, columns, rows, both_ways),
        np.zeros((rows, columns, batch_rows(model), model.windows, bands), np.float32),
        np.zeros((rows, columns, late, bands), np.float32),
    )


def nothing_arrived(tile: Tile) -> Arrived:
    """Of a tile between whose points nothing arrives discretely."""
    return Arrived(
        np.zeros(tile.shape),
        np.zeros(tile.shape[:2], np.int64),
        PathTable.concatenate([], tile.shape[2]),
    )


def batch_rows(model: Model) -> int:
    """Rows of `batches`: those of error bars, and `count_rows` of the groups whose reflections are counted."""
    return BATCHES + count_rows(group_count(model.world.surfaces))


def empty_table(model: Model, rows: int, columns: int, wanted: bool = True) -> np.ndarray:
    """(rows, columns, bins, 9, b) zeros; no bins unless `wanted`."""
    bins = len(model.time_edges) - 1 if wanted else 0
    return np.zeros((rows, columns, bins, CHANNELS, model.world.air.shape[1]), np.float32)
