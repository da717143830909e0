"""Settings of a job from a config file and flags, for every command that has them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.core.numerics.bands import named_edges

if TYPE_CHECKING:
    import numpy as np

    from soundspaces_sim.core.config import JobConfig


BandsOption = Annotated[
    str | None,
    typer.Option(help="Bands: paper, octaves, thirds, or their edges in Hz with commas between them."),
]


MaterialsOnReadingOption = Annotated[
    bool,
    typer.Option(
        "--materials-on-reading",
        help="Count reflections, so that other absorption can be chosen on reading: 2.5 to 3.5 times the time and "
        "about 2.6 times the bytes.",
    ),
]


def read_bands(asked: str | None) -> tuple[float, ...] | None:
    """Edges of `BandsOption`, Hz. Raises `ConfigError`."""
    try:
        return None if asked is None else named_edges(asked)
    except ConfigError as error:
        raise ConfigError(f"--bands {asked}: {error}") from None


def read_settings(config: Path | None, flags: Mapping[str, tuple[str, str, Any]]) -> JobConfig:
    """The config file's settings under those of flags (stage, name, value). Raises `ConfigError`, which
    names the file if the file is wrong, and the flag if a flag is."""
    flags = {flag: what for flag, what in flags.items() if what[2] is not None}
    path = config or resource("pipelines", "default.toml")
    settings = ss.load_config(path)
    overrides: dict[str, dict[str, Any]] = {}
    for flag, (stage, name, value) in flags.items():
        overrides.setdefault(stage, {})[name] = value
        try:
            settings = ss.load_config(path, **overrides)
        except ConfigError as error:
            raise ConfigError(f"{flag} {value}: {error}") from error
    return settings


def read_places(path: Path | None, settings: JobConfig) -> np.ndarray | None:
    """Points (N, 3) m that take the place of a grid, from a points.txt or a graph.pkl; None: a grid it is."""
    from soundspaces_sim.dataset.exporters.points import read_points

    if path is None:
        return None
    places = read_points(path)
    if path.suffix == ".pkl":
        places[:, 2] += settings.grid.height  # a graph's nodes lie on the floor
    return places
