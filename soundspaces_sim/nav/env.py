"""Gymnasium environments: an agent that hears, sees depth, walks a graph and stops at the sound.

`SoundSpaces/AudioGoal-v0`, `SoundSpaces/AudioPointGoal-v0`, `SoundSpaces/PointGoal-v0`; importing
`soundspaces_sim.nav` registers them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.nav.audio_sensor import Cache, PadMode
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episode_state import Walk
from soundspaces_sim.nav.episodes import Episode, read_episodes
from soundspaces_sim.nav.errors import need
from soundspaces_sim.nav.generate import EpisodeMaker
from soundspaces_sim.nav.sensors import Senses
from soundspaces_sim.nav.sounds import DEFAULT, SoundBank
from soundspaces_sim.nav.task import (
    SENSORS,
    DistanceReward,
    Ears,
    Task,
    TaskName,
    as_sensors,
    sensor_bounds,
)

need("an environment", "nav")

import gymnasium as gymnasium  # noqa: E402 - after it is known to be there
from gymnasium import spaces  # noqa: E402
from gymnasium.error import InvalidAction, ResetNeeded  # noqa: E402

PREFIX = "SoundSpaces"


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


class Setting:
    """What one environment and many have in common: data, bank of sounds, episodes, senses."""

    def __init__(
        self, data: str | Path | NavData, task: Task, split: str, episodes: str | Path | Sequence[Episode] | None,
        sounds: str | Path | Sequence[str] | SoundBank, cache: Cache,
    ) -> None:  # fmt: skip
        self.data = data if isinstance(data, NavData) else NavData(data)
        self.task = task
        scenes = self.data.scenes(split)
        rates = {scene: self.data.dataset(scene).rate for scene in scenes}
        if len(set(rates.values())) > 1:
            raise ConfigError(
                f"{self.data.root}: scenes of split '{split}' differ in sampling rate: {rates}"
            )
        self.bank, names = _open_sounds(sounds, rates[scenes[0]], split)
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
        self.senses = Senses(self.data, self.bank, task, cache)
        self.observation_space = spaces.Dict(
            {s: _box(s, shape) for s, shape in self.senses.shapes.items()}
        )
        self.action_space = spaces.Discrete(4)

    def episode(self, rng: np.random.Generator, wanted: Any, number: int) -> Episode:
        """The episode that is wanted, or one by lot."""
        if isinstance(wanted, Episode):
            self.bank.check(wanted.sound)
            return wanted
        if wanted is not None:
            count = len(self.episodes or ())
            if (
                isinstance(wanted, bool)
                or not isinstance(wanted, int | np.integer)
                or not 0 <= wanted < count
            ):
                raise ConfigError(
                    f"options['episode']: expected an Episode or a number below {count} (episodes of this "
                    f"environment), got {wanted!r}"
                )
            assert self.episodes is not None
            return self.episodes[int(wanted)]
        if self.episodes is not None:
            return self.episodes[int(rng.integers(len(self.episodes)))]
        assert self.maker is not None
        return self.maker.draw(rng, f"drawn-{number}")

    def start(self, rng: np.random.Generator, options: dict[str, Any] | None, number: int) -> Walk:
        """A walk at its beginning."""
        unknown = set(options or ()) - {"episode"}
        if unknown:
            raise ConfigError(
                f"options: expected 'episode' alone, got {', '.join(sorted(map(str, unknown)))}"
            )
        episode = self.episode(rng, (options or {}).get("episode"), number)
        return Walk(self.data.world(episode.scene), episode, self.task)


def walk_info(walk: Walk) -> dict[str, Any]:
    """`info` of a walk: where it is, and the measures so far."""
    episode = walk.episode
    return {
        "episode_id": episode.episode_id, "scene": episode.scene, "sound": episode.sound, "node": walk.node,
        "heading": walk.heading, **vars(walk.metrics()),
    }  # fmt: skip


def check_action(action: Any, space: spaces.Discrete) -> int:
    """The action as a number. Raises `InvalidAction`."""
    if not space.contains(np.int64(action) if isinstance(action, int) else action):
        raise InvalidAction(f"action {action!r}: expected 0 STOP, 1 FORWARD, 2 LEFT or 3 RIGHT")
    return int(action)


class AudioNavEnv(gymnasium.Env[dict[str, np.ndarray], np.int64]):
    """One agent in one scene at a time.

    Parameters
    ----------
    data : folder of datasets, with `splits.toml`, or `NavData`
    split : whose scenes (and, of a bank's split, whose sounds)
    episodes : file or folder of a split, or a list; None draws new ones. Of several, each reset takes one by lot
    sounds : name of a sound; 'train', 'val', 'test': those of that split; a list; a folder of files (those of
        `split`); a `SoundBank`. Only of drawn episodes: others say what sounds
    sensors : names; None: those of the task. See `task.SENSORS`, docs/navigation.md
    max_steps : truncates
    success_radius : m from the goal within which STOP is right; 0: exactly there
    gps_sigma : standard deviation of both components of the displacement to the goal, m
    snr_db : of white noise in what is heard, re its own RMS; None: none
    depth_size : pixels per side
    ears : 'mono' gives both ears their mean (of waveforms, of spectrograms, of power): no direction is heard
    pad_mode : how spectrograms go on beyond a second: 'constant' zeros (librosa from 0.10 on), 'reflect' as before,
        which agents trained on SoundSpaces' observations of then expect; spectrograms baked on disk do not serve it
    distance_reward : 'metre' per m nearer (SoundSpaces' code), 'step' ±1 per edge (the paper's words)
    cache : 'memory', 'disk', 'none', see `Hearing`
    render_mode : 'rgb_array' draws the map (needs matplotlib)

    `reset(options={"episode": e})` takes an `Episode`, or a number of `episodes`. Raises `ConfigError` and other
    errors of ours for bad settings. A pickle is the settings.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(
        self, data: str | Path | NavData, *, task: TaskName = "AudioGoal", split: str = "train",
        episodes: str | Path | Sequence[Episode] | None = None,
        sounds: str | Path | Sequence[str] | SoundBank = DEFAULT, sensors: Sequence[str] | None = None,
        max_steps: int = 500, success_radius: float = 0.0, gps_sigma: float = 0.0, snr_db: float | None = None,
        depth_size: int = 128, distance_reward: DistanceReward = "metre", ears: Ears = "binaural",
        pad_mode: PadMode = "constant", cache: Cache = "memory", render_mode: str | None = None,
    ) -> None:  # fmt: skip
        self._arguments = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"render_mode: expected None or 'rgb_array', got {render_mode!r}")
        settings = Task(
            task, as_sensors(sensors), max_steps,
            success_radius, gps_sigma, snr_db, depth_size, distance_reward, ears, pad_mode,
        )  # fmt: skip
        self.setting = Setting(data, settings, split, episodes, sounds, cache)
        self.observation_space = self.setting.observation_space  # type: ignore[assignment]
        self.action_space = self.setting.action_space
        self.render_mode = render_mode
        self.walk: Walk | None = None
        self.trail: list[int] = []
        self._number = 0

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
        self.walk = self.setting.start(self.np_random, options, self._number)
        self._number += 1
        self.trail = [self.walk.state]
        return self._observation(), walk_info(self.walk)

    def step(
        self, action: np.int64 | int
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Observation, reward, terminated, truncated, info. Raises `ResetNeeded`, `InvalidAction`."""
        if self.walk is None or self.walk.over:
            raise ResetNeeded("call reset() before step(): there is no episode, or it is over")
        reward, terminated, truncated = self.walk.move(check_action(action, self.setting.action_space))
        self.trail.append(self.walk.state)
        return self._observation(), reward, terminated, truncated, walk_info(self.walk)

    def _observation(self) -> dict[str, np.ndarray]:
        assert self.walk is not None
        out = self.setting.senses.empty()
        self.setting.senses.observe(self.walk, self.np_random, out)
        return out

    def render(self) -> np.ndarray | None:
        """(height, width, 3) uint8: the map with the way so far; None without a render mode."""
        if self.render_mode is None:
            return None
        if self.walk is None:
            raise ResetNeeded("call reset() before render()")
        from soundspaces_sim.nav.replay import map_frame

        return map_frame(self.setting.data.dataset(self.walk.episode.scene), self.walk, self.trail)

    def close(self) -> None:
        """Close the datasets' files."""
        self.setting.data.close()


def _box(sensor: str, shape: tuple[int, ...]) -> spaces.Box:
    low, high = (np.array(bound, np.float32) for bound in sensor_bounds(sensor))
    return spaces.Box(np.broadcast_to(low, shape), np.broadcast_to(high, shape), shape, np.float32)


def _open_sounds(
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
