"""Discrete paths from place to place as the engine has them, for agents that move step by step.

What a place sees of planes and edges is kept for the sources and listeners met last, and so are the paths of the
last pairs: an agent that turns hears what it heard.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.discrete_paths import (
    DiscretePaths,
    discrete_model,
    discrete_paths,
    place_side,
)
from soundspaces_sim.transport.tile import Side

_MOST_SIDES, _MOST_PAIRS = 64, 16


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
            kept[key] = place_side(self._model, position)
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
