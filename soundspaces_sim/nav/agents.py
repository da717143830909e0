"""Baseline agents: an oracle, the paper's three without hearing, and one that follows the louder ear.

`reset` gives an agent the state of a new episode; `act` maps an observation to an action. The baselines read
the goal from that state and STOP there, as the paper's do.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.nav.episode_state import EpisodeState
from soundspaces_sim.nav.navigation_graph import FORWARD, LEFT, RIGHT, STOP

Observation = dict[str, np.ndarray]


class Agent(Protocol):
    """Interface of agents for `evaluate` and `replay`."""

    name: str

    def reset(self, state: Any, seed: int) -> None:
        """A new episode begins; `state`: an `EpisodeState`, or what the environment has in its place; `seed`: of
        the agent's own choices."""

    def act(self, observation: Observation) -> int:
        """The next action: 0 STOP, 1 FORWARD, 2 LEFT, 3 RIGHT."""


class _Arriving:
    """Stops at the goal, which it knows when it is there."""

    name = ""

    def reset(self, state: EpisodeState, seed: int) -> None:
        self.state, self.rng = state, np.random.default_rng(seed)

    def act(self, observation: Observation) -> int:
        return STOP if self.state.node == self.state.episode.goal else self.go(observation)

    def go(self, observation: Observation) -> int:
        raise NotImplementedError


def oracle_action(state: EpisodeState) -> int:
    """The first action of a shortest path with the fewest turns; STOP at the goal."""
    if state.node == state.episode.goal:
        return STOP
    cost, moves = state.graph.actions_to(state.episode.goal), state.graph.moves
    here, hops = state.pose, state.graph.hops[:, state.episode.goal]
    ahead = int(moves[here, FORWARD])
    if hops[ahead >> 2] < hops[here >> 2] and cost[ahead] == cost[here] - 1:
        return FORWARD
    return LEFT if cost[moves[here, LEFT]] <= cost[moves[here, RIGHT]] else RIGHT


class Oracle(_Arriving):
    """Knows the graph and the goal."""

    name = "Oracle"

    def go(self, _observation: Observation) -> int:
        return oracle_action(self.state)


class Random(_Arriving):
    """Draws its actions uniformly."""

    name = "Random"

    def go(self, _observation: Observation) -> int:
        return int(self.rng.integers(FORWARD, RIGHT + 1))


class Forward(_Arriving):
    """Straight on; turns right after a collision."""

    name = "Forward"

    def go(self, _observation: Observation) -> int:
        return RIGHT if self.state.collided else FORWARD


class GoalFollower(_Arriving):
    """Turns to the heading nearest to the goal, then steps, whatever is in the way."""

    name = "GoalFollower"

    def go(self, _observation: Observation) -> int:
        points = self.state.graph.points
        dx, dy = points[self.state.episode.goal, :2] - points[self.state.node, :2]
        wanted = round(float(np.rad2deg(np.arctan2(dy, dx))) / 90.0) % 4
        turn = (wanted - self.state.pose) % 4
        return (FORWARD, LEFT, LEFT, RIGHT)[turn]


class EarFollower(_Arriving):
    """Turns to the ear that is louder by `threshold_db` and steps, else steps; after a collision turns to a
    random side and steps."""

    name = "EarFollower"

    def __init__(self, threshold_db: float = 1.5) -> None:
        self.threshold_db = threshold_db

    def reset(self, state: EpisodeState, seed: int) -> None:
        super().reset(state, seed)
        self._turned = False

    def go(self, observation: Observation) -> int:
        if self._turned:
            self._turned = False
            return FORWARD
        if self.state.collided:
            self._turned = True
            return int(self.rng.choice((LEFT, RIGHT)))
        difference = ear_difference(observation)
        if abs(difference) > self.threshold_db:
            self._turned = True
            return LEFT if difference > 0.0 else RIGHT
        return FORWARD


def ear_difference(observation: Observation) -> float:
    """dB by which the left ear is louder. Raises `ConfigError` for an agent without ears."""
    if "intensity" in observation:
        power = observation["intensity"].astype(float) ** 2
    elif "audiogoal" in observation:
        power = (observation["audiogoal"].astype(float) ** 2).mean(axis=1)
    elif "spectrogram" in observation:
        power = (np.expm1(observation["spectrogram"].astype(float)) ** 2).sum(axis=(0, 1))
    else:
        raise ConfigError(
            f"this agent listens; its environment has the sensors {', '.join(observation)}: add 'intensity', "
            "'audiogoal' or 'spectrogram'"
        )
    left, right = np.maximum(power, 1e-30)
    return float(10.0 * np.log10(left / right))


BASELINES: dict[str, type[_Arriving]] = {
    agent.name: agent for agent in (Oracle, Random, Forward, GoalFollower, EarFollower)
}
