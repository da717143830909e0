"""Drawing episodes of continuous tasks: where sounds stand, where an agent starts, how far it has to go."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from soundspaces_continuous.episodes import ContinuousEpisode, Rules, SoundSource
from soundspaces_continuous.state import ContinuousState
from soundspaces_continuous.world import ContinuousWorld
from soundspaces_sim.nav import NavigationGraph
from soundspaces_sim.parts import EpisodeError

_TRIES = 2000


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
        if not len(standing):  # a table, too small for an agent
            continue
        x, y = (float(v) for v in standing[int(rng.integers(len(standing)))])
        heading = float(rng.uniform(0.0, 360.0))
        sources, onset = [], _uniform(rng, rules.onset)
        offset = onset + _uniform(rng, rules.duration)
        for k, point in enumerate(points):
            route: tuple[int, ...] = (point,)
            if rules.speed > 0.0 and k < rules.goals:
                route = _graph_way(world, point, int(rng.choice(graph.nodes)))
            own = (onset, offset)
            if 0 < k < rules.goals:
                first = _uniform(rng, rules.onset)
                own = (first, first + _uniform(rng, rules.duration))
            sound = sounds[int(rng.integers(len(sounds)))]
            speed = rules.speed if len(route) > 1 else 0.0
            sources.append(SoundSource(sound, route, *own, speed))
        noise = str(noises[int(rng.integers(len(noises)))]) if len(noises) else None
        if any(world.floor_of(p) is not floor for s in sources for p in s.route):
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
        return _with_actions(world, made)
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


def _graph_way(world: ContinuousWorld, start: int, end: int) -> tuple[int, ...]:
    """Points of a shortest way along the navigation graph; the start alone if there is none."""
    hops, way = world.graph.hops[:, end], [start]
    while hops[way[-1]] > 0:
        ahead = [
            int(n) for n in world.graph.neighbour[way[-1]] if n >= 0 and hops[n] == hops[way[-1]] - 1
        ]
        way.append(ahead[0])
    return tuple(way)


def _with_actions(world: ContinuousWorld, episode: ContinuousEpisode) -> ContinuousEpisode:
    """An episode with the number of actions of the oracle, at most those that the options allow."""
    if len(episode.goals) == 1 and episode.goals[0].speed <= 0.0:
        return replace(episode, actions=world.oracle_actions(episode))
    state = ContinuousState(world, episode, world.options)
    while not state.over:
        state.move(state.oracle_action())
    return replace(episode, actions=state.steps)
