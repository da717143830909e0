"""Discrete paths from one source to a listener that moves: what `discrete_paths` finds, without what no path
needs."""

from __future__ import annotations

from typing import Any

import numpy as np

from soundspaces_sim.transport.diffraction.edge_kernel import EdgeSide
from soundspaces_sim.transport.diffraction.mixed import (
    edge_side,
    heard_beside,
    large_planes,
    points_of,
)
from soundspaces_sim.transport.diffraction.points import edges_of_scene
from soundspaces_sim.transport.diffraction.technique import MIXED
from soundspaces_sim.transport.discrete_paths import DISCRETE, DiscretePaths, place_side
from soundspaces_sim.transport.image_source.reflections import first_order_reflections
from soundspaces_sim.transport.image_source.sequences import plane_sequences
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.moving_listener.edge_planes import edge_planes
from soundspaces_sim.transport.moving_listener.images import Other, images_for
from soundspaces_sim.transport.moving_listener.reflections import no_sequences, reflections_between
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.tile import Side, Tile


class RestingSource:
    """A source at a place (3,) m, with all that does not depend on who hears it."""

    def __init__(self, model: Model, place: np.ndarray) -> None:
        self.model = model
        self._whole = place_side(model, place)
        scene = model.once(edges_of_scene)
        self._side = Side(model, self._whole.given, self._whole.ends)
        if scene is not None:
            self._side.know(edge_side, self._whole.once(edge_side))
        self._side.know(plane_sequences, no_sequences(self._whole))
        self._scratch: dict[Any, Any] = {}

    def paths_to(self, place: np.ndarray) -> DiscretePaths:
        """The paths to a listener at a place (3,) m."""
        listener = place_side(self.model, place)
        listener.know(plane_sequences, reflections_between(self._whole, listener))
        tile = _tile(self._side, listener, self._scratch)
        for technique in DISCRETE:
            assert technique.connect is not None
            if technique is MIXED:
                _know_images(tile)
            found = technique.connect(tile)
            if found is not None and len(found.pair):
                tile.discrete[technique.name] = found
        paths = PathTable.concatenate(list(tile.discrete.values()), tile.direct.shape[2]).sorted()
        return DiscretePaths(tile.direct[0, 0], int(tile.walls[0, 0]), float(tile.distance[0, 0]), paths)


def _tile(source: Side, listener: Side, scratch: dict[Any, Any]) -> Tile:
    """A tile of one pair, without tables of energies."""
    bands = source.model.world.air.shape[1]
    apart = listener.ends.points[0] - source.ends.points[0]
    none = np.empty((1, 1, 0, 0, bands), np.float32)
    return Tile(
        model=source.model,
        a=source,
        b=listener,
        distance=np.full((1, 1), np.sqrt((apart**2).sum())),
        to_b=none,
        to_a=none,
        batches=none,
        difference=none[0],
        direct=np.zeros((1, 1, bands)),
        walls=np.zeros((1, 1), np.int64),
        scratch=scratch,
    )


def _know_images(tile: Tile) -> None:
    """Give a tile's listener the images that paths may need, now that its other paths are known."""
    model, source, listener = tile.model, tile.a, tile.b
    scene = model.once(edges_of_scene)
    if scene is None:
        return
    planes = np.flatnonzero(model.once(large_planes))
    of_source = source.once(edge_side)
    lit = np.zeros(len(scene.sight.planes.offset), np.bool_)
    lit[first_order_reflections(tile).plane] = True
    other = Other(
        of_source.points,
        of_source.images,
        bool(source.ends.keys[0] > listener.ends.keys[0]),
        lit,
        float(heard_beside(tile)[0, 0]),
    )
    points = points_of(listener, scene)
    images = images_for(scene, model.once(edge_planes), points.at, planes, other)
    listener.know(edge_side, EdgeSide(points, images))
