"""State of a continuous episode under way: pose, reward, measures. Independent of sensors and of Gymnasium."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from soundspaces_continuous.episodes import ContinuousEpisode, SoundSource
from soundspaces_continuous.sound_field import Place
from soundspaces_continuous.task import ContinuousOptions
from soundspaces_continuous.world import ContinuousWorld
from soundspaces_sim.nav import Metrics, episode_metrics
from soundspaces_sim.parts import (
    FORWARD,
    LEFT,
    RIGHT,
    SLACK_REWARD as SLACK,
    STOP,
    SUCCESS_REWARD as SUCCESS,
    EpisodeError,
)


@dataclass(frozen=True)
class ContinuousMetrics(Metrics):
    """`Metrics`, where `success` is STOP closer than the success distance to a goal, in walking distance, and
    `distance_to_goal` that to the nearest. `success_when_silent`: success while no goal sounds;
    `distractor_success`: STOP closer than that to a distractor (SAVN-CE: Zeng et al., CVPR 2026, measures SWS and
    DISTRACTOR_SUCCESS)."""

    success_when_silent: float
    distractor_success: float


CONTINUOUS_NAMES = tuple(f.name for f in fields(ContinuousMetrics))


class ContinuousState:
    """State of an episode. `x`, `y` m; `facing` rad, counter-clockwise from +X; `distance` to the nearest goal on
    foot, m; `steps` taken, STOP included; `collided` in the last step; `over`: stopped, or out of steps."""

    def __init__(
        self, world: ContinuousWorld, episode: ContinuousEpisode, options: ContinuousOptions
    ) -> None:
        world.check(episode)
        self.world, self.episode, self.options = world, episode, options
        self.x, self.y, z = episode.start
        self.floor = world.floor_at(z)
        self.facing = math.radians(episode.heading) % (2.0 * math.pi)
        self.steps = self.collisions = 0
        self.path = 0.0
        self.collided = self.stopped = self.over = False
        self._place: Place | None = None
        self._way: tuple[tuple[int, float, float], tuple[float, float, float]] | None = None
        self.tail: np.ndarray | None = None
        self.heard: tuple[int, np.ndarray] | None = None
        self.distance = self.way()[0]
        if not math.isfinite(self.distance):
            raise EpisodeError(
                f"episode '{episode.episode_id}': no way leads from its start to a goal in {episode.scene}"
            )

    @property
    def time(self) -> float:
        """s since the beginning."""
        return self.steps * self.options.step_time

    @property
    def place(self) -> Place:
        """The agent's ears."""
        if self._place is None:
            self._place = self.world.place(self.x, self.y, self.floor)
        return self._place

    @property
    def node(self) -> int:
        """The point that counts most for what is heard here."""
        return self.place.points[0]

    @property
    def heading(self) -> float:
        """Degrees counter-clockwise from +X."""
        return math.degrees(self.facing)

    @property
    def pose(self) -> tuple[float, float, float]:
        """(x, y, facing)."""
        return self.x, self.y, self.facing

    def sounds(self, source: SoundSource) -> bool:
        """Whether a source sounds in this step: whole steps count, as in SAVN-CE."""
        first, last = sounding_steps(source, self.options.step_time)
        return first <= self.steps < last

    @property
    def silent(self) -> bool:
        """Whether no goal sounds."""
        return not any(self.sounds(goal) for goal in self.episode.goals)

    def way(self) -> tuple[float, float, float]:
        """(distance, x, y) of the shortest way to the nearest goal, and where it first turns."""
        key = self.steps, self.x, self.y  # steps tell where goals are
        if self._way is None or self._way[0] != key:
            ways = [self._way_to(goal) for goal in self.episode.goals]
            self._way = key, min(ways, key=lambda way: way[0])
        return self._way[1]

    def _way_to(self, source: SoundSource) -> tuple[float, float, float]:
        place = self.world.source_at(source, self.time)
        return self.world.way_to(place, self.x, self.y, self.floor)

    def move(self, action: int) -> tuple[float, bool, bool]:
        """(reward, terminated, truncated) of one of the actions STOP, FORWARD, LEFT, RIGHT."""
        options, before = self.options, self.distance
        self.steps += 1
        self.collided = False
        if action == STOP:
            self.stopped = True
        elif action == FORWARD:
            dx, dy = options.forward * math.cos(self.facing), options.forward * math.sin(self.facing)
            x, y, self.collided = self.floor.move(self.x, self.y, dx, dy, options.slide)
            self.path += math.hypot(x - self.x, y - self.y)
            self.collisions += self.collided
            self.x, self.y, self._place = x, y, None
        else:
            turn = options.turn if action == LEFT else -options.turn
            self.facing = (self.facing + turn) % (2.0 * math.pi)
        after = self.way()[0]
        # In a nook without a cell to stand on: what the triangle's inequality leaves.
        self.distance = after if math.isfinite(after) else before + options.forward
        won = self.stopped and self.distance < options.success_distance
        truncated = not self.stopped and self.steps >= options.max_steps
        self.over = self.stopped or truncated
        return SLACK + (before - self.distance) + SUCCESS * won, self.stopped, truncated

    def oracle_action(self) -> int:
        """What follows the shortest way: turn to where it next turns, to half a turn; STOP where that succeeds."""
        distance, x, y = self.way()
        if distance < self.options.success_distance:
            return STOP
        off = math.atan2(y - self.y, x - self.x) - self.facing
        off = (off + math.pi) % (2.0 * math.pi) - math.pi
        if abs(off) <= 0.5 * self.options.turn + 1e-9:
            return FORWARD
        return LEFT if off > 0.0 else RIGHT

    def metrics(self) -> ContinuousMetrics:
        """The measures so far."""
        limit = math.nextafter(self.options.success_distance, -math.inf)
        of_way = episode_metrics(
            start_distance=self.episode.distance,
            distance=self.distance,
            path=self.path,
            actions=self.steps,
            fewest=self.episode.actions,
            collisions=self.collisions,
            stopped=self.stopped,
            success_radius=limit,
        )
        misled = self.stopped and any(self._way_to(d)[0] <= limit for d in self.episode.distractors)
        return ContinuousMetrics(
            **vars(of_way),
            success_when_silent=of_way.success * self.silent,
            distractor_success=float(misled),
        )


def sounding_steps(source: SoundSource, step_time: float) -> tuple[int, float]:
    """The first step in which a source sounds, and the first in which it no longer does: times rounded down to
    steps."""
    last = source.offset if math.isinf(source.offset) else math.floor(source.offset / step_time + 1e-9)
    return math.floor(source.onset / step_time + 1e-9), last
