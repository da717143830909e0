"""Settings of the simulation, with a table for each technique that has some."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, ClassVar, Literal

import msgspec

from soundspaces_sim.core.limits import LEAST_DISTANCE, LONGEST, require, require_between, require_whole
from soundspaces_sim.core.numerics.air import Air, speed_of_sound
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS, check_edges
from soundspaces_sim.core.numerics.reflection_laws import LawName
from soundspaces_sim.core.settings import Settings

#: (from, width): from this time on, echogram bins are this wide, s.
#: Widths are multiples of the first.
DEFAULT_TIME_GRID = (
    (0.0, 0.001), (0.05, 0.002), (0.1, 0.005), (0.2, 0.01),
    (5.0, 0.05), (20.0, 0.2),  # memory and time grow with the square of a stretch's bins
)  # fmt: skip


# Tables that may be given as true or false.
_SWITCHES = ("radiance_transfer", "diffraction", "materials")


def with_switches(simulation: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of [simulation], with the tables that ``true`` and ``false`` stand for."""
    return {
        name: {"enabled": value} if name in _SWITCHES and isinstance(value, bool) else value
        for name, value in simulation.items()
    }


#: Settings of version 0.3.0 that are constants now, as files have them.
_CONSTANT: dict[str, Any] = {
    "least_distance": LEAST_DISTANCE,
    "air_in_bands": "mean",
    "pressure_kpa": 101.325,
    "low": {"reactance": 0.0},
    "connections": {"per_vertex": 1},
    "receiver_volumes": {"radius_min": 0.1, "radius_growth": 0.05, "radius_max": 1.0},
}


def without_constants(simulation: Any, constant: Mapping[str, Any] = _CONSTANT) -> Any:
    """The settings of [simulation] in a file of 0.3.0 without those that are constants now, where they have their
    values; others stay, and are refused."""
    if not isinstance(simulation, dict):
        return simulation
    out = {}
    for name, value in simulation.items():
        known = constant.get(name)
        left = without_constants(value, known) if isinstance(known, dict) else value
        if name not in constant or left not in (known, {}):
            out[name] = left
    return out


#: Bounds of settings: far beyond what is of use, and short of what would fill memory or never end.
_MOST_WORK = {"walks": (1, 1_000_000), "max_bounces": (1, 1_000_000), "max_walks": (1, 100_000_000)}
_ABOVE = {"target_error": (0.0, 100.0, "")}
_BETWEEN = {
    "duration": (1e-3, LONGEST, "s"),
    "max_duration": (1e-3, LONGEST, "s"),
    "decay_range_db": (20.0, 200.0, "dB"),
    "speed_of_sound": (50.0, 10_000.0, "m/s"),
    "temperature_c": (-60.0, 60.0, "°C"),
    "humidity_percent": (0.0, 100.0, "%"),
}
_WIDEST_FIRST, _WIDEST = 0.1, LONGEST  # s, of bins
#: Of datasets, whose subpaths are a fixed number; of single simulations, which add subpaths until an error is met.
DEFAULT_WALKS, DEFAULT_ERROR = 3000, 0.05
# Subpaths of a point, where nobody has asked for an error: some more than of datasets.
_MOST_BY_DEFAULT = 4096
_MOST_STEPS = 10_000_000  # of the first width, in an echogram


class SpecularConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Subpaths that follow specular reflections alone.

    `ratio`: how many times as many of them there are as `simulation.walks`."""

    stage: ClassVar[str] = "simulation.specular"
    ratio: int = 4

    def __post_init__(self) -> None:
        require_whole(self, self.stage, {"ratio": (1, 100)})


class ConnectionsConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Vertex connection: vertices of subpaths from both ends are connected.

    `subpaths`: how many of a point's subpaths are connected to the partner's, each vertex to another; all, if there
    are fewer. `window`: length of the paths that are made so, at most, s."""

    stage: ClassVar[str] = "simulation.connections"
    subpaths: int = 64
    window: float = 0.05

    def __post_init__(self) -> None:
        require_whole(self, self.stage, {"subpaths": (0, 100_000)})
        require(self.subpaths != 1, f"{self.stage}.subpaths", "0, or 2 and more", self.subpaths)
        require_between(self, self.stage, {"window": (0.0, LONGEST, "s")})


class RadianceTransferConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Acoustic radiance transfer: scattered paths longer than the connections' window are put together on
    patches of surface, between which sound travels alike for all points. Far less noise, but energy that
    arrives on a patch counts as even over it.

    `enabled`: if so, subpaths end with the window, and there are four times as many. `subpaths`: from patch to
    patch, that all points of a job have in common (``shared``) or that each point has for itself (``own``):
    less work where points are few; ``auto`` takes what is less for a job's points. Not set, it is ``shared`` in
    datasets, and ``auto`` in single simulations that have no number of `simulation.walks`."""

    stage: ClassVar[str] = "simulation.radiance_transfer"
    enabled: bool = True
    subpaths: Literal["shared", "own", "auto"] | None = None


class DiffractionConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Diffraction at the edges of surfaces.

    `enabled`: ways round edges, however many; edges are taken as rigid."""

    stage: ClassVar[str] = "simulation.diffraction"
    enabled: bool = True


class MaterialsConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Counts of reflections, so that other absorption can be chosen on reading (`open_dataset(…,
    materials=…)`).

    `enabled`: whether they are made. `groups`: how many materials are counted, those that sound meets most
    often."""

    stage: ClassVar[str] = "simulation.materials"
    enabled: bool = False
    groups: int = 8

    def __post_init__(self) -> None:
        require_whole(self, self.stage, {"groups": (1, 12)})


class LowConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Sound below the lowest bands' edge: by rays as all else, or as waves, which have the modes of rooms
    (neighbours/waves/README.md). Energies stay as they are; renderers take the waves below the edge.

    `method`: ``waves`` runs a finite-difference solver once per point. `edge`: below which waves are simulated,
    Hz; not set, the first band's. `cells_per_wavelength`: of the lattice, at the edge."""

    stage: ClassVar[str] = "simulation.low"
    method: Literal["rays", "waves"] = "rays"
    edge: float | None = None  # Hz
    cells_per_wavelength: float = 12.0

    def __post_init__(self) -> None:
        limits = {"edge": (30.0, 2000.0, "Hz"), "cells_per_wavelength": (6.0, 40.0, "")}
        require_between(self, self.stage, limits)


class SimulationConfig(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the tracer.

    `bands`: B + 1 edges, Hz. `walks`: subpaths per point (rounded up to a multiple of 16); not set, datasets
    take 3,000, and single simulations (`simulate`, `simulate_many`, rooms, streams) as many as `target_error`
    needs. `target_error`: the relative standard error of early and late energy, in every band, that is wanted
    instead: subpaths are added in rounds until a pair's error bars are below it, or `max_walks` per point are
    spent; rounds grow, or have `walks` each if both are given. Not set, single simulations take 0.05.
    `max_walks`: subpaths per point that `target_error` spends at most; 4,096 in single simulations without a
    config. `denoise`: late bins are averaged as far as noise hides their course; false keeps them raw.
    `porous_layers`: free-hanging curtains and the like let sound pass; false takes both their faces as mounted
    on a wall. `reflection`: of materials without a law of their own: ``angle``, as a locally reacting wall of
    that absorption at random incidence, or ``random``, as at random incidence at every angle; not set, it is
    ``angle``, but ``random`` where reflections are counted, as counts tell other absorption only so. `scattering`:
    ``size`` adds to the materials' scattering the diffraction of surfaces of finite size; ``table`` is the
    materials' alone. `max_bounces`: reflections after which a subpath ends; sound that is still loud there is
    lost, so it is far more than a live room needs within `max_duration` (the seed paper has 200). `duration`:
    length of echograms, s; not set, it is measured (energy down by `decay_range_db`). `max_duration`: of a
    measured length, at most, s. `decay_range_db`: by which energy falls within a measured length, dB.
    `time_grid`: pairs of a time and the width of the bins from there on, s. `speed_of_sound`: m/s; not set, it
    follows from the temperature. `air_absorption`: as ISO 9613-1 has it. `temperature_c`: of the air, °C.
    `humidity_percent`: relative, %; its pressure is that at sea level.
    """

    stage: ClassVar[str] = "simulation"
    bands: tuple[float, ...] = DEFAULT_BANDS
    walks: int | None = None
    specular: SpecularConfig = SpecularConfig()
    connections: ConnectionsConfig = ConnectionsConfig()
    radiance_transfer: RadianceTransferConfig = RadianceTransferConfig()
    diffraction: DiffractionConfig = DiffractionConfig()
    materials: MaterialsConfig = MaterialsConfig()
    low: LowConfig = LowConfig()
    denoise: bool = True
    porous_layers: bool = True
    reflection: LawName | None = None
    scattering: Literal["table", "size"] = "size"
    max_bounces: int = 10_000
    target_error: float | None = None
    max_walks: int = 32000
    duration: float | None = None
    max_duration: float = 5.0
    decay_range_db: float = 70.0
    time_grid: tuple[tuple[float, float], ...] = DEFAULT_TIME_GRID
    speed_of_sound: float | None = 343.0  # m/s; None takes it from the temperature
    air_absorption: bool = True
    temperature_c: float = 20.0
    humidity_percent: float = 50.0

    @classmethod
    def _given(cls, given: dict[str, Any]) -> dict[str, Any]:
        return with_switches(given)

    def __post_init__(self) -> None:
        msgspec.structs.force_setattr(self, "bands", check_edges(self.bands))
        given = {name: limits for name, limits in _MOST_WORK.items() if getattr(self, name) is not None}
        require_whole(self, self.stage, given)
        require_between(self, self.stage, _ABOVE, above=True)
        require_between(self, self.stage, _BETWEEN)
        self._check_time_grid()
        if self.target_error is not None and self.walks is not None:
            require(
                self.walks <= self.max_walks,
                "simulation.walks",
                f"at most max_walks, {self.max_walks}, with target_error",
                self.walks,
            )
        if self.low.method == "waves" and self.low.edge is None:
            LowConfig(method="waves", edge=self.bands[1])  # raises for a first band that is none

    def _check_time_grid(self) -> None:
        grid = self.time_grid
        starts, widths = [g[0] for g in grid], [g[1] for g in grid]
        ok = bool(grid) and starts[0] == 0.0 and all(1e-9 <= w <= _WIDEST for w in widths)
        ok = ok and widths[0] <= _WIDEST_FIRST and all(start <= LONGEST for start in starts)
        require(
            ok,
            "simulation.time_grid",
            f"(from, width) pairs from 0 to {LONGEST:g} s, widths above 0, the first at most {_WIDEST_FIRST:g} s",
            grid,
        )
        for (start, width), (end, _) in pairwise(grid):
            ok = ok and end > start and abs((end - start) / width % 1.0 - 0.5) > 0.5 - 1e-6
        for width in widths[1:]:
            ok = ok and abs(width / widths[0] % 1.0 - 0.5) > 0.5 - 1e-6 and width >= widths[0]
        require(
            ok,
            "simulation.time_grid",
            "(from, width) pairs from 0 s, each span and width a multiple of the first width",
            grid,
        )
        longest = self.max_duration if self.duration is None else self.duration
        require(
            longest / widths[0] <= _MOST_STEPS,
            "simulation.time_grid",
            f"a first width of at least {longest / _MOST_STEPS:.3g} s",
            widths[0],
        )

    @property
    def c(self) -> float:
        """Speed of sound, m/s."""
        if self.speed_of_sound is not None:
            return self.speed_of_sound
        return speed_of_sound(self.temperature_c)

    @property
    def law(self) -> LawName:
        """`reflection`, or what it is where it is None."""
        return self.reflection or ("random" if self.materials.enabled else "angle")

    @property
    def air(self) -> Air | None:
        """The air that absorbs sound; None if none does. A band keeps the mean over its frequencies (ISO 9613-1),
        and renderers put back the course within it."""
        if not self.air_absorption:
            return None
        return Air(self.temperature_c, self.humidity_percent, speed_of_sound=self.c)


def of_dataset(config: SimulationConfig) -> SimulationConfig:
    """The same with a fixed number of subpaths, where it has neither that nor an error."""
    if config.walks is None and config.target_error is None:
        config = msgspec.structs.replace(config, walks=DEFAULT_WALKS)
    return config if config.radiance_transfer.subpaths is not None else _with_subpaths(config, "shared")


def of_simulation(config: SimulationConfig) -> SimulationConfig:
    """The same with an error to be met, where it has neither that nor a number of subpaths. Counts of reflections
    are not averaged over rounds: with these the number is that of datasets."""
    if config.walks is not None or config.materials.enabled:
        return of_dataset(config)
    if config.target_error is None:
        config = msgspec.structs.replace(
            config, target_error=DEFAULT_ERROR, max_walks=min(config.max_walks, _MOST_BY_DEFAULT)
        )
    return config if config.radiance_transfer.subpaths is not None else _with_subpaths(config, "auto")


def _with_subpaths(config: SimulationConfig, kind: Literal["shared", "auto"]) -> SimulationConfig:
    transfer = msgspec.structs.replace(config.radiance_transfer, subpaths=kind)
    return msgspec.structs.replace(config, radiance_transfer=transfer)


def number_text(config: SimulationConfig) -> str:
    """How many subpaths a point has, for people: ``3,000``, or until which error they are added."""
    walks = "" if config.walks is None else f"{config.walks:,}"
    if config.target_error is None:
        return walks or f"{DEFAULT_WALKS:,}"
    return f"rounds{walks and ' of ' + walks}, up to {config.max_walks:,}, for an error of {config.target_error:g}"
