"""Many agents under way by numbers alone: what `AudioNavVectorEnv` does in SAME_STEP, without observations.

The same seeds and actions give the same episodes, rewards, ends and measures to the bit; observations are looked up
in a `StateTable` by whoever wants them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from soundspaces_agents.learn.state_table import StateTable
from soundspaces_sim.nav import Episode, Metrics, episode_metrics
from soundspaces_sim.parts import (
    FORWARD,
    SLACK_REWARD as SLACK,
    STOP,
    SUCCESS_REWARD as SUCCESS,
    heading_index,
)

_ARRAYS = ("pose", "steps", "collided", "distance", "path", "bumps")


@dataclass(frozen=True)
class Step:
    """`rewards`, `ends`, `truncated` (n,); of agents whose episode ended (rows `ended`): the `source` and `pose`
    that they ended in after `steps`, and their `measures`."""

    rewards: np.ndarray
    ends: np.ndarray
    truncated: np.ndarray
    ended: np.ndarray
    source: np.ndarray
    pose: np.ndarray
    steps: np.ndarray
    collided: np.ndarray
    measures: tuple[Metrics, ...]


class Walkers:
    """`count` agents. Arrays (count,): `source`, `pose` (over all scenes), `steps`, `collided`, `distance` m to the
    goal, `path` m, `bumps`; `episodes` by agent."""

    def __init__(self, count: int, table: StateTable) -> None:
        self.count, self.table = count, table
        self.source, self.pose, self.steps, self.bumps = (np.zeros(count, np.int64) for _ in range(4))
        self.collided = np.zeros(count, bool)
        self.distance, self.path = np.zeros(count), np.zeros(count)
        self.episodes: list[Episode] = []
        self._rngs: list[np.random.Generator] = []
        self._numbers = [0] * count

    def reset(self, seed: int) -> None:
        """Begin all episodes; agent i draws by `seed` + i, as Gymnasium seeds."""
        self._rngs = [
            np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed + i)))
            for i in range(self.count)
        ]
        self._numbers = [0] * self.count
        self.episodes = []
        for i, rng in enumerate(self._rngs):
            self.episodes.append(self.table.setting.episode(rng, None, 0))
            self._begin(i)

    def _begin(self, i: int) -> None:
        episode, table = self.episodes[i], self.table
        self._numbers[i] += 1
        row = table.source_of(episode)
        self.source[i] = row
        self.pose[i] = table.first_pose[row] + 4 * episode.start + heading_index(episode.heading)
        self.steps[i] = self.bumps[i] = 0
        self.collided[i] = False
        self.distance[i], self.path[i] = episode.distance, 0.0

    def numbers(self, sensor: str) -> np.ndarray:
        """(n,) what a sensor's observations are numbered by in the table."""
        return self.table.numbers(sensor, self.source, self.pose, self.steps)

    def oracle_actions(self) -> np.ndarray:
        """(n,) what the oracle would do."""
        table = self.table
        local = self.pose - table.first_pose[self.source]
        return np.array([table.oracle(int(s))[p] for s, p in zip(self.source, local, strict=True)])

    def step(self, actions: np.ndarray) -> Step:
        """One action each; who is at an end begins anew."""
        table, task, source = self.table, self.table.setting.task, self.source
        hop = table.first_hop[source] - (table.first_pose[source] >> 2)
        before, left = self.distance, table.hops[hop + (self.pose >> 2)]
        pose = table.moves[self.pose, actions]
        stopped, ahead = actions == STOP, actions == FORWARD
        self.collided = ahead & (pose == self.pose)
        self.bumps += self.collided
        self.path = np.where(ahead & ~self.collided, self.path + table.spacing[source], self.path)
        self.pose, self.steps = pose, self.steps + 1
        nearer_by = left - table.hops[hop + (pose >> 2)]
        self.distance = (left - nearer_by) * table.spacing[source]
        won = stopped & (self.distance <= task.success_radius)
        nearer = nearer_by if task.distance_reward == "step" else before - self.distance
        truncated = ~stopped & (self.steps >= task.max_steps)
        ends = stopped | truncated
        ended = np.flatnonzero(ends)
        out = Step(
            SLACK + nearer + SUCCESS * won,
            ends,
            truncated,
            ended,
            source[ended],
            pose[ended],
            self.steps[ended],
            self.collided[ended],
            tuple(self._measures(int(i), bool(stopped[i])) for i in ended),
        )
        for i in ended:
            self.episodes[i] = table.setting.episode(self._rngs[i], None, self._numbers[i])
            self._begin(int(i))
        return out

    def _measures(self, i: int, stopped: bool) -> Metrics:
        episode, task = self.episodes[i], self.table.setting.task
        return episode_metrics(
            start_distance=episode.distance,
            distance=float(self.distance[i]),
            path=float(self.path[i]),
            actions=int(self.steps[i]),
            fewest=episode.actions,
            collisions=int(self.bumps[i]),
            stopped=stopped,
            success_radius=task.success_radius,
        )

    def snapshot(self) -> dict[str, Any]:
        """All that decides what comes next, as texts and lists."""
        state: dict[str, Any] = {name: getattr(self, name).tolist() for name in _ARRAYS}
        state["numbers"] = list(self._numbers)
        state["episodes"] = msgspec.json.encode(self.episodes).decode()
        state["rngs"] = msgspec.json.encode([_text(rng) for rng in self._rngs]).decode()
        return state

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a `snapshot`."""
        self.episodes = msgspec.json.decode(state["episodes"], type=list[Episode])
        for name in _ARRAYS:
            kind = getattr(self, name).dtype
            setattr(self, name, np.array(state[name], kind))
        # Sources are numbered in the order in which they are met, which another process does not share.
        self.source = np.array([self.table.source_of(e) for e in self.episodes])
        self._numbers = list(state["numbers"])
        self._rngs = [_rng(text) for text in msgspec.json.decode(state["rngs"], type=list[list[str]])]


def _text(rng: np.random.Generator) -> list[str]:
    """Numbers of 128 bits, which JSON has not."""
    state: Any = rng.bit_generator.state
    inner = state["state"]
    return [str(inner["state"]), str(inner["inc"]), str(state["has_uint32"]), str(state["uinteger"])]


def _rng(text: list[str]) -> np.random.Generator:
    bits = np.random.PCG64()
    state, inc, has, value = map(int, text)
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": state, "inc": inc},
        "has_uint32": has,
        "uinteger": value,
    }
    return np.random.Generator(bits)
