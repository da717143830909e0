"""Config files: TOML with one table per stage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from soundspaces_sim.core.config import JobConfig, as_config
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.io.untrusted import read_toml


def load_config(path: str | Path, **overrides: dict[str, Any]) -> JobConfig:
    """Read a TOML file; `overrides` replace single settings, e.g. ``grid={"spacing": 1.0}``.

    Raises `ConfigError` naming the setting, and the file if the file is at fault.
    """
    raw = read_toml(path, ConfigError, "config file")
    try:
        config = as_config(raw)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    if not overrides:
        return config
    return as_config(
        {**raw, **{stage: {**raw.get(stage, {}), **own} for stage, own in overrides.items()}}
    )
