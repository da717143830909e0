"""Settings: one frozen record per stage, validated once, where they enter.

Units are SI unless a name says otherwise. TOML files have one table per stage (`pipelines/*.toml`).
"""

from __future__ import annotations

import math
import re
from itertools import pairwise
from typing import Any, Literal, get_args

import msgspec
import numpy as np

from soundspaces_sim.base.air import Air, speed_of_sound
from soundspaces_sim.base.bands import DEFAULT_BANDS, check_edges
from soundspaces_sim.base.errors import ConfigError

#: (from, width): from this time on, echogram bins are this wide, s.
#: Widths are multiples of the first.
DEFAULT_TIME_GRID = ((0.0, 0.001), (0.05, 0.002), (0.1, 0.005), (0.2, 0.01))


def _require(condition: bool, name: str, expected: str, got: object) -> None:
    if not condition:
        raise ConfigError(f"{name}: expected {expected}, got {got!r}")


def check_rate(rate: float, name: str = "rate") -> int:
    """A sampling rate in Hz that can be rendered. Raises `ConfigError`."""
    whole = isinstance(rate, (int, float, np.number)) and float(rate).is_integer()
    _require(whole and 8000 <= rate <= 192000, name, "8000 to 192000 Hz, a whole number", rate)
    return int(rate)


class _Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A record whose repr shows what is not as by default."""

    def __repr__(self) -> str:
        default = type(self)()
        own = {name: getattr(self, name) for name in self.__struct_fields__}
        changed = (f"{name}={x!r}" for name, x in own.items() if x != getattr(default, name))
        return f"{type(self).__name__}({', '.join(changed)})"


class GridConfig(_Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Placement and pruning of points (seed paper, "Grid construction").

    `reachable`: also prune points to which no sound gets from a place to stand (see `places.reach`); false keeps
    the paper's rule alone.
    """

    spacing: float = 0.5
    height: float = 1.5  # above the floor
    rays: int = 1000  # R
    bounces: int = 10  # B
    min_closedness: float = 0.5  # C_min; 0.1 for scenes with patios
    min_distance: float = 0.05  # d_min
    reachable: bool = True

    def __post_init__(self) -> None:
        _require(0.0 < self.spacing < 1e3, "grid.spacing", "a positive length in m", self.spacing)
        _require(self.height > 0.0, "grid.height", "a positive length in m", self.height)
        _require(self.rays >= 1, "grid.rays", "at least 1", self.rays)
        _require(self.bounces >= 1, "grid.bounces", "at least 1", self.bounces)
        _require(0.0 <= self.min_closedness <= 1.0, "grid.min_closedness", "0 to 1", self.min_closedness)
        _require(self.min_distance >= 0.0, "grid.min_distance", "0 or more", self.min_distance)


class GraphConfig(_Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The agent that walks between points: its `radius`, its `height`, the highest `step` it takes; and
    the size of the cells in which the floor is looked at, m."""

    radius: float = 0.1
    height: float = 1.5
    step: float = 0.2
    cell: float = 0.03

    def __post_init__(self) -> None:
        _require(self.radius >= 0.0, "graph.radius", "0 or more, in m", self.radius)
        _require(self.height > 0.0, "graph.height", "a positive length in m", self.height)
        _require(self.step >= 0.0, "graph.step", "0 or more, in m", self.step)
        _require(0.01 <= self.cell <= 0.5, "graph.cell", "0.01 to 0.5 m", self.cell)


class SimulationConfig(_Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the tracer computes and how hard it tries.

    `bands`: B + 1 edges in Hz. `walks` are traced per point (rounded up to a multiple of 16); the first
    `joined_walks` of them (all, if there are fewer) are also joined to the partner's walks, for paths up
    to `join_window` seconds; longer paths are put together on patches of surface, between which sound travels
    alike for all points (`merging`): far less noise, but what arrives on a patch is taken as even over it. As walks
    then need not be longer than the window, there are four times as many.
    `specular_ratio` times as many walks follow mirror reflections alone.
    `smooth`: late bins are averaged as far as noise hides what is in them (`echo.smooth`); false keeps them as
    they come.
    `diffraction`: sound bends round the edges of surfaces (one or two of them, rigid).
    `sheets`: free-hanging curtains and the like let sound pass (`scene.sheets`); false takes both their faces as
    mounted on a wall.
    `reflection`: of materials that do not say it themselves: ``random``, as at random incidence at every angle, or
    ``angle``, as a locally reacting wall of that absorption at random incidence (`transport.angle`).
    `scattering`: ``size``, what the materials say and beside it what surfaces that end scatter by diffraction
    (`scene.finite`), or ``table``, the former alone.
    `max_bounces`: reflections after which a walk ends; sound that is still loud there is lost, so it is far more
    than a live room needs within `max_duration` (the seed paper has 200).
    Detectors have radius `radius_min` + `radius_growth` * path length, at most `radius_max`.
    `target_error`: relative standard error of early and late energy, in every band, below which a pair
    needs no more walks: they are added in rounds of `walks`, up to `max_walks` per point.
    `duration`: length of echograms in s; None measures it (energy down by `decay_range_db`).
    `air_in_bands`: what air leaves of a band: the ``mean`` over its frequencies (ISO 9613-1), whose course within
    the band renderers put back, or that of a tone at its ``centre``, as datasets from before the choice have it.
    """

    bands: tuple[float, ...] = DEFAULT_BANDS
    walks: int = 3000
    specular_ratio: int = 4
    joined_walks: int = 64
    joins_per_vertex: int = 1
    join_window: float = 0.05
    merging: bool = True
    smooth: bool = True
    diffraction: bool = True
    sheets: bool = True
    reflection: Literal["random", "angle"] = "random"
    scattering: Literal["table", "size"] = "size"
    max_bounces: int = 10_000
    radius_min: float = 0.1
    radius_growth: float = 0.05
    radius_max: float = 1.0
    target_error: float | None = None
    max_walks: int = 32000
    duration: float | None = None
    max_duration: float = 5.0
    decay_range_db: float = 70.0
    time_grid: tuple[tuple[float, float], ...] = DEFAULT_TIME_GRID
    least_distance: float = 0.05  # closer pairs have the direct level of this distance
    speed_of_sound: float | None = 343.0  # m/s; None takes it from the temperature
    air_absorption: bool = True
    air_in_bands: Literal["mean", "centre"] = "mean"
    temperature_c: float = 20.0
    humidity_percent: float = 50.0
    pressure_kpa: float = 101.325

    def __post_init__(self) -> None:
        msgspec.structs.force_setattr(self, "bands", check_edges(self.bands))
        _require(self.walks >= 1, "simulation.walks", "at least 1", self.walks)
        _require(
            self.joined_walks >= 0 and self.joined_walks != 1,
            "simulation.joined_walks", "0, or 2 and more", self.joined_walks,
        )  # fmt: skip
        _require(self.max_walks >= 1, "simulation.max_walks", "at least 1", self.max_walks)
        _require(
            self.specular_ratio >= 1, "simulation.specular_ratio", "at least 1", self.specular_ratio
        )
        _require(
            self.joins_per_vertex >= 1,
            "simulation.joins_per_vertex", "at least 1", self.joins_per_vertex,
        )  # fmt: skip
        _require(self.join_window >= 0.0, "simulation.join_window", "0 or more", self.join_window)
        _require(self.max_bounces >= 1, "simulation.max_bounces", "at least 1", self.max_bounces)
        _require(
            0.0 < self.radius_min <= self.radius_max,
            "simulation.radius_min", "positive, at most radius_max", self.radius_min,
        )  # fmt: skip
        _require(self.radius_growth >= 0.0, "simulation.radius_growth", "0 or more", self.radius_growth)
        for name in ("target_error", "duration", "max_duration", "least_distance", "speed_of_sound"):
            value = getattr(self, name)
            _require(value is None or value > 0.0, f"simulation.{name}", "a positive number", value)
        _require(
            20.0 <= self.decay_range_db <= 200.0,
            "simulation.decay_range_db", "20 to 200", self.decay_range_db,
        )  # fmt: skip
        _require(
            -60.0 <= self.temperature_c <= 60.0,
            "simulation.temperature_c", "-60 to 60", self.temperature_c,
        )  # fmt: skip
        _require(
            0.0 <= self.humidity_percent <= 100.0,
            "simulation.humidity_percent", "0 to 100", self.humidity_percent,
        )  # fmt: skip
        _require(
            0.0 < self.pressure_kpa <= 200.0,
            "simulation.pressure_kpa", "0 to 200", self.pressure_kpa,
        )  # fmt: skip
        self._check_time_grid()

    def _check_time_grid(self) -> None:
        grid = self.time_grid
        starts, widths = [g[0] for g in grid], [g[1] for g in grid]
        ok = bool(grid) and starts[0] == 0.0 and all(1e-9 <= w < math.inf for w in widths)
        ok = ok and all(math.isfinite(start) for start in starts)
        _require(ok, "simulation.time_grid", "(from, width) pairs from 0 s, widths above 0", grid)
        for (start, width), (end, _) in pairwise(grid):
            ok = ok and end > start and abs((end - start) / width % 1.0 - 0.5) > 0.5 - 1e-6
        for width in widths[1:]:
            ok = ok and abs(width / widths[0] % 1.0 - 0.5) > 0.5 - 1e-6 and width >= widths[0]
        _require(
            ok, "simulation.time_grid",
            "(from, width) pairs from 0 s, each span and width a multiple of the first width", grid,
        )  # fmt: skip

    @property
    def c(self) -> float:
        """Speed of sound, m/s."""
        if self.speed_of_sound is not None:
            return self.speed_of_sound
        return speed_of_sound(self.temperature_c)

    @property
    def air(self) -> Air | None:
        """The air that absorbs sound; None if none does."""
        if not self.air_absorption:
            return None
        return Air(
            self.temperature_c, self.humidity_percent, self.pressure_kpa, self.c,
            centre=self.air_in_bands == "centre",
        )  # fmt: skip

    @property
    def air_within_bands(self) -> Air | None:
        """The air whose course within bands is in the energies, for renderers to put back; None if it is not."""
        return self.air if self.air_in_bands == "mean" else None


class DatasetConfig(_Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is stored, and what the reader makes of it.

    `rate`: Hz; of stored waveforms, and the reader's default. `tile`: points per side of a tile.
    `renderer`: how energy becomes pressure, a name of `sound.renderers` (``default``, ``smooth``, ``paper``).
    `store`: ``echogram`` (a few kB per pair, from which any waveform is made on reading), ``waveform``,
    or ``both``. Of stored waveforms: `headings` in degrees for binaural responses beside the ambisonic
    one; `sample_format` ``int16`` (with a scale per response) or ``float32``.
    `licence`, `citation`: of the data, as its maker wishes; every file carries them.
    """

    rate: int = 44100
    seed: int = 0
    tile: int | None = None
    renderer: str = "default"
    store: Literal["echogram", "waveform", "both"] = "echogram"
    headings: tuple[float, ...] = ()
    sample_format: Literal["int16", "float32"] = "int16"
    licence: str = ""
    citation: str = "soundspaces_sim; C. Chen et al., SoundSpaces, ECCV 2020"

    def __post_init__(self) -> None:
        check_rate(self.rate, "dataset.rate")
        _require(0 <= self.seed < 2**63, "dataset.seed", "0 to 2^63 - 1", self.seed)
        _require(self.tile is None or self.tile >= 1, "dataset.tile", "at least 1", self.tile)
        _require(
            len(set(self.headings)) == len(self.headings) and all(0.0 <= h < 360.0 for h in self.headings),
            "dataset.headings", "different degrees from 0 to below 360", self.headings,
        )  # fmt: skip


class JobConfig(_Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything `make rirs` needs beside the scene."""

    grid: GridConfig = GridConfig()
    graph: GraphConfig = GraphConfig()
    simulation: SimulationConfig = SimulationConfig()
    dataset: DatasetConfig = DatasetConfig()


def as_config(raw: dict[str, Any]) -> JobConfig:
    """The settings of a parsed TOML file. Raises `ConfigError`, which names the setting."""
    try:
        return msgspec.convert(raw, JobConfig)
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, ConfigError):
            raise error.__cause__ from error
        raise ConfigError(_in_words(str(error), raw)) from error


def _in_words(message: str, raw: dict[str, Any]) -> str:
    """msgspec's message about ``$.stage.name``, with the setting first, and what a choice is between."""
    found = re.fullmatch(r"(.*) - at `\$\.(\w+)\.(\w+)`", message)
    if found is None:
        return message
    problem, stage, name = found.groups()
    (kind,) = (f.type for f in msgspec.structs.fields(JobConfig) if f.name == stage)
    choices = [get_args(f.type) for f in msgspec.structs.fields(kind) if f.name == name]
    if choices and choices[0] and all(isinstance(choice, str) for choice in choices[0]):
        *most, last = choices[0]
        return f"{stage}.{name}: expected {', '.join(most)} or {last}, got {raw[stage][name]!r}"
    given = f" ({raw[stage][name]!r})" if name in raw[stage] else ""
    return f"{stage}.{name}: {problem[0].lower()}{problem[1:]}{given}"


def differences(a: JobConfig, b: JobConfig) -> list[str]:
    """Settings in which two configs differ, as ``grid.spacing 0.5, now 1.0``."""
    out = []
    for stage in JobConfig.__struct_fields__:
        one, other = getattr(a, stage), getattr(b, stage)
        for name in one.__struct_fields__:
            if getattr(one, name) != getattr(other, name):
                out.append(f"{stage}.{name} {getattr(one, name)!r}, now {getattr(other, name)!r}")
    return out
