"""`GreedyGeodesicFollower`: the actions that take an agent to a place, by habitat-sim's names."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from soundspaces_rlr.arguments import length, vector3
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat.agent import Agent
from soundspaces_rlr.habitat.controls import ActuationSpec, moved
from soundspaces_rlr.habitat.node import Node
from soundspaces_rlr.habitat.pathfinder import PathFinder, ShortestPath

_GOAL_SHARE = 0.75  # of a step, as habitat: the default radius of a goal
_HERE = 0.05  # m: a corner of the way nearer than this has been reached
_MOST_ACTIONS = 10_000


class GreedyFollowerError(RuntimeError):
    """There is no way to the goal, or following it leads nowhere."""


class GreedyGeodesicFollower:
    """Turns an agent towards the next corner of the shortest way to a goal, then goes, until the goal is within
    `goal_radius` m. Keys of the actions are those of the agent's action space unless given."""

    def __init__(
        self,
        pathfinder: PathFinder,
        agent: Agent,
        goal_radius: float | None = None,
        *,
        stop_key: Any = None,
        forward_key: Any = None,
        left_key: Any = None,
        right_key: Any = None,
        fix_thrashing: bool = True,
        thrashing_threshold: int = 16,
    ) -> None:
        del (
            fix_thrashing,
            thrashing_threshold,
        )  # a turn of less than half a step is none: nothing thrashes
        self.pathfinder, self.agent = pathfinder, agent
        found = {name: self._find_action(name) for name in ("move_forward", "turn_left", "turn_right")}
        given = {"move_forward": forward_key, "turn_left": left_key, "turn_right": right_key}
        self._keys = {n: key if given[n] is None else given[n] for n, (key, _) in found.items()}
        self._specs = {n: spec for n, (_, spec) in found.items()}
        self._stop = stop_key
        step = self._specs["move_forward"].amount
        given_radius = _GOAL_SHARE * step if goal_radius is None else goal_radius
        self.goal_radius = length(given_radius, "goal_radius")

    def next_action_along(self, goal_pos: Any) -> Any:
        """The key of the next action, `stop_key` at the goal. Raises `GreedyFollowerError` without a way."""
        name = self._next(self.agent.scene_node, np.array(vector3(goal_pos, "next_action_along")))
        return self._stop if name is None else self._keys[name]

    def find_path(self, goal_pos: Any) -> list[Any]:
        """All actions from where the agent is, with `stop_key` at the end. Raises `GreedyFollowerError`."""
        goal = np.array(vector3(goal_pos, "find_path"))
        node = self.agent.scene_node
        keys: list[Any] = []
        for _ in range(_MOST_ACTIONS):
            name = self._next(node, goal)
            if name is None:
                return [*keys, self._stop]
            keys.append(self._keys[name])
            node, _ = moved(node, name, self._specs[name], self.pathfinder.try_step)
        raise GreedyFollowerError(f"{_MOST_ACTIONS} actions do not lead to {goal.tolist()}")

    def reset(self) -> None:
        """Nothing is kept between calls."""

    def _next(self, node: Node, goal: np.ndarray) -> str | None:
        path = ShortestPath(node.absolute_translation, goal)
        if not self.pathfinder.find_path(path):
            raise GreedyFollowerError(
                f"there is no way from {np.round(node.absolute_translation, 2).tolist()} to {goal.tolist()}"
            )
        if path.geodesic_distance <= self.goal_radius:
            return None
        here = node.absolute_translation
        ahead = [p for p in path.points[1:] if np.hypot(p[0] - here[0], p[2] - here[2]) > _HERE]
        x, _, z = (ahead[0] if ahead else path.points[-1]) - here
        front = -node.axes[:, 2]
        # positive to the left: about y, from the way it looks to the way it has to go
        angle = math.degrees(math.atan2(front[2] * x - front[0] * z, front[0] * x + front[2] * z))
        if angle > 0.5 * self._specs["turn_left"].amount:
            return "turn_left"
        return "turn_right" if -angle > 0.5 * self._specs["turn_right"].amount else "move_forward"

    def _find_action(self, name: str) -> tuple[Any, ActuationSpec]:
        space = self.agent.agent_config.action_space
        found = [(key, spec) for key, spec in space.items() if spec.name == name]
        if len(found) != 1 or found[0][1].actuation is None:
            raise RlrError(
                f"GreedyGeodesicFollower: expected one action {name!r} with an amount, got {len(found)}"
            )
        return found[0][0], found[0][1].actuation
