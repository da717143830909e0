"""The map of a walk in continuous space (extra ``figures``)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from soundspaces_pictures.episode_map import MapPage

from soundspaces_continuous.state import ContinuousState
from soundspaces_sim import RirDataset, open_dataset

_SOURCE = "#E69F00"


class ContinuousMapPage(MapPage):
    """The map of `MapPage`, with a star where each goal is now."""

    def __init__(self, ds: RirDataset, goal: int) -> None:
        super().__init__(ds, goal, perceived=False)
        (self._sources,) = self.map.plot([], [], "*", color=_SOURCE, ms=13, ls="", mec="black", zorder=9)

    def draw_continuous(
        self, state: ContinuousState, trail: Sequence[tuple[float, float, float]]
    ) -> np.ndarray:
        """(height, width, 3) uint8. `trail`: (x, y, facing) of each step."""
        now = [state.world.source_at(goal, state.time).position[:2] for goal in state.episode.goals]
        self._sources.set_data(*np.array(now).T)
        return self.draw_at(state, np.array(trail)[:, :2], state.heading, None)


@lru_cache(maxsize=2)
def _page(path: Path, goal: int) -> ContinuousMapPage:
    return ContinuousMapPage(open_dataset(path), goal)


def map_frame(
    ds: RirDataset, state: ContinuousState, trail: Sequence[tuple[float, float, float]]
) -> np.ndarray:
    """(height, width, 3) uint8: the map with the level of the first goal's sound from where it began."""
    return _page(ds.path, state.episode.goals[0].route[0]).draw_continuous(state, trail)
