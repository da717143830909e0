"""Reading the files of `soundspaces-sim rooms`: echograms between the sources and the listeners of one room."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.errors import ConfigError, DatasetError
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.echogram.echogram import Echogram


def read_room(path: str | Path) -> list[list[Echogram]]:
    """The echograms of a room, a list for each source with one for each listener. Raises `DatasetError`."""
    plain = EchogramShard(Path(path))
    try:
        text = str(plain.attribute("config"))
    finally:
        plain.close()
    try:
        config = msgspec.convert(json.loads(text)[2], SimulationConfig)
    except (ValueError, LookupError, TypeError, ConfigError) as error:
        raise DatasetError(f"{path}: its settings cannot be read ({error}); make it again") from error
    shard = EchogramShard(Path(path), config.air_within_bands)
    try:
        sources, listeners = range(len(shard.sources)), range(len(shard.listeners))
        return [[shard.echogram(s, l) for l in listeners] for s in sources]
    finally:
        shard.close()
