"""Discrete paths from place to place as the engine has them, for agents that move step by step.

What does not depend on the listener is kept for the sources met last, and so are the paths of the last pairs: an
agent that turns hears what it heard.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.nav.cache import LastUsed
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.discrete_paths import (
    DiscretePaths,
    discrete_model,
    discrete_paths,
    place_side,
)
from soundspaces_sim.transport.moving_listener.paths import RestingSource

_MOST_SOURCES, _MOST_PAIRS = 64, 64


class Arriving(NamedTuple):
    """Paths as they reach a listener, the direct sound first if there is any."""

    length: np.ndarray  # (k,) m
    energy: np.ndarray  # (k, b) J/m² for 1 J
    direction: np.ndarray  # (k, 3) unit; zero where both are at one place


class SimulatedPaths:
    """Paths in a scene, under the config and seed of its dataset."""

    def __init__(self, scene: Scene, config: SimulationConfig, seed: int) -> None:
        self._model = discrete_model(scene, config, seed)
        self._sources: LastUsed[bytes, RestingSource] = LastUsed(_MOST_SOURCES)
        self._pairs: LastUsed[tuple[bytes, bytes], DiscretePaths] = LastUsed(_MOST_PAIRS)

    def between(self, source: np.ndarray, listener: np.ndarray, rests: bool = True) -> DiscretePaths:
        """Paths from one place (3,) m to another. What a source that `rests` needs is kept."""
        own, other = source.tobytes(), listener.tobytes()

        def make() -> DiscretePaths:
            if not rests:
                return discrete_paths(*(place_side(self._model, place) for place in (source, listener)))
            return self._sources.get(own, lambda: RestingSource(self._model, source)).paths_to(listener)

        return self._pairs.get((own, other), make)

    def arriving(self, source: np.ndarray, listener: np.ndarray, rests: bool = True) -> Arriving:
        """What `between` finds, in one table."""
        found, offset = self.between(source, listener, rests), source - listener
        way = offset / found.distance if found.distance > 0.0 else np.zeros(3)
        first = slice(None) if found.direct.max() > 0.0 else slice(1, None)
        return Arriving(
            np.append(found.distance, found.paths.length)[first],
            np.concatenate([found.direct[None], found.paths.energy])[first],
            np.concatenate([way[None], found.paths.at_b])[first],
        )
