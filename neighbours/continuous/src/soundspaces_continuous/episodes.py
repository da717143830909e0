"""Episodes of continuous tasks: where an agent starts, what sounds where and when, what distracts it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import EpisodeError


@dataclass(frozen=True)
class SoundSource:
    """`sound` of the bank, repeated from `onset` to before `offset` (s; inf: to the end), at the first point of
    `route` or, with a `speed` (m/s), going to and fro along its points from the episode's beginning. `category`:
    of a semantic goal. Raises `EpisodeError`."""

    sound: str
    route: tuple[int, ...]
    onset: float = 0.0
    offset: float = math.inf
    speed: float = 0.0
    category: str | None = None

    def __post_init__(self) -> None:
        if not self.route:
            raise EpisodeError(f"source of '{self.sound}': expected at least one point in its route")
        if not 0.0 <= self.onset < self.offset:
            raise EpisodeError(
                f"source of '{self.sound}': expected 0 <= onset < offset in s, got {self.onset!r} and "
                f"{self.offset!r}"
            )
        if not 0.0 <= self.speed <= 10.0:
            raise EpisodeError(
                f"source of '{self.sound}': expected a speed of 0 to 10 m/s, got {self.speed!r}"
            )


@dataclass(frozen=True)
class ContinuousEpisode:
    """`start` (x, y, z): m, on the floor of a storey; `heading` in degrees, counter-clockwise from +X. The agent is
    to stop near any of `goals`. `noise`: a sound that is all around, or None. `distance`: of the shortest way to a
    goal's first place, m; `actions`: of the oracle that follows it, STOP included."""

    episode_id: str
    scene: str
    start: tuple[float, float, float]
    heading: float
    goals: tuple[SoundSource, ...]
    distance: float
    actions: int
    distractors: tuple[SoundSource, ...] = ()
    noise: str | None = None

    @property
    def sound(self) -> str:
        """That of the first goal."""
        return self.goals[0].sound

    def __post_init__(self) -> None:
        numbers = (*self.start, self.heading, self.distance)
        if not all(math.isfinite(x) for x in numbers) or not self.goals:
            raise EpisodeError(
                f"episode '{self.episode_id}': expected finite numbers and at least one goal, got {numbers} and "
                f"{len(self.goals)} goals"
            )


@dataclass(frozen=True)
class Rules:
    """How episodes are drawn: numbers of `goals` and `distractors`; a way of at least `min_distance` m; `onset`
    and `duration` of sounds, s, uniformly between two bounds (inf: to the end), those of distractors the first
    goal's as in SAVN-CE; goals move at `speed` m/s along a shortest way to a random point, 0: they rest. `places`:
    nodes of a scene at which sounds may stand, the same in all its episodes; None: all. Raises `ConfigError`."""

    goals: int = 1
    distractors: int = 0
    min_distance: float = 4.0
    onset: tuple[float, float] = (0.0, 0.0)
    duration: tuple[float, float] = (math.inf, math.inf)
    speed: float = 0.0
    places: int | None = None

    def __post_init__(self) -> None:
        if self.places is not None and self.places < self.goals + self.distractors:
            raise ConfigError(
                f"rules: places: expected one for each of {self.goals + self.distractors} sounds, got {self.places}"
            )
        if not (1 <= self.goals <= 16 and 0 <= self.distractors <= 16):
            raise ConfigError(
                f"rules: expected 1 to 16 goals and 0 to 16 distractors, got {self.goals} and {self.distractors}"
            )
        if not 0.0 <= self.min_distance < math.inf:
            raise ConfigError(f"rules: min_distance: expected 0 or more m, got {self.min_distance!r}")
        for what, (low, high), least in (("onset", self.onset, 0.0), ("duration", self.duration, 1e-3)):
            if not least <= low <= high:
                raise ConfigError(
                    f"rules: {what}: expected two rising bounds from {least:g} s, got {low}, {high}"
                )
        if not 0.0 <= self.speed <= 10.0:
            raise ConfigError(f"rules: speed: expected 0 to 10 m/s, got {self.speed!r}")
