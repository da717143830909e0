"""A run of training: states, network, learner; goes on where it was stopped, to the bit.

Encoders are taught first (`warm_start`), agents then learn on features, and encoders again in the last updates, as
far as the preset says so. What a run is at is kept every `_EVERY` updates: weights, optimiser, random numbers,
agents under way.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch

from soundspaces_agents.learn.checkpoint import policy_of, read_checkpoint, save_checkpoint
from soundspaces_agents.learn.dagger import Dagger
from soundspaces_agents.learn.net import Policy
from soundspaces_agents.learn.ppo import Ppo
from soundspaces_agents.learn.rollout import Collector, RewardScale
from soundspaces_agents.learn.run_files import CURVE, NAME, read_curve
from soundspaces_agents.learn.state_table import StateTable
from soundspaces_agents.learn.walkers import Walkers
from soundspaces_agents.learn.warm_start import warm_start
from soundspaces_agents.presets import TrainConfig
from soundspaces_sim import ConfigError
from soundspaces_sim.nav import NavData
from soundspaces_sim.parts import (
    EarMode,
    EnvSetting as Setting,
    TaskName,
    env_options,
    publish_file as publish,
)

Method = Literal["ppo", "dagger"]
_EVERY = 10  # updates


@dataclass(frozen=True)
class Run:
    """What to train: `name`, `task`, `sensors` (None: the task's), `sounds`, by `method`; `start`: a checkpoint
    to begin from, whose encoders are not taught anew."""

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


def check_device(device: str) -> torch.device:
    """A device of this machine by its name. Raises `ConfigError`."""
    try:
        found = torch.device(device)
        torch.zeros(1, device=found).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise ConfigError(
            f"device: PyTorch has no '{device}' here ({str(error).splitlines()[0]}); take cpu, or install a build "
            "of PyTorch for that device"
        ) from error
    return found


def train_agent(
    run: Run,
    config: TrainConfig,
    data: str | Path | NavData,
    out: Path,
    seed: int = 0,
    episodes: str | Path | None = None,
    progress: Callable[[dict[str, Any]], None] | None = None,
    device: str = "cpu",
) -> Path:
    """Train into the folder `out`, and return the checkpoint; nothing is done if it is finished already.

    The same seed and data give the same weights, interrupted or not. Raises `ConfigError`.
    """
    if run.method not in ("ppo", "dagger"):
        raise ConfigError(f"method: expected ppo or dagger, got {run.method!r}")
    place = check_device(device)
    one_thread()
    torch.manual_seed(seed)
    out.mkdir(parents=True, exist_ok=True)
    path = out / NAME
    setting = _setting(run, config, data, episodes)
    policy = Policy(setting.sensor_suite.shapes, config.net)
    if run.start is not None and not path.exists():
        policy = policy_of(read_checkpoint(Path(run.start)), Path(run.start))
    saved: dict[str, Any] = {}
    if path.exists():
        policy, saved = _read(path, setting)
        if saved.get("done", 0) >= config.updates:
            return path
    walkers = Walkers(config.envs, StateTable(setting))
    policy = policy.to(place)
    scale = RewardScale(config.envs, config.gamma) if config.scale_rewards else None
    collector = Collector(walkers, policy, seed * 1_000_003, scale, place)
    seconds = 0.0
    if saved:
        seconds = float(saved["seconds"])
    elif config.warm_batches and run.start is None and policy.encoders:
        began = time.monotonic()
        warm_start(policy, walkers.table, config, seed, place)
        seconds = time.monotonic() - began
    learner = (Ppo if run.method == "ppo" else Dagger)(policy, collector, config, seed)
    if saved:
        _go_on(learner, saved, out)
    else:
        (out / CURVE).unlink(missing_ok=True)
    _loop(learner, run, config, out, seconds, progress)
    setting.data.close()
    return path


def _setting(
    run: Run, config: TrainConfig, data: str | Path | NavData, episodes: str | Path | None
) -> Setting:
    options: dict[str, Any] = {
        "task": run.task,
        "sensors": run.sensors,
        "sounds": run.sounds,
        "episodes": episodes,
        "max_steps": config.max_steps,
        "depth_size": config.depth_size,
        "ears": run.ears,
        "cache": "disk",
    }
    return Setting(env_options("train_agent", data, options))


def _read(path: Path, setting: Setting) -> tuple[Policy, dict[str, Any]]:
    content = read_checkpoint(path)
    policy = policy_of(content, path)
    if list(policy.shapes.items()) != [(k, tuple(v)) for k, v in setting.sensor_suite.shapes.items()]:
        raise ConfigError(
            f"{path}: this run was begun with other sensors or sizes; choose another folder"
        )
    saved = content["learner"]
    if saved and "collector" not in saved:
        raise ConfigError(
            f"{path}: this run was begun by an earlier version, which kept no agents under way; it can be used, "
            "not continued: choose another folder, and begin there from it (start)"
        )
    return policy, saved


def _go_on(learner: Ppo | Dagger, saved: dict[str, Any], out: Path) -> None:
    learner.done = saved["done"]
    learner.collector.restore(saved["collector"])
    kept = [json.dumps(row) + "\n" for row in read_curve(out) if row["update"] <= learner.done]
    publish(out / CURVE, "".join(kept).encode())
    learner.optimizer.load_state_dict(saved["optimizer"])
    learner.generator.set_state(saved["generator"])


def _loop(
    learner: Ppo | Dagger,
    run: Run,
    config: TrainConfig,
    out: Path,
    seconds: float,
    progress: Callable[[dict[str, Any]], None] | None,
) -> None:
    began, first = time.monotonic(), learner.done
    each = config.envs * config.steps
    while learner.done < config.updates:
        losses = learner.update()
        spent = time.monotonic() - began
        row = {
            "update": learner.done,
            "steps": learner.done * each,
            "steps_per_s": (learner.done - first) * each / spent,
            "seconds": seconds + spent,
            "episodes": learner.collector.episodes,
            **learner.collector.means(),
            **losses,
        }
        with open(out / CURVE, "a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        if progress is not None:
            progress({**row, "updates": config.updates})
        if learner.done % _EVERY == 0 or learner.done == config.updates:
            state = {
                "done": learner.done,
                "seconds": seconds + spent,
                "optimizer": learner.optimizer.state_dict(),
                "generator": learner.generator.get_state(),
                "collector": learner.collector.snapshot(),
            }
            save_checkpoint(out / NAME, learner.policy, run.name, state)


def shortened(config: TrainConfig, updates: int | None) -> TrainConfig:
    """The same numbers for a run of `updates` updates."""
    if updates is None:
        return config
    return replace(config, updates=updates, finetune=config.finetune * updates // config.updates)
