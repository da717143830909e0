"""Episodes of continuous tasks: where an agent starts, what sounds where and when, what distracts it."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.nav.errors import EpisodeError
from soundspaces_sim.nav.navigation_graph import NavigationGraph

if TYPE_CHECKING:
    from soundspaces_sim.nav.continuous.world import ContinuousWorld

_TRIES = 2000


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


def _uniform(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    low, high = bounds
    return low if low == high else float(rng.uniform(low, high))


def draw_episode(
    world: ContinuousWorld,
    rng: np.random.Generator,
    episode_id: str,
    rules: Rules,
    sounds: Sequence[str],
    noises: Sequence[str] = (),
) -> ContinuousEpisode:
    """An episode in a scene: goals and distractors at nodes of its graph, the start anywhere on the same floor from
    which a way leads to them. Raises `EpisodeError` where none is found."""
    graph = world.graph
    count = rules.goals + rules.distractors
    if len(graph.nodes) < count:
        raise EpisodeError(
            f"{graph.scene}: {count} sources need as many nodes, there are {len(graph.nodes)}"
        )
    nodes = _places(graph, rules)
    for _ in range(_TRIES):
        points = [int(n) for n in rng.choice(nodes, count, replace=False)]
        floor = world.floor_of(points[0])
        standing = world.standing(floor)
        x, y = (float(v) for v in standing[int(rng.integers(len(standing)))])
        heading = float(rng.uniform(0.0, 360.0))
        sources, onset = [], _uniform(rng, rules.onset)
        offset = onset + _uniform(rng, rules.duration)
        for k, point in enumerate(points):
            route: tuple[int, ...] = (point,)
            if rules.speed > 0.0 and k < rules.goals:
                route = graph_way(world, point, int(rng.choice(graph.nodes)))
            own = (onset, offset)
            if 0 < k < rules.goals:
                first = _uniform(rng, rules.onset)
                own = (first, first + _uniform(rng, rules.duration))
            sound = sounds[int(rng.integers(len(sounds)))]
            speed = rules.speed if len(route) > 1 else 0.0
            sources.append(SoundSource(sound, route, *own, speed))
        noise = str(noises[int(rng.integers(len(noises)))]) if len(noises) else None
        if any(world.floor_of(p) is not floor for p in points):
            continue
        ways = [floor.distances(*world.points[p, :2].tolist()).ahead(x, y)[0] for p in points]
        least = min(ways[: rules.goals])
        if not (np.isfinite(ways).all() and least >= rules.min_distance):
            continue
        start = (x, y, floor.height)
        made = ContinuousEpisode(
            episode_id, graph.scene, start, heading, tuple(sources[: rules.goals]), least, 1,
            tuple(sources[rules.goals :]), noise,
        )  # fmt: skip
        return world.with_actions(made)
    raise EpisodeError(
        f"{graph.scene}: no start at least {rules.min_distance:g} m from its goals was found in {_TRIES} draws; "
        "lower min_distance"
    )


def _places(graph: NavigationGraph, rules: Rules) -> np.ndarray:
    """Nodes of a scene at which sounds may stand."""
    if rules.places is None or rules.places >= len(graph.nodes):
        return graph.nodes
    rng = np.random.default_rng(zlib.crc32(graph.scene.encode()))
    return rng.choice(graph.nodes, rules.places, replace=False)


def graph_way(world: ContinuousWorld, start: int, end: int) -> tuple[int, ...]:
    """Points of a shortest way along the navigation graph; the start alone if there is none."""
    hops, way = world.graph.hops[:, end], [start]
    while hops[way[-1]] > 0:
        ahead = [
            int(n) for n in world.graph.neighbour[way[-1]] if n >= 0 and hops[n] == hops[way[-1]] - 1
        ]
        way.append(ahead[0])
    return tuple(way)
