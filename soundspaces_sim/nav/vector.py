"""Many agents in one process: the environment for training, tens of thousands of steps a second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.env import Setting, check_action, gymnasium, state_info
from soundspaces_sim.nav.env_options import env_options
from soundspaces_sim.nav.episode_state import EpisodeState
from soundspaces_sim.nav.metrics import NAMES

AutoresetMode = gymnasium.vector.AutoresetMode


class AudioNavVectorEnv(gymnasium.vector.VectorEnv):
    """`num_envs` agents as `AudioNavEnv` has one, the same steps for the same seeds.

    Options as there. `autoreset_mode`: NEXT_STEP (the step after an episode's last one begins the next) or
    SAME_STEP (``final_obs`` and ``final_info`` hold what the last step gave). `infos` has, of every agent, the
    node, the heading and the names of episode, scene and sound; measures of agents whose episode ended in this
    step. Observations are arrays of their own each step.
    """

    names = NAMES  # of measures

    def __init__(
        self,
        num_envs: int,
        data: str | Path | NavData,
        *,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        if num_envs < 1:
            raise ConfigError(f"num_envs: expected at least 1, got {num_envs}")
        if render_mode is not None:
            raise ConfigError("render_mode: many agents draw no maps; make one AudioNavEnv for that")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        if self.autoreset_mode == AutoresetMode.DISABLED:
            raise ConfigError("autoreset_mode: expected NextStep or SameStep, got Disabled")
        self.setting = self._make_setting(data, options)
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": self.autoreset_mode}
        self.render_mode = None
        self.single_observation_space = self.setting.observation_space
        self.single_action_space = self.setting.action_space
        self.observation_space = gymnasium.vector.utils.batch_space(
            self.single_observation_space, num_envs
        )
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self.states: list[EpisodeState] = []
        self.rngs: list[np.random.Generator] = []
        self._numbers = [0] * num_envs

    def _make_setting(self, data: str | Path | NavData, options: Mapping[str, Any]) -> Any:
        return Setting(env_options("AudioNavVectorEnv", data, options))

    def _info(self, state: Any) -> dict[str, Any]:
        return state_info(state)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin all episodes. `seed`: one per agent, or n for n, n + 1, …; `options` as `AudioNavEnv`'s, where
        ``episodes`` gives one episode per agent."""
        seeds: Sequence[int | None]
        if seed is None or isinstance(seed, int):
            seeds = [None if seed is None else seed + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ConfigError(f"seed: expected one per agent ({self.num_envs}), got {len(seeds)}")
        for i, one in enumerate(seeds):
            if one is not None or len(self.rngs) <= i:
                rng, _ = gymnasium.utils.seeding.np_random(one)
                self.rngs[i : i + 1] = [rng]
                self._numbers[i] = 0
        each = self._options_of_each(options)
        self.states = [self._start(i, each[i]) for i in range(self.num_envs)]
        return self._observe(), self._infos(np.zeros(self.num_envs, bool))

    def _options_of_each(self, options: dict[str, Any] | None) -> list[dict[str, Any] | None]:
        if options is None or "episodes" not in options:
            return [options] * self.num_envs
        wanted = list(options["episodes"])
        if len(wanted) != self.num_envs or len(options) > 1:
            raise ConfigError(
                f"options['episodes']: expected one per agent ({self.num_envs}) and no other option"
            )
        return [{"episode": episode} for episode in wanted]

    def _start(self, i: int, options: dict[str, Any] | None = None) -> EpisodeState:
        self._numbers[i] += 1
        return self.setting.start(self.rngs[i], options, self._numbers[i] - 1)

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Observations, rewards, terminations, truncations, infos."""
        if not self.states:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        chosen = np.asarray(actions)
        if chosen.shape != (self.num_envs,) or chosen.dtype.kind not in "iu":
            check_action(actions, self.setting.action_space)
        if chosen.min() < 0 or chosen.max() > 3:
            check_action(int(chosen[(chosen < 0) | (chosen > 3)][0]), self.setting.action_space)
        n = self.num_envs
        rewards, done = np.zeros(n), np.zeros(n, bool)
        terminated, truncated = np.zeros(n, bool), np.zeros(n, bool)
        for i, state in enumerate(self.states):
            if state.over:  # NEXT_STEP: this step begins an episode
                self.states[i] = self._start(i)
            else:
                rewards[i], terminated[i], truncated[i] = state.move(int(chosen[i]))
                done[i] = state.over
        extra: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and done.any():
            extra = self._finish(done)
        infos = self._infos(done if not extra else np.zeros(n, bool))
        return self._observe(), rewards, terminated, truncated, {**infos, **extra}

    def _finish(self, done: np.ndarray) -> dict[str, Any]:
        """Last observations and infos of episodes that are over; then the next ones begin."""
        final_obs = np.full(self.num_envs, None, object)
        final: dict[str, Any] = {}
        for i in np.flatnonzero(done):
            state, obs = self.states[i], self.setting.sensor_suite.empty()
            self.setting.sensor_suite.observe(state, self.rngs[i], obs)
            final_obs[i] = obs
            final = self._add_info(final, self._info(state), int(i))
            self.states[i] = self._start(int(i))
        return {
            "final_obs": final_obs,
            "_final_obs": done.copy(),
            "final_info": final,
            "_final_info": done.copy(),
        }

    def _observe(self) -> dict[str, np.ndarray]:
        sensor_suite = self.setting.sensor_suite
        out = {
            s: np.empty((self.num_envs, *shape), np.float32) for s, shape in sensor_suite.shapes.items()
        }
        for i, state in enumerate(self.states):
            sensor_suite.observe(state, self.rngs[i], {s: array[i] for s, array in out.items()})
        return out

    def _infos(self, done: np.ndarray) -> dict[str, Any]:
        states, n = self.states, self.num_envs
        infos: dict[str, Any] = {
            "node": np.array([w.node for w in states]),
            "heading": np.array([w.heading for w in states]),
            "episode_id": np.array([w.episode.episode_id for w in states], object),
            "scene": np.array([w.episode.scene for w in states], object),
            "sound": np.array([w.episode.sound for w in states], object),
        }
        infos |= {f"_{name}": np.ones(n, bool) for name in list(infos)}
        if done.any():
            measures = {int(i): states[i].metrics() for i in np.flatnonzero(done)}
            for name in self.names:
                values = np.zeros(n)
                values[list(measures)] = [getattr(m, name) for m in measures.values()]
                infos[name], infos[f"_{name}"] = values, done.copy()
        return infos

    def close_extras(self, **_: Any) -> None:
        """Close the datasets' files."""
        self.setting.data.close()
