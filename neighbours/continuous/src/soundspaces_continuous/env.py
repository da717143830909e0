"""`SoundSpaces/AudioGoalContinuous-v0`: an agent anywhere on the floor, that hears sound go on from step to
step."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from soundspaces_continuous.draw import draw_episode
from soundspaces_continuous.episodes import ContinuousEpisode
from soundspaces_continuous.sensor_suite import ContinuousSensorSuite
from soundspaces_continuous.state import CONTINUOUS_NAMES, ContinuousState
from soundspaces_continuous.task import CONTINUOUS_SENSORS, ContinuousOptions, continuous_options
from soundspaces_continuous.world import ContinuousWorld
from soundspaces_sim import RirDataset
from soundspaces_sim.nav import AudioNavEnv, AudioNavVectorEnv, NavData
from soundspaces_sim.parts import (
    TableEntry as Entry,
    check_rates,
    of_neighbour,
    open_sounds,
    scene_of_dataset,
    sensor_box as box,
    state_info,
    wanted_episode,
)

_MAP = Entry(
    "soundspaces_pictures.episode_map:MapPage", "the map of an episode", "parameters renderers pictures"
)


class ContinuousSetting:
    """Data, sounds, episodes and sensors of an environment of one agent or of many."""

    def __init__(self, options: ContinuousOptions) -> None:
        data = options.data
        self.data = data if isinstance(data, NavData) else NavData(data)
        self.task, self.scenes = options, self.data.scenes(options.split)
        rate = check_rates(self.data, options.split)
        self.bank, self.sounds = open_sounds(options.sounds, rate, options.split)
        self.episodes = None if options.episodes is None else tuple(options.episodes)
        for name in options.noises:
            self.bank.check(name)
        for episode in self.episodes or ():
            self._check(episode)
        self.sensor_suite = ContinuousSensorSuite(self.bank, options)
        self.observation_space = spaces.Dict(
            {
                name: box(CONTINUOUS_SENSORS[name].low, CONTINUOUS_SENSORS[name].high, shape)
                for name, shape in self.sensor_suite.shapes.items()
            }
        )
        self.action_space = spaces.Discrete(4)
        self._worlds: dict[str, ContinuousWorld] = {}

    def _check(self, episode: ContinuousEpisode) -> None:
        for source in (*episode.goals, *episode.distractors):
            self.bank.check(source.sound)
        if episode.noise is not None:
            self.bank.check(episode.noise)

    def world(self, scene: str) -> ContinuousWorld:
        """The world of a scene, made when it is first asked for."""
        if scene not in self._worlds:
            ds = self.data.dataset(scene)
            mesh = self.task.scenes.get(scene) or scene_of_dataset(ds)
            self._worlds[scene] = ContinuousWorld(ds, self.data.graph(scene), mesh, self.task)
        return self._worlds[scene]

    def start(
        self, rng: np.random.Generator, options: dict[str, Any] | None, number: int
    ) -> ContinuousState:
        """The state of a new episode."""
        wanted = wanted_episode(options, ContinuousEpisode, self.episodes)
        if wanted is None and self.episodes is not None:
            wanted = self.episodes[int(rng.integers(len(self.episodes)))]
        if wanted is None:
            world = self.world(self.scenes[int(rng.integers(len(self.scenes)))])
            name = f"drawn-{number}"
            wanted = draw_episode(world, rng, name, self.task.rules, self.sounds, self.task.noises)
        self._check(wanted)
        return ContinuousState(self.world(wanted.scene), wanted, self.task)


def _info(state: ContinuousState) -> dict[str, Any]:
    place = np.array([state.x, state.y, state.floor.height])
    return {**state_info(state), "position": place, "silent": state.silent}


class ContinuousNavEnv(AudioNavEnv):
    """One agent in continuous space. Options: those of `ContinuousOptions`, by name; the rest as `AudioNavEnv`.

    `reset(options={"episode": e})` takes a `ContinuousEpisode`, or a number of `episodes`.
    """

    state: ContinuousState | None  # type: ignore[assignment]
    names = CONTINUOUS_NAMES

    def _make_setting(self, data: str | Path | NavData, options: Mapping[str, Any]) -> Any:
        return ContinuousSetting(continuous_options("ContinuousNavEnv", data, options))

    def _draw(self, dataset: RirDataset, state: Any) -> np.ndarray:
        of_neighbour("a picture", _MAP)
        from soundspaces_continuous.map_page import map_frame

        return map_frame(dataset, state, self.trail)

    def _info(self, state: Any) -> dict[str, Any]:
        return _info(state)


class ContinuousNavVectorEnv(AudioNavVectorEnv):
    """Many agents in continuous space, in one process; as `AudioNavVectorEnv`."""

    names = CONTINUOUS_NAMES

    def _make_setting(self, data: str | Path | NavData, options: Mapping[str, Any]) -> Any:
        return ContinuousSetting(continuous_options("ContinuousNavVectorEnv", data, options))

    def _info(self, state: Any) -> dict[str, Any]:
        return _info(state)
