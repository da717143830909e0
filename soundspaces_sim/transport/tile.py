"""What a tile consists of on its way from points to echograms: two sides, and the tables between them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.echogram.denoise_plan import first_late
from soundspaces_sim.scene.rays.placing import off_faces
from soundspaces_sim.transport.bsdf.scores import score_count
from soundspaces_sim.transport.bsdf.surface import group_count
from soundspaces_sim.transport.model import Model, Once
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.paths.detector import make_detectors
from soundspaces_sim.transport.radiance_transfer.first_reflections import Reflections
from soundspaces_sim.transport.state import Ends, ReflectionBlock, Vertices
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, count_rows


@dataclass(frozen=True)
class Side(Once):
    """The points on one side of a tile. Techniques keep on it what they make of them (`Side.once`)."""

    model: Model
    given: np.ndarray  # (N, 3) m, the points in the scene's own frame
    ends: Ends


@dataclass
class Left:
    """What subpaths of a side's points leave for techniques that join both sides, while they are traced.

    Receiver volumes fill `vertices`, of connected subpaths, in the rows that they trace. Specular subpaths add to
    `reflections`, the first diffuse ones of consecutive points, packed; `room` is theirs alone, for points that are
    traced together.
    """

    vertices: Vertices
    reflections: list[ReflectionBlock] = field(default_factory=list)
    room: ReflectionBlock | None = None


@dataclass(frozen=True)
class Walks(Once):
    """What subpaths of all points of a side have left. Techniques keep on it what they make of it
    (`Walks.once`)."""

    side: Side
    vertices: Vertices
    reflections: Reflections | None  # where radiance transfer takes part


@dataclass
class Tile:
    """All that is between two sides; `a is b` for all pairs of one side.

    Techniques add to `to_b` (A, B, bins, 9, b), energy a -> b; to `to_a` (B, A, bins, 9, b), which has no bins if
    it is not wanted; to `batches` (A, B, rows, windows, b), see `state.Tables`; to `difference` (A, B,
    late bins, b), without bins if they are not smoothed, half of what both ends' estimates differ by; and set the
    direct sound: `direct` (A, B, b) with air, `walls` (A, B) that it crosses. `discrete`: discrete paths by the
    technique's name.
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
    discrete: dict[str, PathTable] = field(default_factory=dict)

    @property
    def same(self) -> bool:
        return self.a is self.b

    @property
    def pairs(self) -> np.ndarray:
        """(n, 2) rows of a and b; each pair of one side once."""
        shape = len(self.a.ends.points), len(self.b.ends.points)
        chosen = np.tri(shape[0], dtype=bool).T if self.same else np.ones(shape, bool)
        return np.ascontiguousarray(
            np.argwhere(chosen)
        )  # the layout of one pair, for one version of kernels


def make_side(model: Model, points: np.ndarray) -> Side:
    """A side of (N, 3) points in m."""
    local = off_faces(model.world.geometry, points - model.scene.center)
    keys = point_keys(points, model.seed)
    detectors = make_detectors(model.world.geometry, local, keys, model.world.radii)
    return Side(model, points, Ends(local, keys, detectors))


def make_tile(model: Model, a: Side, b: Side, both_ways: bool) -> Tile:
    """An empty tile between two sides."""
    shape, bands = (len(a.ends.points), len(b.ends.points)), model.world.air.shape[1]
    p, q = a.given[:, None], b.given[None]
    distance = np.sqrt(((q - p) ** 2).sum(axis=2))
    to_b = empty_table(model, *shape)
    to_a = to_b if a is b else empty_table(model, shape[1], shape[0], both_ways)
    late = 0
    if model.config.denoise:
        late = len(model.time_edges) - 1 - first_late(model.time_edges, model.config.connections.window)
    return Tile(
        model,
        a,
        b,
        distance,
        to_b,
        to_a,
        np.zeros((*shape, batch_rows(model), model.windows, bands), np.float32),
        np.zeros((*shape, late, bands), np.float32),
        np.zeros((*shape, bands)),
        np.zeros(shape, np.int64),
    )


def batch_rows(model: Model) -> int:
    """Rows of `batches`: those of error bars, `count_rows` of the groups whose reflections are counted, and one for
    the scores of each, if they are wanted."""
    surfaces = model.world.surfaces
    return BATCHES + count_rows(group_count(surfaces)) + score_count(surfaces)


def empty_table(model: Model, rows: int, columns: int, wanted: bool = True) -> np.ndarray:
    """(rows, columns, bins, 9, b) zeros; no bins unless `wanted`."""
    bins = len(model.time_edges) - 1 if wanted else 0
    return np.zeros((rows, columns, bins, CHANNELS, model.world.air.shape[1]), np.float32)
