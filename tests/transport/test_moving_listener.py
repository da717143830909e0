"""Paths to a listener that moves are those of a tile, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.transport.discrete_paths import (
    DiscretePaths,
    discrete_model,
    discrete_paths,
    place_side,
)
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.moving_listener.paths import RestingSource
from soundspaces_sim.transport.path_table import PathTable

CORNERS = np.array(
    [[0.4, 0.4, 1.2], [7.0, 5.0, 1.8]]
)  # of the part of the demo in which places are drawn


@pytest.fixture(scope="module")
def model() -> Model:
    return discrete_model(ss.load_scene("demo"), SimulationConfig(), 3)


def agree(found: DiscretePaths, expected: DiscretePaths) -> bool:
    same = np.array_equal(found.direct, expected.direct) and found.walls == expected.walls
    tables = zip(vars(found.paths).values(), vars(expected.paths).values(), strict=True)
    return same and found.distance == expected.distance and all(np.array_equal(a, b) for a, b in tables)


def places(seed: int, count: int) -> np.ndarray:
    low, high = CORNERS
    shares = np.random.default_rng(seed).random((count, 3))
    return np.asarray(low + (high - low) * shares)


def names(paths: PathTable) -> set[tuple[int, ...]]:
    """What each path met."""
    columns = np.column_stack([paths.kind, paths.planes, paths.wedges])
    return {tuple(row) for row in columns.tolist()}


def compare(model: Model, seed: int, count: int) -> tuple[int, int, int]:
    """(Pairs whose paths differ, pairs in which one is missing, paths in all)."""
    differ = missing = paths = 0
    for source in places(seed, 2):
        rests, side = RestingSource(model, source), place_side(model, source)
        for place in places(seed + 1, count):
            found, expected = rests.paths_to(place), discrete_paths(side, place_side(model, place))
            paths += len(expected.paths.length)
            differ += not agree(found, expected)
            missing += not names(expected.paths) <= names(found.paths)
    return differ, missing, paths


def test_paths_are_those_of_a_tile(model: Model) -> None:
    differ, missing, paths = compare(model, 0, 8)
    assert paths > 100 and differ == 0 and missing == 0


@pytest.mark.slow
def test_of_many_places_none_lacks_a_path(model: Model) -> None:
    """A source has more rays than in a tile, so it may find a reflection that a tile has not."""
    differ, missing, _ = compare(model, 10, 150)
    assert missing == 0 and differ <= 6
