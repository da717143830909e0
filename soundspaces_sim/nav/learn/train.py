"""A run of training: environments, network, learner; goes on where it was stopped.

What a run is at is kept every `_EVERY` updates: weights, optimiser, random numbers. Episodes that were under
way are begun anew after an interruption, so an interrupted run is as good as another one, not the same to the bit.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.learn.checkpoint import policy_of, read_checkpoint, save_checkpoint
from soundspaces_sim.nav.learn.dagger import Dagger
from soundspaces_sim.nav.learn.net import Policy
from soundspaces_sim.nav.learn.ppo import Ppo
from soundspaces_sim.nav.learn.rollout import Collector
from soundspaces_sim.nav.learn.run_files import CURVE, NAME, read_curve
from soundspaces_sim.nav.presets import TrainConfig
from soundspaces_sim.nav.task import EarMode, TaskName
from soundspaces_sim.nav.vector import AudioNavVectorEnv

Method = Literal["ppo", "dagger"]
_EVERY = 10  # updates


@dataclass(frozen=True)
class Run:
    """What to train: `name`, `task`, `sensors` (None: the task's), `sounds`, by `method`; `start`: a checkpoint
    to begin from."""

    name: str
    task: TaskName = "AudioGoal"
    sensors: tuple[str, ...] | None = None
    method: Method = "ppo"
    sounds: str | tuple[str, ...] = "telephone"
    ears: EarMode = "binaural"
    start: str | None = None


def one_thread() -> None:
    """Networks are small: processes, not threads, fill a machine, and results do not depend on its cores."""
    torch.set_num_threads(1)


def train_agent(
    run: Run, config: TrainConfig, data: str | Path | NavData, out: Path, seed: int = 0,
    episodes: str | Path | None = None, progress: Callable[[dict[str, Any]], None] | None = None,
) -> Path:  # fmt: skip
    """Train into the folder `out`, and return the checkpoint; nothing is done if it is finished already.

    The same seed and data give the same weights, unless the run was interrupted. Raises `ConfigError`.
    """
    one_thread()
    torch.manual_seed(seed)
    out.mkdir(parents=True, exist_ok=True)
    path = out / NAME
    env = AudioNavVectorEnv(
        config.envs, data, task=run.task, sensors=run.sensors, sounds=run.sounds, episodes=episodes,
        max_steps=config.max_steps, depth_size=config.depth_size, ears=run.ears, cache="disk",
        autoreset_mode="SameStep",
    )  # fmt: skip
    policy = Policy(env.setting.sensor_suite.shapes, config.net)
    if run.start is not None and not path.exists():
        policy = policy_of(read_checkpoint(Path(run.start)), Path(run.start))
    saved: dict[str, Any] = {}
    if path.exists():
        content = read_checkpoint(path)
        policy, saved = policy_of(content, path), content["learner"]
        if list(policy.shapes.items()) != [
            (k, tuple(v)) for k, v in env.setting.sensor_suite.shapes.items()
        ]:
            raise ConfigError(
                f"{path}: this run was begun with other sensors or sizes; choose another folder"
            )
        if saved.get("done", 0) >= config.updates:
            return path
    if run.method not in ("ppo", "dagger"):
        raise ConfigError(f"method: expected ppo or dagger, got {run.method!r}")
    collector = Collector(env, policy, seed * 1_000_003 + 7919 * saved.get("done", 0))
    learner = (Ppo if run.method == "ppo" else Dagger)(policy, collector, config, seed)
    if saved:
        learner.done, collector.episodes = saved["done"], saved.get("episodes", 0)
        kept = [json.dumps(row) + "\n" for row in read_curve(out) if row["update"] <= learner.done]
        publish(out / CURVE, "".join(kept).encode())
        learner.optimizer.load_state_dict(saved["optimizer"])
        learner.generator.set_state(saved["generator"])
    else:
        (out / CURVE).unlink(missing_ok=True)
    _loop(learner, run, config, out, saved, progress)
    env.close()
    return path


def _loop(
    learner: Ppo | Dagger, run: Run, config: TrainConfig, out: Path, saved: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None,
) -> None:  # fmt: skip
    seconds, began, steps = float(saved.get("seconds", 0.0)), time.monotonic(), 0
    while learner.done < config.updates:
        losses = learner.update()
        steps += config.envs * config.steps
        spent = time.monotonic() - began
        row = {
            "update": learner.done, "steps": learner.done * config.envs * config.steps,
            "steps_per_s": steps / spent, "seconds": seconds + spent, "episodes": learner.collector.episodes,
            **learner.collector.means(), **losses,
        }  # fmt: skip
        with open(out / CURVE, "a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        if progress is not None:
            progress({**row, "updates": config.updates})
        if learner.done % _EVERY == 0 or learner.done == config.updates:
            state = {
                "done": learner.done, "seconds": seconds + spent, "optimizer": learner.optimizer.state_dict(),
                "generator": learner.generator.get_state(), "episodes": learner.collector.episodes,
            }  # fmt: skip
            save_checkpoint(out / NAME, learner.policy, run.name, state)


def shortened(config: TrainConfig, updates: int | None) -> TrainConfig:
    """The same numbers for a run of `updates` updates."""
    return config if updates is None else replace(config, updates=updates)
