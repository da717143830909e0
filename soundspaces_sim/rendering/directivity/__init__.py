"""Directivities of sources and receivers, by name. What they do to an echogram is in `echogram.directed`.

An entry is a subclass of `echogram.endpoints.Directivity`. A new one is a file here and a line below; where a
directivity is asked for its name does, for those that need no arguments.
"""

from __future__ import annotations

from collections.abc import Mapping

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.registry import Entry, find
from soundspaces_sim.echogram.endpoints import Directivity

_ROOM = "soundspaces_sim.rendering.directivity"
DIRECTIVITIES: Mapping[str, Entry] = {
    "omni": Entry(f"{_ROOM}.cardioid:Omni", "alike in all directions"),
    "cardioid": Entry(f"{_ROOM}.cardioid:Cardioid", "first-order patterns and their powers"),
    "by-frequency": Entry(
        f"{_ROOM}.frequency:FrequencyDependent", "a pattern for each of some frequencies"
    ),
    "harmonics": Entry(f"{_ROOM}.harmonics:SphericalHarmonics", "coefficients of any order"),
    "measured": Entry(f"{_ROOM}.sofa:MeasuredDirectivity", "a SOFA file (FreeFieldDirectivityTF)"),
    "talker": Entry(f"{_ROOM}.talker:Talker", "a human talker, average of 15"),
}


def as_directivity(given: Directivity | str | None, what: str) -> Directivity | None:
    """The directivity that was given, itself or by name. Raises `ConfigError`."""
    if given is None or isinstance(given, Directivity):
        return given
    if not isinstance(given, str):
        raise ConfigError(f"{what}: expected a Directivity or its name, got {given!r}")
    kind = find(what, DIRECTIVITIES, given)
    try:
        made: Directivity = kind()
    except TypeError as error:
        raise ConfigError(
            f"{what}: {given!r} needs arguments ({error}); give soundspaces_sim.{kind.__name__}(…)"
        ) from None
    return made
