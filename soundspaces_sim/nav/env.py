"""Gymnasium environments: an agent hears, sees depth, moves on the navigation graph and stops at the sound.

`SoundSpaces/AudioGoal-v0`, `SoundSpaces/AudioPointGoal-v0`, `SoundSpaces/PointGoal-v0`; importing
`soundspaces_sim.nav` registers them. `SoundSpaces/AudioGoalContinuous-v0` is of neighbours/continuous.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.extras import need
from soundspaces_sim.core.registry import Entry, installed, of_neighbour
from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.env_options import EnvOptions, env_options
from soundspaces_sim.nav.episode_state import EpisodeState
from soundspaces_sim.nav.episodes import Episode, read_episodes
from soundspaces_sim.nav.generate import EpisodeMaker
from soundspaces_sim.nav.metrics import NAMES
from soundspaces_sim.nav.sensor_table import SENSOR_TABLE
from soundspaces_sim.nav.sensors import SensorSuite
from soundspaces_sim.nav.sounds import SoundBank
from soundspaces_sim.nav.task import SENSORS

need("an environment", "nav")

import gymnasium as gymnasium  # noqa: E402 - after it is known to be there
from gymnasium import spaces as spaces  # noqa: E402
from gymnasium.error import InvalidAction, ResetNeeded  # noqa: E402

_MAP = Entry(
    "soundspaces_pictures.episode_map:map_frame",
    "the map of an episode",
    "parameters renderers pictures",
)
PREFIX = "SoundSpaces"
GROUP = "soundspaces_sim.environments"  # of entry points: functions by which neighbours register theirs


def register_environments() -> None:
    """Make the ids known to `gymnasium.make` and `gymnasium.make_vec`; twice is as good as once."""
    for task in SENSORS:
        name = f"{PREFIX}/{task}-v0"
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="soundspaces_sim.nav.env:AudioNavEnv",
                vector_entry_point="soundspaces_sim.nav.vector:AudioNavVectorEnv",
                kwargs={"task": task},
            )
    for register in installed(GROUP, Callable):  # type: ignore[arg-type]
        register()


class Setting:
    """Data, sounds, episodes and sensors of an environment of one agent or of many."""

    def __init__(self, options: EnvOptions) -> None:
        data = options.data
        self.data = data if isinstance(data, NavData) else NavData(data)
        self.task, split, episodes = options, options.split, options.episodes
        self.bank, names = open_sounds(options.sounds, check_rates(self.data, split), split)
        self.episodes: tuple[Episode, ...] | None = None
        self.maker: EpisodeMaker | None = None
        if episodes is None:
            self.maker = EpisodeMaker(self.data, split, self.bank, names)
        else:
            read = (
                read_episodes(episodes, self.data)
                if isinstance(episodes, str | Path)
                else list(episodes)
            )
            if not read:
                raise ConfigError("episodes: expected at least one, or None to draw new ones")
            for sound in {e.sound for e in read}:
                self.bank.check(sound)
            self.episodes = tuple(read)
        self.sensor_suite = SensorSuite(self.data, self.bank, options, options.cache)
        self.observation_space = spaces.Dict(
            {
                s: box(SENSOR_TABLE[s].low, SENSOR_TABLE[s].high, shape)
                for s, shape in self.sensor_suite.shapes.items()
            }
        )
        self.action_space = spaces.Discrete(4)

    def episode(self, rng: np.random.Generator, wanted: Any, number: int) -> Episode:
        """The requested episode, or one drawn uniformly."""
        found = wanted_episode({"episode": wanted}, Episode, self.episodes)
        if found is not None:
            self.bank.check(found.sound)
            return found
        if self.episodes is not None:
            return self.episodes[int(rng.integers(len(self.episodes)))]
        assert self.maker is not None
        return self.maker.draw(rng, f"drawn-{number}")

    def start(
        self, rng: np.random.Generator, options: dict[str, Any] | None, number: int
    ) -> EpisodeState:
        """The state of a new episode."""
        wanted = wanted_episode(options, Episode, self.episodes)
        episode = self.episode(rng, wanted, number)
        return EpisodeState(self.data.graph(episode.scene), episode, self.task)


_Of = TypeVar("_Of")


def wanted_episode(
    options: dict[str, Any] | None, kind: type[_Of], episodes: tuple[_Of, ...] | None
) -> _Of | None:
    """The episode that the options of `reset` ask for, a record or a number of `episodes`; None for any. Raises
    `ConfigError`."""
    unknown = set(options or ()) - {"episode"}
    if unknown:
        raise ConfigError(
            f"options: expected 'episode' alone, got {', '.join(sorted(map(str, unknown)))}"
        )
    wanted, count = (options or {}).get("episode"), len(episodes or ())
    if wanted is None or isinstance(wanted, kind):
        return wanted
    whole = isinstance(wanted, int | np.integer) and not isinstance(wanted, bool)
    if not (whole and 0 <= wanted < count):
        raise ConfigError(
            f"options['episode']: expected {'an' if kind is Episode else 'a'} {kind.__name__} or a number below "
            f"{count} (episodes of this environment), got {wanted!r}"
        )
    assert episodes is not None
    return episodes[int(wanted)]


def check_rates(data: NavData, split: str) -> int:
    """The sampling rate of a split's scenes. Raises `ConfigError` if they differ."""
    rates = {scene: data.dataset(scene).rate for scene in data.scenes(split)}
    if len(set(rates.values())) > 1:
        raise ConfigError(f"{data.root}: scenes of split '{split}' differ in sampling rate: {rates}")
    return next(iter(rates.values()))


def state_info(state: Any) -> dict[str, Any]:
    """`info` of a state on the graph or in continuous space: where the agent is, and the measures so far."""
    episode = state.episode
    return {
        "episode_id": episode.episode_id,
        "scene": episode.scene,
        "sound": episode.sound,
        "node": state.node,
        "heading": state.heading,
        **vars(state.metrics()),
    }


def check_action(action: Any, space: spaces.Discrete) -> int:
    """The action as a number. Raises `InvalidAction`."""
    if type(action) in (int, np.int64) and 0 <= action < space.n:  # `contains` takes 5 µs
        return int(action)
    if not space.contains(np.int64(action) if isinstance(action, int) else action):
        raise InvalidAction(f"action {action!r}: expected 0 STOP, 1 FORWARD, 2 LEFT or 3 RIGHT")
    return int(action)


class AudioNavEnv(gymnasium.Env[dict[str, np.ndarray], np.int64]):
    """One agent in one scene at a time.

    `reset(options={"episode": e})` takes an `Episode`, or a number of `episodes`. Raises `ConfigError` and other
    errors of ours for bad settings. A pickle is the settings.

    Parameters
    ----------
    data : folder of datasets, with `splits.toml`, or `NavData`
    render_mode : 'rgb_array' draws the map (needs matplotlib)
    options : those of `EnvOptions`, by name
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012 - as Gymnasium declares it
    names = NAMES  # of measures

    def __init__(
        self, data: str | Path | NavData, *, render_mode: str | None = None, **options: Any
    ) -> None:
        self._arguments = {"data": data, "render_mode": render_mode, **options}
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"render_mode: expected None or 'rgb_array', got {render_mode!r}")
        self.setting = self._make_setting(data, options)
        self.observation_space = self.setting.observation_space
        self.action_space = self.setting.action_space
        self.render_mode = render_mode
        self.state: EpisodeState | None = None
        self.trail: list[Any] = []  # poses: states of the graph, or (x, y, facing)
        self._number = 0

    def _make_setting(self, data: str | Path | NavData, options: Mapping[str, Any]) -> Any:
        return Setting(env_options("AudioNavEnv", data, options))

    def _info(self, state: Any) -> dict[str, Any]:
        return state_info(state)

    def __getstate__(self) -> dict[str, Any]:
        return {**self._arguments, "spec": self.spec}

    def __setstate__(self, state: dict[str, Any]) -> None:
        spec = state.pop("spec")
        self.__init__(**state)  # type: ignore[misc]
        self.spec = spec

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The first observation of an episode, and `info`."""
        super().reset(seed=seed)
        if seed is not None:
            self._number = 0  # drawn episodes are named by their number, which is to repeat itself, too
        self.state = self.setting.start(self.np_random, options, self._number)
        self._number += 1
        self.trail = [self.state.pose]
        return self._observation(), self._info(self.state)

    def step(
        self, action: np.int64 | int
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Observation, reward, terminated, truncated, info. Raises `ResetNeeded`, `InvalidAction`."""
        if self.state is None or self.state.over:
            raise ResetNeeded("call reset() before step(): there is no episode, or it is over")
        reward, terminated, truncated = self.state.move(check_action(action, self.setting.action_space))
        self.trail.append(self.state.pose)
        return self._observation(), reward, terminated, truncated, self._info(self.state)

    def _observation(self) -> dict[str, np.ndarray]:
        assert self.state is not None
        out = self.setting.sensor_suite.empty()
        self.setting.sensor_suite.observe(self.state, self.np_random, out)
        return out

    def render(self) -> np.ndarray | None:
        """(height, width, 3) uint8: the map with the way so far; None without a render mode."""
        if self.render_mode is None:
            return None
        if self.state is None:
            raise ResetNeeded("call reset() before render()")
        return self._draw(self.setting.data.dataset(self.state.episode.scene), self.state)

    def _draw(self, dataset: RirDataset, state: Any) -> np.ndarray:
        return of_neighbour("a picture", _MAP)(dataset, state, self.trail)

    def close(self) -> None:
        """Close the datasets' files."""
        self.setting.data.close()


def box(low: tuple[float, ...], high: tuple[float, ...], shape: tuple[int, ...]) -> spaces.Box:
    """The space of a sensor: bounds of all elements, or of each."""
    least, most = np.array(low, np.float32), np.array(high, np.float32)
    return spaces.Box(np.broadcast_to(least, shape), np.broadcast_to(most, shape), shape, np.float32)


def open_sounds(
    sounds: str | Path | Sequence[str] | SoundBank, rate: int, split: str
) -> tuple[SoundBank, tuple[str, ...]]:
    """The bank, and names to draw from."""
    if isinstance(sounds, SoundBank):
        return sounds, sounds.names(split)
    if isinstance(sounds, Path) or (isinstance(sounds, str) and Path(sounds).is_dir()):
        bank = SoundBank(rate, sounds)
        return bank, bank.names(split)
    bank = SoundBank(rate)
    if isinstance(sounds, str):
        names = bank.splits.get(sounds, (sounds,))
    else:
        names = tuple(sounds)
    for name in names:
        bank.check(name)
    return bank, names
