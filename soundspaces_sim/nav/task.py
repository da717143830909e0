"""Tasks, sensors and rewards of agents, and the record of their options."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.keywords import nearest
from soundspaces_sim.nav.audio_sensor import PadMode
from soundspaces_sim.nav.sensor_table import POINTGOAL as POINTGOAL, SENSOR_TABLE
from soundspaces_sim.nav.views import check_size

TaskName = Literal["AudioGoal", "AudioPointGoal", "PointGoal"]
DistanceReward = Literal["metre", "step"]
EarMode = Literal["binaural", "mono"]

SENSORS: dict[str, tuple[str, ...]] = {
    "AudioGoal": ("spectrogram", "depth"),
    "AudioPointGoal": ("spectrogram", "depth", POINTGOAL),
    "PointGoal": (POINTGOAL, "depth"),
}
SLACK, SUCCESS = -0.01, 10.0  # rewards, as SoundSpaces' code has them


@dataclass(frozen=True, kw_only=True)
class TaskOptions:
    """Task, sensors and rewards of an environment; `EnvOptions` documents them. Raises `ConfigError`."""

    task: TaskName = "AudioGoal"
    sensors: tuple[str, ...] = ()
    max_steps: int = 500
    success_radius: float = 0.0
    gps_sigma: float = 0.0
    snr_db: float | None = None
    depth_size: int = 128
    distance_reward: DistanceReward = "metre"
    ears: EarMode = "binaural"
    pad_mode: PadMode = "constant"

    def __post_init__(self) -> None:
        if self.task not in SENSORS:
            raise ConfigError(f"task: expected one of {', '.join(SENSORS)}, got {self.task!r}")
        chosen = tuple(self.sensors) or SENSORS[self.task]
        for sensor in chosen:
            if sensor not in SENSOR_TABLE:
                there = f"{', '.join(SENSOR_TABLE)}{nearest(sensor, SENSOR_TABLE)}"
                raise ConfigError(f"sensor '{sensor}' is unknown: there are {there}")
        if len(set(chosen)) != len(chosen):
            raise ConfigError(f"sensors: each may be named once, got {', '.join(chosen)}")
        object.__setattr__(self, "sensors", chosen)
        if self.max_steps < 1:
            raise ConfigError(f"max_steps: expected at least 1, got {self.max_steps}")
        for what in ("success_radius", "gps_sigma"):
            value = getattr(self, what)
            if not 0.0 <= value < math.inf:
                raise ConfigError(f"{what}: expected 0 or more, in m, got {value!r}")
        if self.snr_db is not None and not math.isfinite(self.snr_db):
            raise ConfigError(f"snr_db: expected a number of dB or None, got {self.snr_db!r}")
        if self.distance_reward not in get_args(DistanceReward):
            raise ConfigError(f"distance_reward: expected metre or step, got {self.distance_reward!r}")
        if self.ears not in get_args(EarMode):
            raise ConfigError(f"ears: expected binaural or mono, got {self.ears!r}")
        if self.pad_mode not in get_args(PadMode):
            raise ConfigError(f"pad_mode: expected constant or reflect, got {self.pad_mode!r}")
        if "depth" in chosen:
            check_size(self.depth_size)

    @property
    def heard(self) -> frozenset[str]:
        """Sensors that need responses."""
        return frozenset(name for name in self.sensors if SENSOR_TABLE[name].heard)


def as_sensors(sensors: Sequence[str] | None) -> tuple[str, ...]:
    """Names as `TaskOptions` takes them; None: the task's own. Raises `ConfigError` for a bare text."""
    if isinstance(sensors, str):
        raise ConfigError(f"sensors: expected a list of names, got {sensors!r}")
    return tuple(sensors or ())
