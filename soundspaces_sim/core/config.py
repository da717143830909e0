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

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.keywords import check_keywords, did_you_mean
from soundspaces_sim.core.limits import LONGEST, require, require_between, require_whole
from soundspaces_sim.core.numerics.air import Air, speed_of_sound
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS, check_edges

#: (from, width): from this time on, echogram bins are this wide, s.
#: Widths are multiples of the first.
DEFAULT_TIME_GRID = (
    (0.0, 0.001), (0.05, 0.002), (0.1, 0.005), (0.2, 0.01),
    (5.0, 0.05), (20.0, 0.2),  # memory and time grow with the square of a stretch's bins
)  # fmt: skip


def check_rate(rate: float, name: str = "rate") -> int:
    """A sampling rate in Hz that can be rendered. Raises `ConfigError`."""
    whole = isinstance(rate, (int, float, np.number)) and float(rate).is_integer()
    require(whole and 8000 <= rate <= 192000, name, "8000 to 192000 Hz, a whole number", rate)
    return int(rate)


class _Checked(msgspec.StructMeta):
    """Settings that are unknown, or of another type, are a `ConfigError`."""

    def __call__(cls, *args: Any, **given: Any) -> Any:  # noqa: N805
        stage = cls.__name__.removesuffix("Config").lower()
        check_keywords(cls.__name__, given, cls.__struct_fields__)
        try:
            return super().__call__(*args, **given)
        except TypeError as error:
            fields = msgspec.structs.fields(cls)  # type: ignore[arg-type]
            for name, value in given.items():
                expected = next(f.type for f in fields if f.name == name)
                try:
                    msgspec.convert(value, expected)
                except msgspec.ValidationError as problem:
                    text = f"{stage}.{name}: {str(problem)[0].lower()}{str(problem)[1:]} ({value!r:.80})"
                    raise ConfigError(text) from error
            raise


class _Settings(
    msgspec.Struct, metaclass=_Checked, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """A record whose repr shows what is not as by default."""

    def __repr__(self) -> str:
        default = type(self)()
        own = {name: getattr(self, name) for name in self.__struct_fields__}
        changed = (f"{name}={x!r}" for name, x in own.items() if x != getattr(default, name))
        return f"{type(self).__name__}({', '.join(changed)})"


class GridConfig(_Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Placement and pruning of points (seed paper, "Grid construction").

    `reachable`: also prune points to which no sound gets from a place to stand (see `layout.reachability`);
    false keeps the paper's rule alone.
    """

    spacing: float = 0.5
    height: float = 1.5  # above the floor
    rays: int = 1000  # R
    bounces: int = 10  # B
    min_closedness: float = 0.5  # C_min; 0.1 for scenes with patios
    min_distance: float = 0.05  # d_min
    reachable: bool = True

    def __post_init__(self) -> None:
        require_whole(self, "grid", {"rays": (1, 100_000), "bounces": (1, 1000)})
        require_between(
            self, "grid", {"spacing": (0.0, 1e3, "m"), "height": (0.0, 100.0, "m")}, above=True
        )
        require_between(
            self, "grid", {"min_closedness": (0.0, 1.0, ""), "min_distance": (0.0, 100.0, "m")}
        )


class GraphConfig(_Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The agent that walks between points: its `radius`, its `height`, the highest `step` it takes; and
    the size of the cells in which the floor is looked at, m."""

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


#: Bounds of settings: far beyond what is of use, and short of what would fill memory or never end.
_MOST_WORK = {
    "walks": (1, 1_000_000),
    "specular_ratio": (1, 100),
    "joined_walks": (0, 100_000),
    "joins_per_vertex": (1, 1000),
    "max_bounces": (1, 1_000_000),
    "max_walks": (1, 100_000_000),
}
_ABOVE = {
    "duration": (0.0, LONGEST, "s"),
    "max_duration": (0.0, LONGEST, "s"),
    "target_error": (0.0, 100.0, ""),
    "least_distance": (0.0, 100.0, "m"),
    "radius_min": (0.0, 100.0, "m"),
    "radius_max": (0.0, 100.0, "m"),
    "pressure_kpa": (0.0, 200.0, "kPa"),
}
_BETWEEN = {
    "join_window": (0.0, LONGEST, "s"),
    "radius_growth": (0.0, 10.0, ""),
    "decay_range_db": (20.0, 200.0, "dB"),
    "speed_of_sound": (50.0, 10_000.0, "m/s"),
    "temperature_c": (-60.0, 60.0, "°C"),
    "humidity_percent": (0.0, 100.0, "%"),
}
_MOST_STEPS = 10_000_000  # of the first width, in an echogram


class SimulationConfig(_Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the tracer computes and how hard it tries.

    `bands`: B + 1 edges in Hz. `walks` are traced per point (rounded up to a multiple of 16); the first
    `joined_walks` of them (all, if there are fewer) are also joined to the partner's walks, for paths up
    to `join_window` seconds; longer paths are put together on patches of surface, between which sound travels
    alike for all points (`merging`): far less noise, but what arrives on a patch is taken as even over it. As walks
    then need not be longer than the window, there are four times as many.
    `specular_ratio` times as many walks follow mirror reflections alone.
    `smooth`: late bins are averaged as far as noise hides what is in them (`echogram.denoise`); false keeps them as
    they come.
    `diffraction`: sound bends round the edges of surfaces (one or two of them, rigid).
    `sheets`: free-hanging curtains and the like let sound pass (`scene.porous_layers`); false takes
    both their faces as mounted on a wall.
    `reflection`: of materials that do not say it themselves: ``random``, as at random incidence at every angle, or
    ``angle``, as a locally reacting wall of that absorption at random incidence (`transport.bsdf.impedance`).
    `scattering`: ``size``, what the materials say and beside it what surfaces that end scatter by diffraction
    (`transport.bsdf.finite_size`), or ``table``, the former alone.
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
        require_whole(self, "simulation", _MOST_WORK)
        require(self.joined_walks != 1, "simulation.joined_walks", "0, or 2 and more", self.joined_walks)
        require_between(self, "simulation", _ABOVE, above=True)
        require_between(self, "simulation", _BETWEEN)
        require(
            self.radius_min <= self.radius_max,
            "simulation.radius_min", "positive, at most radius_max", self.radius_min,
        )  # fmt: skip
        self._check_time_grid()

    def _check_time_grid(self) -> None:
        grid = self.time_grid
        starts, widths = [g[0] for g in grid], [g[1] for g in grid]
        ok = bool(grid) and starts[0] == 0.0 and all(1e-9 <= w < math.inf for w in widths)
        ok = ok and all(math.isfinite(start) for start in starts)
        require(ok, "simulation.time_grid", "(from, width) pairs from 0 s, widths above 0", grid)
        for (start, width), (end, _) in pairwise(grid):
            ok = ok and end > start and abs((end - start) / width % 1.0 - 0.5) > 0.5 - 1e-6
        for width in widths[1:]:
            ok = ok and abs(width / widths[0] % 1.0 - 0.5) > 0.5 - 1e-6 and width >= widths[0]
        require(
            ok, "simulation.time_grid",
            "(from, width) pairs from 0 s, each span and width a multiple of the first width", grid,
        )  # fmt: skip
        longest = self.max_duration if self.duration is None else self.duration
        require(
            longest / widths[0] <= _MOST_STEPS,
            "simulation.time_grid", f"a first width of at least {longest / _MOST_STEPS:.3g} s", widths[0],
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
    `renderer`: how energy becomes pressure, a name of `rendering.renderers` (``default``, ``smooth``, ``paper``).
    `store`: ``echogram`` (a few kB per pair, from which any waveform is made on reading), ``waveform``,
    or ``both``. Of stored waveforms: `headings` in degrees for binaural responses beside the ambisonic
    one; `sample_format` ``int16`` (with a scale per response) or ``float32``.
    `licence`, `citation`: of the data, as its maker wishes; every file carries them. `author` (whom to ask, a name
    and an address), `organization`: of who made it; exports carry them.
    """

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
    unknown = re.fullmatch(r"Object contains unknown field `(.*?)`(?: - at `\$\.(\w+)`)?", message)
    if unknown is not None:
        name, stage = unknown.groups()
        kinds = {f.name: f.type for f in msgspec.structs.fields(JobConfig)}
        known = kinds if stage is None else kinds[stage].__struct_fields__
        where = name if stage is None else f"{stage}.{name}"
        return f"{where}: there is no such setting{did_you_mean(name, known)}"
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
