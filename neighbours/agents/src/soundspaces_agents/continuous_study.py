"""A study of agents in continuous space: baselines, trained agents with three seeds, and what delays between the
ears are worth to them. Every stage goes on where it was stopped.

Trained agents hear with KEMAR's ears, or with the same ears without delays (`hrtf_delays`), in training and in the
test. Test episodes are in scenes of the split ``test``, each three times: with a sound that agents were trained
with; with one of a family that none has heard; and with the first, which falls silent after 5 to 10 s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from soundspaces_continuous import (
    ContinuousEpisode,
    ContinuousNavEnv,
    ContinuousOptions,
    ContinuousOracle,
    DirectionFollower,
    Rules,
    draw_episode,
)
from soundspaces_continuous.sound_field import PathsName

from soundspaces_agents.hrtf_delays import without_delays, write_hrtf
from soundspaces_agents.learn.continuous_dagger import DaggerConfig, load_policy, train_continuous
from soundspaces_agents.learn.continuous_policy import SENSORS, ContinuousAgent
from soundspaces_sim.nav import NavData, Result, SoundBank, evaluate
from soundspaces_sim.parts import load_result, merge_results as merge
from soundspaces_sim.rendering import load_hrtf

Log = Callable[[str], None]
EARS = ("delays", "no-delays")
SETS = ("heard", "unheard", "falls silent")
#: Goals are at least 3 m away and sound from the beginning, in training for 8 to 40 s, 32 to 160 steps. They stand
#: at some nodes of a scene, so that responses to them stay in memory.
RULES = {
    "train": Rules(min_distance=3.0, duration=(8.0, 40.0), places=4),
    "test": Rules(min_distance=3.0, places=8),
}
_SILENT_AFTER = 5.0, 10.0  # s
_MAX_STEPS, _TURN_DEG, _MEMORY = {"train": 80, "test": 160}, 30.0, 2_500_000_000


@dataclass(frozen=True)
class ContinuousStudy:
    """Folder of datasets with the splits ``train`` and ``test``; folder of the study; runs of training per kind of
    ears; episodes per scene and set; how discrete arrivals are had in training and in the test."""

    data: Path
    out: Path
    seeds: int = 3
    episodes: int = 12
    dagger: DaggerConfig = field(default_factory=DaggerConfig)
    train_paths: PathsName = "moved"
    paths: PathsName = "simulated"
    _envs: dict[str, ContinuousNavEnv] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def ears(self) -> dict[str, Path | None]:
        """The SOFA file of each kind of ears."""
        path = self.out / "ears-no-delays.sofa"
        if not path.exists():
            self.out.mkdir(parents=True, exist_ok=True)
            write_hrtf(path, without_delays(load_hrtf()))
        return {"delays": None, "no-delays": path}

    def _options(self, ears: str, split: str, paths: PathsName) -> dict[str, Any]:
        data = NavData(self.data, hrtf=self.ears[ears])
        return {
            "data": data, "split": split, "rules": RULES[split], "sounds": _one_of_each("train"),
            "sensors": SENSORS, "max_steps": _MAX_STEPS[split], "paths": paths,
            "turn_deg": _TURN_DEG, "memory": _MEMORY,
        }  # fmt: skip

    def train(self, log: Log) -> None:
        """All runs of training."""
        for seed in range(self.seeds):
            for ears in EARS:
                run = ContinuousOptions(**self._options(ears, "train", self.train_paths))
                log(f"training with {ears}, seed {seed}")
                folder, shared = self.run_folder(ears, seed), self.out / f"{ears}-led"
                train_continuous(run, folder, shared, seed, self.dagger, lambda row: log(_line(row)))

    def run_folder(self, ears: str, seed: int) -> Path:
        """Where a run of training is."""
        return self.out / f"{ears}-{seed}"

    def test_episodes(self) -> dict[str, list[ContinuousEpisode]]:
        """Episodes by set, with the same starts and goals."""
        setting = self._env("delays").setting
        heard, unheard = _one_of_each("train"), _one_of_each("test")
        sets: dict[str, list[ContinuousEpisode]] = {name: [] for name in SETS}
        for row, scene in enumerate(setting.scenes):
            rng = np.random.default_rng((row, 0xC0))
            for k in range(self.episodes):
                made = draw_episode(setting.world(scene), rng, f"{scene}-{k}", RULES["test"], heard)
                other, end = str(rng.choice(unheard)), float(rng.uniform(*_SILENT_AFTER))
                for name, change in zip(SETS, ({}, {"sound": other}, {"offset": end}), strict=True):
                    goals = tuple(replace(goal, **change) for goal in made.goals)  # type: ignore[arg-type]
                    sets[name].append(replace(made, goals=goals))
        return sets

    def evaluate(self, log: Log) -> dict[str, Result]:
        """Results by agent and set: what was walked before is read."""
        sets, results = self.test_episodes(), {}
        agents: list[tuple[str, str, Sequence[int]]] = [
            ("oracle", "delays", (0,)), ("ear follower", "delays", (0,)),
            *((f"trained, {ears}", ears, range(self.seeds)) for ears in EARS),
        ]  # fmt: skip
        for name, ears, seeds in agents:
            for which, episodes in sets.items():
                runs = [self._walk(name, ears, which, episodes, seed, log) for seed in seeds]
                results[f"{name}: {which}"] = merge(runs)
        return results

    def _env(self, ears: str) -> ContinuousNavEnv:
        """Where agents are tested; one for all, as spectra stay in memory."""
        if ears not in self._envs:
            self._envs[ears] = ContinuousNavEnv(**self._options(ears, "test", self.paths))
        return self._envs[ears]

    def _walk(
        self,
        name: str,
        ears: str,
        which: str,
        episodes: list[ContinuousEpisode],
        seed: int,
        log: Log,
    ) -> Result:
        file = f"{name}-{which}-{seed}.json".replace(", ", "-").replace(" ", "-")
        path = self.out / "results" / file
        if path.exists():
            return load_result(path)
        env = self._env(ears)
        agent: Any = {"oracle": ContinuousOracle, "ear follower": DirectionFollower}.get(name)
        if agent is None:
            agent = ContinuousAgent(
                load_policy(self.run_folder(ears, seed)), name, env.setting.bank.rate
            )
        else:
            agent = agent()
        result = evaluate(agent, env, episodes, seed)
        path.parent.mkdir(parents=True, exist_ok=True)
        result.save(path)
        log(f"{name}, {which}, seed {seed}: SPL {result.rows['spl'].mean():.3f}")
        return result


def _one_of_each(split: str) -> tuple[str, ...]:
    """One sound of each family of a split."""
    names = SoundBank(16000).names(split)
    return tuple({name.rpartition("_")[0]: name for name in reversed(names)}.values())


def _line(row: dict[str, Any]) -> str:
    walked = f", SPL {row['spl']:.2f}" if "spl" in row else ""
    return (
        f"  round {row['update']}: {row['steps']} steps{walked}, agreement {row['agreement']:.2f}, where "
        f"{row['where']:.3f}, {row['walking_s']:.1f} + {row['learning_s']:.1f} s"
    )
