"""Options of continuous tasks, each validated once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, get_args

from soundspaces_continuous.episodes import ContinuousEpisode, Rules
from soundspaces_continuous.sound_field import PathsName
from soundspaces_sim import ConfigError, Scene
from soundspaces_sim.nav import NavData, SoundBank
from soundspaces_sim.parts import (
    DEFAULT_SOUND as DEFAULT,
    POINTGOAL,
    as_sensors,
    check_keywords,
    check_picture_size as check_size,
    nearest_name as nearest,
)

_N_FFT, _HOP_S = 512, 0.01
_FARTHEST = 1000.0  # m


@dataclass(frozen=True)
class ContinuousSensor:
    """`shape(rate, block, depth_size)` of its float32 observation; `low`, `high`: bounds of all elements, or of
    each. `heard`: it is made of what is heard in a step."""

    shape: Callable[[int, int, int], tuple[int, ...]]
    low: tuple[float, ...]
    high: tuple[float, ...]
    heard: bool = False


def spectrogram_frames(block: int) -> int:
    """Columns of the spectrogram of a step (`auralise.spectrogram`): means of four, every 160 samples."""
    return -(-(block // 160 + 1) // 4)


def interaural_frames(rate: int, block: int) -> int:
    """Columns of `interaural`: every 10 ms, both ends included."""
    return block // round(_HOP_S * rate) + 1


CONTINUOUS_SENSORS: Mapping[str, ContinuousSensor] = {
    "audiogoal": ContinuousSensor(lambda _, block, __: (2, block), (-1000.0,), (1000.0,), True),
    "spectrogram": ContinuousSensor(
        lambda _, block, __: (65, spectrogram_frames(block), 2), (0.0,), (20.0,), True
    ),
    "interaural": ContinuousSensor(
        lambda rate, block, _: (4, _N_FFT // 2, interaural_frames(rate, block)),
        (-4.0,),
        (100_000.0,),
        True,
    ),
    "intensity": ContinuousSensor(lambda *_: (2,), (0.0,), (1000.0,), True),
    "depth": ContinuousSensor(lambda _, __, size: (size, size, 1), (0.0,), (1.0,)),
    POINTGOAL: ContinuousSensor(lambda *_: (2,), (0.0, -math.pi), (_FARTHEST, math.pi)),
    "pose": ContinuousSensor(
        lambda *_: (4,), (-_FARTHEST, -_FARTHEST, -math.pi, 0.0), (_FARTHEST, _FARTHEST, math.pi, 1e7)
    ),
    "collision": ContinuousSensor(lambda *_: (1,), (0.0,), (1.0,)),
}


DEFAULT_SENSORS = ("spectrogram", "depth", "pose")


@dataclass(frozen=True, kw_only=True)
class ContinuousOptions:
    """Options of `ContinuousNavEnv` and `ContinuousNavVectorEnv`; defaults are SAVN-CE's where it has them. Raises
    `ConfigError`.

    Parameters
    ----------
    data : folder of datasets, with `splits.toml`, or `NavData`
    split : whose scenes (and, of a bank's split, whose sounds)
    episodes : `ContinuousEpisode` records; None draws new ones by `rules`
    rules : of drawn episodes
    sounds : as in `EnvOptions`: what goals of drawn episodes make, distractors too
    scenes : scenes by name that cannot be loaded by it; of the mesh that a dataset was made of
    sensors : names of `CONTINUOUS_SENSORS`
    max_steps : truncates
    step_time : s that a step lasts: so much is heard
    forward, turn_deg : what FORWARD moves by, m, and LEFT and RIGHT turn by, degrees
    slide : go on along what was touched, as Habitat's agents do; False: stop there
    success_distance : m of walking distance to a goal below which STOP is right
    paths : how discrete arrivals are had between points: ``moved`` from the points around, or ``simulated`` at the
        very place, which is exact and takes eight to twelve times as long
    fade : s of a step in which what is heard goes over to the new pose; 12 ms make windows of 8,192 samples
    gps_sigma : standard deviation of both components of the displacement to the goal, m
    noises : sounds of the bank, one of which is around in every episode, at both ears from other places of its clip
    noise_db : its RMS in dB below that of a dry sound of RMS 1 at 1 m in the open
    depth_size : pixels per side
    memory : bytes of responses between points that are kept
    """

    data: str | Path | NavData = field(compare=False)
    split: str = "train"
    episodes: Sequence[ContinuousEpisode] | None = None
    rules: Rules = field(default_factory=Rules)
    sounds: str | Path | Sequence[str] | SoundBank = DEFAULT
    scenes: Mapping[str, Scene] = field(default_factory=dict, compare=False)
    sensors: tuple[str, ...] = ()
    max_steps: int = 500
    step_time: float = 0.25
    forward: float = 0.25
    turn_deg: float = 15.0
    slide: bool = True
    success_distance: float = 1.0
    paths: PathsName = "moved"
    fade: float = 0.012
    gps_sigma: float = 0.0
    noises: tuple[str, ...] = ()
    noise_db: float = 20.0
    depth_size: int = 128
    memory: int = 1_000_000_000

    def __post_init__(self) -> None:
        chosen = tuple(self.sensors) or DEFAULT_SENSORS
        for sensor in chosen:
            if sensor not in CONTINUOUS_SENSORS:
                there = f"{', '.join(CONTINUOUS_SENSORS)}{nearest(sensor, CONTINUOUS_SENSORS)}"
                raise ConfigError(
                    f"sensor '{sensor}' is unknown where poses are continuous: there are {there}"
                )
        if len(set(chosen)) != len(chosen):
            raise ConfigError(f"sensors: each may be named once, got {', '.join(chosen)}")
        object.__setattr__(self, "sensors", chosen)
        if not (isinstance(self.max_steps, int) and self.max_steps >= 1):
            raise ConfigError(f"max_steps: expected a whole number, at least 1, got {self.max_steps!r}")
        for what, low, high, unit in (
            ("step_time", 0.01, 10.0, "s"),
            ("forward", 0.001, 10.0, "m"),
            ("turn_deg", 0.01, 180.0, "degrees"),
            ("success_distance", 0.0, 1000.0, "m"),
            ("gps_sigma", 0.0, 1000.0, "m"),
            ("noise_db", -200.0, 200.0, "dB"),
        ):
            value = getattr(self, what)
            if not low <= value <= high:
                raise ConfigError(f"{what}: expected {low:g} to {high:g} {unit}, got {value!r}")
        if not 0.0 < self.fade <= self.step_time:
            raise ConfigError(f"fade: expected more than 0 s and at most a step, got {self.fade!r}")
        if self.paths not in get_args(PathsName):
            raise ConfigError(
                f"paths: expected one of {', '.join(get_args(PathsName))}, got {self.paths!r}"
            )
        if self.episodes is not None and len(self.episodes) == 0:
            raise ConfigError("episodes: expected at least one, or None to draw new ones")
        if "depth" in chosen:
            check_size(self.depth_size)

    @property
    def turn(self) -> float:
        """rad"""
        return math.radians(self.turn_deg)


def continuous_options(
    what: str, data: str | Path | NavData, given: Mapping[str, Any]
) -> ContinuousOptions:
    """The options of environment `what`. Raises `ConfigError`, also for names that are no option."""
    check_keywords(what, given, [option.name for option in fields(ContinuousOptions)])
    return ContinuousOptions(data=data, **{**given, "sensors": as_sensors(given.get("sensors"))})
