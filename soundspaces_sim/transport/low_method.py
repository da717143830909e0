"""Sound below an edge as waves, where `[simulation.low]` asks for it: an entry point names who simulates it.

Datasets with waves are read, rendered and measured by the core; neighbours/waves simulates them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.extras import neighbour_hint
from soundspaces_sim.core.registry import installed_by_name
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.low_response import LowResponse
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.model import Model

# Of entry points; each is a `LowMethod`, by the name in the settings.
GROUP = "soundspaces_sim.low_methods"


class LowRuns(Protocol):
    """Runs of one model, which tiles share."""

    @property
    def samples(self) -> int:
        """Of a response."""

    @property
    def sources(self) -> int:
        """That a core runs side by side: fewer take as long."""

    def responses(self, sources: np.ndarray, listeners: np.ndarray) -> np.ndarray:
        """(S, L, 4, n) float32 between (S, 3) and (L, 3) m. Raises `PointError`."""


class LowMethod(Protocol):
    """A method for sound below an edge: a module with these functions."""

    def check_lattice(self, scene: Scene, config: SimulationConfig) -> None:
        """Raise `SimulationError` or `ConfigError` for what would be too large, before anything is made."""

    def check_points(self, model: Model, points: np.ndarray) -> None:
        """Raise `PointError` for points that cannot be simulated, before anything is run."""

    def make_runs(self, model: Model, points: np.ndarray | None, folder: Path | None) -> LowRuns:
        """Of a model; `points` (N, 3) m: all of a job, whose responses may be kept, also in `folder`."""

    def with_waves(
        self, runs: LowRuns, config: SimulationConfig, there: Echograms, back: Echograms | None
    ) -> tuple[Echograms, Echograms | None]:
        """Echograms of pairs, and of the ways back, with their sound below the edge."""

    def responses_from(
        self, scene: Scene, source: np.ndarray, listeners: np.ndarray, duration: float
    ) -> list[LowResponse]:
        """Below the first band's edge, from (3,) to each of (L, 3), m."""


def low_method(config: SimulationConfig) -> LowMethod | None:
    """What simulates below the edge; None for rays. Raises `ConfigError` if it is not installed."""
    return None if config.low.method == "rays" else installed(config.low.method)


def installed(name: str) -> LowMethod:
    """A method by its name. Raises `ConfigError` if it is not installed."""
    method: LowMethod | None = installed_by_name(GROUP, name)
    if method is None:
        raise ConfigError(
            f"simulation.low.method: {name} are not installed; {neighbour_hint('parameters', name)}"
        )
    return method
