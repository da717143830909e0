"""Discrete paths between single places, as tiles have them, without walks: direct sound, mirror images, edges.

`simulate` does the same for all pairs of a tile. Here a place's own share of the work, what it sees of planes and
edges, is a `Side` that the caller keeps: a source is heard at many places.
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.core.simulation_config import LowConfig, MaterialsConfig, RadianceTransferConfig
from soundspaces_sim.scene.rays.placing import off_faces
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.integrator import arrived_at
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.path_table import PathTable
from soundspaces_sim.transport.paths.detector import Detectors, make_detectors
from soundspaces_sim.transport.preparation import at_duration, prepare_scene
from soundspaces_sim.transport.state import Ends
from soundspaces_sim.transport.techniques import TECHNIQUES
from soundspaces_sim.transport.tile import Side, make_tile

_MOST_SIDES, _MOST_PAIRS = 64, 16  # kept of `SimulatedPaths`


class DiscretePaths(NamedTuple):
    """What comes from one place to another by paths of their own."""

    direct: np.ndarray  # (b,) J/m² for 1 J
    walls: int  # that the direct sound crosses
    distance: float  # m
    paths: PathTable  # the others, by length


def discrete_model(scene: Scene, config: SimulationConfig, seed: int = 0) -> Model:
    """A scene for discrete paths alone: what only walks and waves need is not prepared. `seed`: decides at which
    end a pair's paths begin to be solved, as in `simulate`."""
    config = msgspec.structs.replace(
        config,
        radiance_transfer=RadianceTransferConfig(enabled=False),
        materials=MaterialsConfig(),
        low=LowConfig(),
    )
    return at_duration(prepare_scene(scene, config), config.time_grid[0][1], seed)


def _no_detectors(model: Model) -> Detectors:
    nowhere, keys = np.zeros((1, 3)), np.zeros(1, np.uint64)
    return make_detectors(model.world.geometry, nowhere, keys, model.world.radii)


def discrete_paths(source: Side, listener: Side) -> DiscretePaths:
    """The paths from one place to another."""
    tile = make_tile(source, listener)
    found = arrived_at(tile, TECHNIQUES)
    distance = float(tile.distance[0, 0])
    return DiscretePaths(found.direct[0, 0], int(found.walls[0, 0]), distance, found.paths.sorted())


class Arriving(NamedTuple):
    """Paths as they reach a listener, the direct sound first if there is any."""

    length: np.ndarray  # (k,) m
    energy: np.ndarray  # (k, b) J/m² for 1 J
    direction: np.ndarray  # (k, 3) unit; zero where both are at one place


class SimulatedPaths:
    """Paths in a scene, under the config and seed of its dataset."""

    def __init__(self, scene: Scene, config: SimulationConfig, seed: int) -> None:
        self._model = discrete_model(scene, config, seed)
        self._sources: dict[bytes, Side] = {}
        self._listeners: dict[bytes, Side] = {}
        self._pairs: dict[tuple[bytes, bytes], DiscretePaths] = {}

    def between(self, source: np.ndarray, listener: np.ndarray) -> DiscretePaths:
        """Paths from one place (3,) m to another."""
        key = source.tobytes(), listener.tobytes()
        found = self._pairs.get(key)
        if found is None:
            if len(self._pairs) >= _MOST_PAIRS:
                self._pairs.clear()
            of_source = self._side(source, self._sources)
            found = self._pairs[key] = discrete_paths(of_source, self._side(listener, self._listeners))
        return found

    def _side(self, position: np.ndarray, kept: dict[bytes, Side]) -> Side:
        key = position.tobytes()
        if key not in kept:
            if len(kept) >= _MOST_SIDES:
                kept.clear()
            model, place = self._model, position[None]
            point = off_faces(model.world.geometry, place - model.scene.center)
            detectors = model.once(_no_detectors)  # nothing walks here
            kept[key] = Side(model, place, Ends(point, point_keys(place, model.seed), detectors))
        return kept[key]

    def arriving(self, source: np.ndarray, listener: np.ndarray) -> Arriving:
        """What `between` finds, in one table."""
        found, offset = self.between(source, listener), source - listener
        way = offset / found.distance if found.distance > 0.0 else np.zeros(3)
        first = slice(None) if found.direct.max() > 0.0 else slice(1, None)
        return Arriving(
            np.append(found.distance, found.paths.length)[first],
            np.concatenate([found.direct[None], found.paths.energy])[first],
            np.concatenate([way[None], found.paths.at_b])[first],
        )
