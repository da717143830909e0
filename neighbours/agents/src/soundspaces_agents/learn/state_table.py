"""The states that agents may be in, numbered: what they see and hear is a table.

A source is a scene, a goal and a sound; its states are the seconds of the sound (and, of a semantic episode, the
silence after it) times the poses of the scene. Poses of all scenes are numbered in a row, too: depth belongs to a
pose, what is heard to a state. Without noise in sensors an observation is a function of these numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from soundspaces_sim import ConfigError
from soundspaces_sim.nav import Episode
from soundspaces_sim.parts import (
    FORWARD,
    EnvSetting as Setting,
    EpisodeState,
    SensorSuite,
    oracle_action,
    pointgoal_reading as pointgoal,
    seconds_of,
)

NEVER = 2**31 - 1
_BY_POSE = ("depth",)


@dataclass(frozen=True)
class Targets:
    """What is true in states (k,): `direction` (k, 2) cosine and sine of the angle to the goal, left positive,
    `distance` m through the air, `action` of the oracle, `ahead`: whether a step forward is free, 0 or 1."""

    direction: np.ndarray
    distance: np.ndarray
    action: np.ndarray
    ahead: np.ndarray


class StateTable:
    """States of the sources that were asked for (`source_of`), in that order.

    `moves` (P, 4): poses after each action. By source: `first_state`, `first_pose`, `poses`, `seconds`,
    `silent_after` (steps), `spacing` m, `first_hop` into `hops`: edges between a point and the goal. Raises
    `ConfigError` for sensors whose observations are random.
    """

    def __init__(self, setting: Setting) -> None:
        task = setting.task
        if task.gps_sigma > 0.0 or task.snr_db is not None:
            raise ConfigError(
                "gps_sigma, snr_db: what agents learn from is a table of states, without noise"
            )
        self.setting = setting
        self.moves = np.empty((0, 4), np.int64)
        self.hops = np.empty(0, np.int64)
        self._suites: dict[str, SensorSuite] = {}
        self._scenes: dict[str, int] = {}
        self._rows: dict[tuple[str, int, str, int], int] = {}
        self._examples: list[EpisodeState] = []
        self._vectors: dict[str, list[np.ndarray]] = {}
        self._oracle: dict[int, np.ndarray] = {}
        names = "first_state first_pose poses seconds silent_after first_hop".split()
        self._lists: dict[str, list[int]] = {name: [] for name in names}
        self._spacing: list[float] = []
        self.states = 0
        for episode in setting.episodes or ():
            self._register(episode)
        self._pack()

    def __len__(self) -> int:
        return len(self._examples)

    def source_of(self, episode: Episode) -> int:
        """The number of an episode's source."""
        key = _key(episode)
        if key not in self._rows:
            self._register(episode)
        return self._rows[key]

    def _register(self, episode: Episode) -> None:
        key = _key(episode)
        if key in self._rows:
            return
        graph, bank = self.setting.data.graph(episode.scene), self.setting.bank
        if episode.scene not in self._scenes:
            self._scenes[episode.scene] = len(self.moves)
            self.moves = np.concatenate([self.moves, graph.moves + len(self.moves)])
        clip = seconds_of(bank[episode.sound], bank.rate)
        seconds = clip if self.setting.task.heard else 1
        semantic = episode.semantic is not None
        count = len(graph.moves)
        values = (
            self.states, self._scenes[episode.scene], count, seconds,
            episode.semantic.duration if episode.semantic is not None else NEVER, len(self.hops),
        )  # fmt: skip
        for name, value in zip(self._lists, values, strict=True):
            self._lists[name].append(value)
        self._spacing.append(graph.spacing)
        self.hops = np.concatenate([self.hops, graph.hops[:, episode.goal]])
        self._rows[key] = len(self._examples)
        self._examples.append(EpisodeState(graph, episode, self.setting.task))
        self.states += (seconds + semantic) * count
        self._pack()
        for sensor, blocks in self._vectors.items():
            blocks.append(self._vector_block(sensor, len(self._examples) - 1))

    def _pack(self) -> None:
        for name, values in self._lists.items():
            setattr(self, name, np.array(values, np.int64))
        self.spacing = np.array(self._spacing)

    first_state: np.ndarray
    first_pose: np.ndarray
    poses: np.ndarray
    seconds: np.ndarray
    silent_after: np.ndarray
    first_hop: np.ndarray

    def state_numbers(self, source: np.ndarray, pose: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """(n,) states of agents at poses after so many steps."""
        seconds = self.seconds[source]
        second = np.where(steps > self.silent_after[source], seconds, steps % seconds)
        return self.first_state[source] + second * self.poses[source] + pose - self.first_pose[source]

    def numbers(
        self, sensor: str, source: np.ndarray, pose: np.ndarray, steps: np.ndarray
    ) -> np.ndarray:
        """(n,) what a sensor's observations are numbered by: poses or states."""
        return pose if sensor in _BY_POSE else self.state_numbers(source, pose, steps)

    def size(self, sensor: str) -> int:
        """How many numbers there are."""
        return len(self.moves) if sensor in _BY_POSE else self.states

    def blocks(self, sensor: str) -> list[np.ndarray]:
        """Numbers of what can be met, scene by scene or source by source: those of points to stand at."""
        if sensor in _BY_POSE:
            return [
                first + self._standing(self.setting.data.graph(scene).nodes)
                for scene, first in self._scenes.items()
            ]
        return [self.block_of_source(k) for k in range(len(self))]

    def block_of_source(self, source: int) -> np.ndarray:
        """States of a source at points to stand at."""
        local = self._standing(self._examples[source].graph.nodes)
        last = self.states if source + 1 == len(self) else self.first_state[source + 1]
        parts = (last - self.first_state[source]) // self.poses[source]
        starts = self.first_state[source] + self.poses[source] * np.arange(parts)
        return np.asarray((starts[:, None] + local).ravel())

    @staticmethod
    def _standing(nodes: np.ndarray) -> np.ndarray:
        return np.asarray((4 * nodes[:, None] + np.arange(4)).ravel())

    def place(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(sources, seconds, poses within their scene) of states."""
        source = np.searchsorted(self.first_state, states, "right") - 1
        second, pose = np.divmod(states - self.first_state[source], self.poses[source])
        return source, second, pose

    def poses_of(self, states: np.ndarray) -> np.ndarray:
        """(k,) poses of states, numbered over all scenes."""
        source, _, pose = self.place(states)
        return np.asarray(self.first_pose[source] + pose)

    def observe(self, sensor: str, numbers: np.ndarray) -> np.ndarray:
        """(k, …) float32: what a sensor observes, to the bit what `SensorSuite` writes."""
        suite = self._suites.get(sensor)
        if suite is None:
            setting = self.setting
            suite = SensorSuite(
                setting.data, setting.bank, replace(setting.task, sensors=(sensor,)), setting.task.cache
            )
            self._suites[sensor] = suite
        out = np.empty((len(numbers), *suite.shapes[sensor]), np.float32)
        rng = np.random.default_rng(0)  # draws nothing: there is no noise
        if sensor in _BY_POSE:
            first_states = np.array(list(self._scenes.values()))
            row = np.searchsorted(first_states, numbers, "right") - 1
            example = {first: k for k, first in reversed(list(enumerate(self._lists["first_pose"])))}
            places = zip(
                [example[first_states[r]] for r in row],
                np.zeros(len(row), int),
                numbers - first_states[row],
                strict=True,
            )
        else:
            places = zip(*self.place(numbers), strict=True)
        for at, (source, second, pose) in enumerate(places):
            suite.observe(self._state(int(source), int(second), int(pose)), rng, {sensor: out[at]})
        return out

    def _state(self, source: int, second: int, pose: int) -> EpisodeState:
        state = self._examples[source]
        state.pose = pose
        silent = second >= self._lists["seconds"][source]
        state.steps = self._lists["silent_after"][source] + 1 if silent else second
        return state

    def _vector_block(self, sensor: str, source: int) -> np.ndarray:
        out = np.zeros((len(self._all_states(source)), 2), np.float32)
        rows = self.block_of_source(source) - self._lists["first_state"][source]
        out[rows] = self.observe(sensor, rows + self._lists["first_state"][source])
        return out

    def _all_states(self, source: int) -> range:
        first_states = [*self._lists["first_state"], self.states]
        return range(first_states[source], first_states[source + 1])

    def vectors(self, sensor: str, states: np.ndarray) -> np.ndarray:
        """(k, 2) float32: what a sensor of two numbers observes in states, kept in memory."""
        if sensor not in self._vectors:
            self._vectors[sensor] = [self._vector_block(sensor, k) for k in range(len(self))]
        blocks = self._vectors[sensor]
        if len(blocks) > 1:
            blocks[:] = [np.concatenate(blocks)]
        return np.asarray(blocks[0][states])

    def oracle(self, source: int) -> np.ndarray:
        """(poses,) the oracle's action at every pose of a source's scene; -1 where there is no way to the goal."""
        if source not in self._oracle:
            state = self._examples[source]
            out = np.full(self._lists["poses"][source], -1)
            for pose in np.flatnonzero(np.repeat(state.graph.hops[:, state.episode.goal] >= 0, 4)):
                out[pose] = oracle_action(self._state(source, 0, int(pose)))
            self._oracle[source] = out
        return self._oracle[source]

    def targets_known(self, states: np.ndarray) -> np.ndarray:
        """(k,) bool: whether there is a way to the goal."""
        source, _, pose = self.place(states)
        return np.asarray(self.hops[self.first_hop[source] + (pose >> 2)] >= 0)

    def steps_of(self, source: np.ndarray, second: np.ndarray) -> np.ndarray:
        """(k,) a number of steps after which second `second` is heard, or silence."""
        silent = second >= self.seconds[source]
        return np.where(silent, self.silent_after[source] + 1, second)

    def targets(self, states: np.ndarray) -> Targets:
        """What is true in states."""
        rng = np.random.default_rng(0)
        source, second, pose = self.place(states)
        polar = np.array(
            [
                pointgoal(self._state(*map(int, at)), 0.0, rng)
                for at in zip(source, second, pose, strict=True)
            ]
        ).reshape(-1, 2)
        action = np.array([self.oracle(int(s))[p] for s, p in zip(source, pose, strict=True)], np.int64)
        here = self.first_pose[source] + pose
        return Targets(
            np.stack([np.cos(polar[:, 1]), np.sin(polar[:, 1])], axis=1),
            polar[:, 0],
            action,
            (self.moves[here, FORWARD] != here).astype(float),
        )


def _key(episode: Episode) -> tuple[str, int, str, int]:
    duration = episode.semantic.duration if episode.semantic is not None else NEVER
    return episode.scene, episode.goal, episode.sound, duration
