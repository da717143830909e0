"""The registry of room-acoustic parameters (ISO 3382-1, -2, IEC 60268-16), of datasets and of single echograms.

A parameter is a function in `echogram.parameters` (or `rendering.interaural`) and a line of `PARAMETERS`; all
that lists, computes, draws or writes parameters reads this table, and loads none of them to do so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Literal, NamedTuple

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import TableEntry as Entry, did_you_mean, find_entry as find

Takes = Literal["response", "hrtf", "speech", "index"]


class Parameter(NamedTuple):
    """One parameter.

    `target`: its function, loaded when it is asked for. `takes`: what that is given: a ``response`` in bands,
    with ``hrtf`` also the path of a SOFA file, with ``speech`` a `Speech` (it has values in the octaves of
    speech alone), with ``index`` the same (one value per pair). `averaged`: lowest and highest octave of the
    single-number value of ISO 3382-1, table A.1; energies are averaged if `energetic`.
    """

    target: str
    unit: str
    about: str
    takes: Takes = "response"
    averaged: tuple[float, float] | None = (500.0, 1000.0)
    energetic: bool = False


_DECAY, _STRENGTH = (
    "soundspaces_parameters.decay:",
    "soundspaces_parameters.strength:",
)
_SPEECH, _EARS = "soundspaces_parameters.speech:", "soundspaces_parameters.interaural:"

PARAMETERS: Mapping[str, Parameter] = {
    "t20": Parameter(_DECAY + "t20", "s", "reverberation time from -5 to -25 dB"),
    "t30": Parameter(_DECAY + "t30", "s", "reverberation time from -5 to -35 dB"),
    "edt": Parameter(_DECAY + "edt", "s", "early decay time, from 0 to -10 dB"),
    "c50": Parameter(_DECAY + "c50", "dB", "clarity, energy up to 50 ms to the rest"),
    "c80": Parameter(_DECAY + "c80", "dB", "clarity, energy up to 80 ms to the rest"),
    "d50": Parameter(_DECAY + "d50", "1", "definition, share of the energy up to 50 ms"),
    "ts": Parameter(_DECAY + "ts", "s", "centre time"),
    "drr": Parameter(
        _DECAY + "drr", "dB", "direct-to-reverberant ratio; none out of sight", averaged=None
    ),
    "g": Parameter(_STRENGTH + "strength", "dB", "strength, re the free field at 10 m"),
    "g_early": Parameter(_STRENGTH + "early_strength", "dB", "strength of the first 80 ms"),
    "g_late": Parameter(_STRENGTH + "late_strength", "dB", "strength from 80 ms on"),
    "lf": Parameter(
        _STRENGTH + "lateral_fraction", "1", "early lateral energy fraction", averaged=(125.0, 1000.0)
    ),
    "lfc": Parameter(
        _STRENGTH + "lateral_fraction_cosine", "1", "the same, with the cosine", averaged=(125.0, 1000.0)
    ),
    "lj": Parameter(
        _STRENGTH + "late_lateral_level", "dB", "late lateral level", "response", (125.0, 1000.0), True
    ),
    "iacc_early": Parameter(
        _EARS + "early", "1", "interaural cross-correlation up to 80 ms", "hrtf", (500.0, 2000.0)
    ),
    "iacc_late": Parameter(
        _EARS + "late", "1", "interaural cross-correlation from 80 ms on", "hrtf", (500.0, 2000.0)
    ),
    "iacc": Parameter(_EARS + "whole", "1", "interaural cross-correlation", "hrtf", (500.0, 2000.0)),
    "curvature": Parameter(_DECAY + "curvature", "%", "by which T30 exceeds T20", averaged=None),
    "nonlinearity": Parameter(
        _DECAY + "nonlinearity", "‰", "of the decay that T30's line leaves", averaged=None
    ),
    "mti": Parameter(
        _SPEECH + "octave_indices", "1", "modulation transfer index", "speech", averaged=None
    ),
    "sti": Parameter(
        _SPEECH + "speech_transmission_index", "1", "speech transmission index", "index", averaged=None
    ),
}

SUFFIXES = (".csv", ".xlsx", ".parquet")  # of tables of parameters


@cache
def find_parameter(name: str) -> Callable[..., Any]:
    """The function of a parameter. Raises `ConfigError` if there is none of this name."""
    functions = {key: Entry(p.target, p.about) for key, p in PARAMETERS.items()}
    function: Callable[..., Any] = find("parameters", functions, name)
    return function


def check_parameters(names: object) -> tuple[str, ...]:
    """Names of parameters as a tuple; None: all. Raises `ConfigError` for one that does not exist."""
    if names is None:
        return tuple(PARAMETERS)
    chosen = (names,) if isinstance(names, str) else tuple(names)  # type: ignore[arg-type]
    for name in chosen:
        if name not in PARAMETERS:
            raise ConfigError(f"parameters: there is no {name!r}{did_you_mean(str(name), PARAMETERS)}")
    return chosen
