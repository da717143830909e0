"""Checks of settings against what is possible; NaN is outside every range."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from soundspaces_sim.core.errors import ConfigError

#: Longest response, s.
LONGEST = 120.0
#: Points that are nearer have the direct sound of this distance, m: that of a point would grow without bound, and
#: no mouth or ear is one.
LEAST_DISTANCE = 0.05


def require(condition: bool, name: str, expected: str, got: object) -> None:
    """Raise `ConfigError` about the setting `name` unless `condition`."""
    if not condition:
        raise ConfigError(f"{name}: expected {expected}, got {got!r}")


def require_whole(settings: Any, stage: str, limits: Mapping[str, tuple[int, int]]) -> None:
    """Raise `ConfigError` for a setting that is not between its least and most (both are allowed)."""
    for name, (least, most) in limits.items():
        value = getattr(settings, name)
        require(least <= value <= most, f"{stage}.{name}", f"{least:,} to {most:,}", value)


def require_between(
    settings: Any, stage: str, limits: Mapping[str, tuple[float, float, str]], above: bool = False
) -> None:
    """The same of `limits` with least, most and unit; None is allowed. `above`: the least is not."""
    for name, (least, most, unit) in limits.items():
        value = getattr(settings, name)
        if value is not None:
            require_within(f"{stage}.{name}", value, least, most, unit, above)


def require_within(
    name: str, value: float, least: float, most: float, unit: str, above: bool = False
) -> None:
    """The same of one value."""
    inside = (least < value if above else least <= value) and value <= most
    words = f"more than {least:g}, at most {most:g} {unit}" if above else f"{least:g} to {most:g} {unit}"
    require(inside, name, words.rstrip(), value)
