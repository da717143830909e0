"""Every setting has an upper bound, said in one line before memory is taken."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.config import DatasetConfig, GraphConfig, GridConfig
from soundspaces_sim.core.memory import check_memory
from soundspaces_sim.core.settings import Settings, choices_of

TOO_MUCH: dict[Any, dict[str, tuple[Any, ...]]] = {
    GridConfig: {
        "spacing": (0.0, 1e9, math.nan), "height": (0.0, 1e9, math.inf), "rays": (0, 10**9), "bounces": (0, 10**9),
        "min_closedness": (-0.1, 2.0, math.nan), "min_distance": (-1.0, 1e9, math.nan),
    },
    GraphConfig: {"radius": (-1.0, 1e9, math.nan), "height": (0.0, math.inf), "step": (1e9, math.nan), "cell": (0.0, 9.0)},
    ss.SimulationConfig: {
        "walks": (0, 10**9), "max_bounces": (0, 10**12), "target_error": (0.0, math.nan, 1e9),
        "max_walks": (0, 10**12), "duration": (0.0, 1e9, math.inf, math.nan), "max_duration": (0.0, 1e9, math.nan),
        "decay_range_db": (1.0, 1e9, math.nan),
        "speed_of_sound": (0.0, 1e-9, 1e9, math.nan), "temperature_c": (-300.0, 1e9, math.nan),
        "humidity_percent": (-1.0, 101.0, math.nan),
        "bands": ((0.0, 1e12), tuple(range(100)), (0.0, math.nan)), "time_grid": (((0.0, 1e-8),), ((0.0, math.nan),)),
    },
    ss.SpecularConfig: {"ratio": (0, 10**6)},
    ss.ConnectionsConfig: {"subpaths": (-1, 1, 10**7), "window": (-1.0, math.inf, math.nan)},
    ss.RadianceTransferConfig: {},
    ss.DiffractionConfig: {},
    ss.MaterialsConfig: {"groups": (0, 13, -1)},
    DatasetConfig: {
        "rate": (10**9, 1), "seed": (-1, 2**63), "tile": (0, 10**9), "headings": ((math.nan,), (360.0,)),
        "licence": ("x" * 10**6,), "citation": ("x" * 10**6,), "author": ("x" * 10**6,), "organization": ("x" * 10**6,),
    },
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [(k, n, v) for k, names in TOO_MUCH.items() for n, values in names.items() for v in values],
    ids=lambda x: None if not isinstance(x, float) else repr(x),
)
def test_out_of_range(kind: type, name: str, value: object) -> None:
    with pytest.raises(ss.ConfigError, match=rf"{name}: expected") as caught:
        kind(**{name: value})
    assert "\n" not in str(caught.value)


def test_every_number_has_a_bound() -> None:
    """A setting that is added and not bounded fails here."""
    for kind, names in TOO_MUCH.items():
        types = {field.name: field.type for field in msgspec.structs.fields(kind)}
        numbers = {name for name, of in types.items() if not _is_choice_or_table(of)}
        assert numbers - {"renderer"} == set(names)  # which is a name of a registry


def _is_choice_or_table(of: Any) -> bool:
    return of is bool or bool(choices_of(of)) or (isinstance(of, type) and issubclass(of, Settings))


def test_more_memory_than_there_is() -> None:
    with pytest.raises(ss.ConfigError, match=r"a hall: .* GB of memory are needed, and .* GB are free"):
        check_memory(1e15, "a hall")
    with pytest.raises(ss.ConfigError):
        check_memory(math.nan, "a hall")


def test_numbers_are_as_a_file_gives_them() -> None:
    """Keys of shards hold settings as they are written, and 1 is written otherwise than 1.0."""
    walks: Any = np.int64(64)
    config = ss.SimulationConfig(duration=1, time_grid=((0, 0.001),), walks=walks)
    rows: Any = [[np.float32(0.0), np.float64(0.001)]]
    assert ss.SimulationConfig(time_grid=rows).time_grid == ((0.0, 0.001),)
    assert isinstance(config.duration, float) and isinstance(config.time_grid[0][0], float)
    assert isinstance(ss.GridConfig(spacing=1).spacing, float) and config.walks == 64
    wrong: tuple[Any, ...] = (3.5, True, np.float64(0.5))
    for walks in wrong:
        with pytest.raises(ss.ConfigError, match=r"simulation\.walks: expected `int`"):
            ss.SimulationConfig(walks=walks)
