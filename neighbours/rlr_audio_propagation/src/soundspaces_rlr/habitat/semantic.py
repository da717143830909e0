"""`SemanticScene`: the things of a scene by their labels, with habitat-sim's names."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from soundspaces_rlr.habitat.records import to_habitat
from soundspaces_sim import Scene
from soundspaces_sim.parts import unique_rows

_NOTHING = "void"


@dataclass(frozen=True)
class Box:
    """A box along the axes, (3,) m."""

    min: np.ndarray
    max: np.ndarray

    @property
    def center(self) -> np.ndarray:
        """Its middle."""
        return np.asarray(0.5 * (self.min + self.max))

    @property
    def sizes(self) -> np.ndarray:
        """Its edges."""
        return np.asarray(self.max - self.min)

    size = sizes  # by its later name


@dataclass(frozen=True)
class SemanticCategory:
    """A label."""

    number: int
    label: str

    def name(self, mapping: str = "") -> str:
        """The label, in whatever mapping."""
        del mapping
        return self.label

    def index(self, mapping: str = "") -> int:
        """Its row of `SemanticScene.categories`."""
        del mapping
        return self.number


@dataclass
class SemanticRegion:
    """A part of a level: here the whole of it."""

    id: str
    category: SemanticCategory
    aabb: Box
    objects: list[SemanticObject] = field(default_factory=list)
    level: SemanticLevel | None = None


@dataclass
class SemanticLevel:
    """A storey: here the whole scene."""

    id: str
    aabb: Box
    regions: list[SemanticRegion] = field(default_factory=list)
    objects: list[SemanticObject] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class SemanticObject:
    """Faces of one label that hang together; `id` ends in the number that semantic pictures have."""

    semantic_id: int
    category: SemanticCategory
    aabb: Box
    region: SemanticRegion

    @property
    def id(self) -> str:
        """Level, region, number."""
        return f"{self.region.id}_{self.semantic_id}"


class SemanticScene:
    """What a scene's labels say. `objects[0]` is all without a label, "void"; the others are faces of a label that
    share corners, in the order of labels. One level with one region: rooms are not told apart."""

    def __init__(self, scene: Scene) -> None:
        part, label = _parts(scene)
        void = SemanticCategory(0, _NOTHING)
        self.categories = [void, *(SemanticCategory(i + 1, n) for i, n in enumerate(scene.labels))]
        points = to_habitat(scene.corners)
        self.aabb = _box(points)
        level = SemanticLevel("0", self.aabb)
        region = SemanticRegion("0_0", void, self.aabb, level=level)
        low, high = _bounds(points, part, len(label))
        nothing = np.zeros(3)
        self.objects = [
            SemanticObject(
                i,
                self.categories[row + 1],
                Box(low[i], high[i]) if np.isfinite(low[i]).all() else Box(nothing, nothing),
                region,
            )
            for i, row in enumerate(label)
        ]
        region.objects, level.objects = self.objects, self.objects
        level.regions.append(region)
        self.levels, self.regions = [level], [region]
        #: (F,) row of `objects` of each face.
        self.face_object = part


def _parts(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """(F,) object of each face, and the label row of each object: -1 for object 0."""
    corner = unique_rows(scene.vertices)[1][scene.faces]
    key = np.append(
        -1, scene.face_label
    )  # so that the faces without a label are first, even if there are none
    labels, of = np.unique(key, return_inverse=True)
    of = of[1:]
    most = int(corner.max()) + 1
    node = of[:, None] * most + corner  # corners apart by label
    used, node = np.unique(node, return_inverse=True)
    node = node.reshape(-1, 3)
    ends = np.concatenate([node[:, :2], node[:, 1:]])
    links = coo_array((np.ones(len(ends), bool), ends.T), shape=(len(used),) * 2)
    whole = connected_components(links, directed=False)[1][node[:, 0]]
    named = scene.face_label >= 0
    part = np.zeros(len(whole), np.int64)
    pairs, row = unique_rows(np.column_stack([of, whole])[named])
    part[named] = row + 1
    return part, np.append(-1, labels[of[named][pairs]])


def _bounds(points: np.ndarray, part: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates (count, 3) of the corners (F, 3, 3) of each part; inf where it has none."""
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, part, points.min(axis=1))
    np.maximum.at(high, part, points.max(axis=1))
    return low, high


def _box(points: np.ndarray) -> Box:
    flat = points.reshape(-1, 3)
    return Box(flat.min(axis=0), flat.max(axis=0))
