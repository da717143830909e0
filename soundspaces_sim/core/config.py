"""Settings: one frozen record per stage, validated once, where they enter.

Units are SI unless a name says otherwise. TOML files have one table per stage (`pipelines/*.toml`).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, ClassVar, Literal

import msgspec
import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.io.untrusted import read_toml
from soundspaces_sim.core.keywords import did_you_mean
from soundspaces_sim.core.limits import require, require_between, require_whole
from soundspaces_sim.core.settings import Settings, choices_of, flat, without_null
from soundspaces_sim.core.simulation_config import (
    DEFAULT_TIME_GRID as DEFAULT_TIME_GRID,
    SimulationConfig as SimulationConfig,
    of_dataset,
    with_switches,
)


def check_rate(rate: float, name: str = "rate") -> int:
    """A sampling rate in Hz that can be rendered. Raises `ConfigError`."""
    whole = isinstance(rate, (int, float, np.number)) and float(rate).is_integer()
    require(whole and 8000 <= rate <= 192000, name, "8000 to 192000 Hz, a whole number", rate)
    return int(rate)


class GridConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Placement and pruning of points (seed paper, "Grid construction").

    `spacing`: distance of neighbouring points, m. `height`: of the points above the floor, m. `rays`: that leave a
    point to tell how closed its surroundings are. `bounces`: of each of these rays. `min_closedness`: least share
    of bounces that rays make without escaping; 0.1 for scenes with patios. `min_distance`: from a point to the
    nearest surface, m. `reachable`: also prune points to which no sound gets from a place to stand; false keeps the
    paper's rule alone. `standing`: keep only points at which an agent can stand, so that no pair leads to a point
    above a table. `follow_floor`: points stand above the floor under each, on slopes, steps, stages and balconies;
    false is the paper's flat slice, above one height per storey.
    """

    stage: ClassVar[str] = "grid"
    spacing: float = 0.5
    height: float = 1.5  # above the floor
    rays: int = 1000  # R
    bounces: int = 10  # B
    min_closedness: float = 0.5  # C_min; 0.1 for scenes with patios
    min_distance: float = 0.05  # d_min
    reachable: bool = True
    standing: bool = False
    follow_floor: bool = True

    def __post_init__(self) -> None:
        require_whole(self, "grid", {"rays": (1, 100_000), "bounces": (1, 1000)})
        require_between(self, "grid", {"height": (0.0, 100.0, "m")}, above=True)
        limits = {
            "spacing": (1e-3, 1e3, "m"),
            "min_closedness": (0.0, 1.0, ""),
            "min_distance": (0.0, 100.0, "m"),
        }
        require_between(self, "grid", limits)


class GraphConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The agent that walks between points.

    `radius`: of the agent, m. `height`: of the agent, m. `step`: the highest that it takes, m. `cell`: size of the
    cells in which the floor is looked at, m.
    """

    stage: ClassVar[str] = "graph"
    radius: float = 0.1
    height: float = 1.5
    step: float = 0.2
    cell: float = 0.03

    def __post_init__(self) -> None:
        require_between(self, "graph", {"height": (0.0, 100.0, "m")}, above=True)
        require_between(
            self,
            "graph",
            {"radius": (0.0, 10.0, "m"), "step": (0.0, 10.0, "m"), "cell": (0.01, 0.5, "m")},
        )


class DatasetConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is stored, and what the reader makes of it.

    `rate`: of stored waveforms, and the reader's default, Hz. `seed`: of the simulation and of the noise in
    responses. `tile`: points per side of a tile; not set, it follows from the memory. `renderer`: how energy
    becomes pressure: ``default``, ``smooth``, ``paper`` or ``direct``. `store`: ``echogram`` (a few kB per pair,
    from which any waveform is made on reading), ``waveform``, or ``both``. `headings`: of stored binaural
    responses, which stand beside the ambisonic one, degrees. `sample_format`: of stored waveforms; ``int16`` has a
    scale per response. `licence`: of the data; every file carries it. `author`: whom to ask, a name and an address;
    exports carry it. `organization`: of the author; exports carry it. `citation`: what is to be cited; every
    file carries it.
    """

    stage: ClassVar[str] = "dataset"
    rate: int = 44100
    seed: int = 0
    tile: int | None = None
    renderer: str = "default"
    store: Literal["echogram", "waveform", "both"] = "echogram"
    headings: tuple[float, ...] = ()
    sample_format: Literal["int16", "float32"] = "int16"
    licence: str = ""
    author: str = ""
    organization: str = ""
    citation: str = "soundspaces_sim; C. Chen et al., SoundSpaces, ECCV 2020"

    def __post_init__(self) -> None:
        check_rate(self.rate, "dataset.rate")
        require(0 <= self.seed < 2**63, "dataset.seed", "0 to 2^63 - 1", self.seed)
        require(self.tile is None or 1 <= self.tile <= 10_000, "dataset.tile", "1 to 10,000", self.tile)
        for name in ("licence", "citation", "author", "organization"):
            length = len(getattr(self, name))
            require(length <= 10_000, f"dataset.{name}", "at most 10,000 characters", length)
        require(
            len(set(self.headings)) == len(self.headings)
            and all(0.0 <= h < 360.0 for h in self.headings),
            "dataset.headings",
            "different degrees from 0 to below 360",
            self.headings,
        )


class JobConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything `make rirs` needs beside the scene."""

    grid: GridConfig = GridConfig()
    graph: GraphConfig = GraphConfig()
    simulation: SimulationConfig = SimulationConfig()
    dataset: DatasetConfig = DatasetConfig()

    def __post_init__(self) -> None:
        # what a pair's bits depend on is the same for any number of points
        msgspec.structs.force_setattr(self, "simulation", of_dataset(self.simulation))
        counted, store = self.simulation.materials.enabled, self.dataset.store
        require(
            not (counted and store == "waveform"),
            "dataset.store",
            "echogram or both with simulation.materials, whose counts belong to echograms",
            store,
        )


def as_config(raw: dict[str, Any]) -> JobConfig:
    """The settings of a parsed TOML file. Raises `ConfigError`, which names the setting."""
    simulation, tables = raw.get("simulation"), raw
    if isinstance(simulation, dict):  # tables within [simulation] may be given as true or false
        tables = {**raw, "simulation": with_switches(simulation)}
    try:
        return msgspec.convert(tables, JobConfig)
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, ConfigError):
            raise error.__cause__ from error
        raise ConfigError(_in_words(without_null(str(error)), raw)) from error


def _in_words(message: str, raw: dict[str, Any]) -> str:
    """msgspec's message about ``$.stage.name``, with the setting first, and what a choice is between."""
    unknown = re.fullmatch(r"Object contains unknown field `(.*?)`(?: - at `\$\.([\w.]+)`)?", message)
    if unknown is not None:
        name, stage = unknown.groups()
        where = name if stage is None else f"{stage}.{name}"
        known = [f.name for f in msgspec.structs.fields(_record(stage or ""))]
        return f"{where}: there is no such setting{did_you_mean(name, known)}"
    found = re.fullmatch(r"(.*) - at `\$\.([\w.]+)\.(\w+)`", message)
    if found is None:
        return message
    problem, stage, name = found.groups()
    given: Any = raw
    for key in stage.split("."):
        given = given.get(key, {}) if isinstance(given, dict) else {}
    choices = [choices_of(f.type) for f in msgspec.structs.fields(_record(stage)) if f.name == name]
    if choices and choices[0]:
        *most, last = choices[0]
        return f"{stage}.{name}: expected {', '.join(most)} or {last}, got {given[name]!r}"
    text = f" ({given[name]!r})" if isinstance(given, dict) and name in given else ""
    return f"{stage}.{name}: {problem[0].lower()}{problem[1:]}{text}"


def _record(stage: str) -> type[Any]:
    """The record of a table such as ``simulation.diffraction``."""
    kind: type[Any] = JobConfig
    for key in filter(None, stage.split(".")):
        kind = next(f.type for f in msgspec.structs.fields(kind) if f.name == key)
    return kind


def differences(a: JobConfig, b: JobConfig) -> list[str]:
    """Settings in which two configs differ, as ``grid.spacing 0.5, now 1.0``."""
    one, other = flat(a), flat(b)
    return [f"{name} {one[name]!r}, now {other[name]!r}" for name in one if one[name] != other[name]]


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
