"""PPO of Stable-Baselines3 in continuous space: an example that learns, tested against the follower of sound.

What an agent is told of a step is `continuous_policy.inputs_of`; the last steps are stacked, for the network has no
memory. Its agents share one setting, so that spectra of a pair of points are made once. Tests are in scenes that it
was not trained in, in the same episodes as the follower's.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from matplotlib.figure import Figure
from soundspaces_continuous import (
    ContinuousEpisode,
    ContinuousNavEnv,
    ContinuousState,
    DirectionFollower,
    Rules,
    draw_episode,
)
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from soundspaces_agents.learn.continuous_policy import INPUTS, SENSORS, inputs_of
from soundspaces_sim import Scene
from soundspaces_sim.nav import NavData, Result, evaluate
from soundspaces_sim.parts import STOP
from soundspaces_sim.parts import publish_file as publish

CURVE, PICTURE, PAGE = "curve.jsonl", "continuous_ppo.png", "continuous_ppo.md"
_RECENT = 200  # episodes of training over which success is a mean


@dataclass(frozen=True)
class SbConfig:
    """`agents` learn at once for `steps` in all; every `every` steps the network is tested in `episodes` of each
    scene. `stack`: steps that it is told of; `stop_bias`: of its first logit, as random STOPs end episodes."""

    steps: int = 300_000
    every: int = 50_000
    agents: int = 8
    episodes: int = 24
    stack: int = 4
    rollout: int = 256
    batch: int = 512
    epochs: int = 6
    rate: float = 5e-4
    entropy: float = 0.01
    width: int = 128
    stop_bias: float = -3.0
    max_steps: int = 160
    turn_deg: float = 30.0
    places: int = 4
    min_distance: float = 3.0
    memory: int = 4_000_000_000

    def options(self, data: NavData, split: str) -> dict[str, Any]:
        """Of the environments."""
        rules = Rules(min_distance=self.min_distance, places=self.places)
        return {
            "data": data, "split": split, "rules": rules, "sensors": SENSORS, "max_steps": self.max_steps,
            "turn_deg": self.turn_deg, "memory": self.memory,
        }  # fmt: skip


class Stack:
    """The last steps' inputs, one after the other; before the first one they are 0."""

    def __init__(self, steps: int, rate: int) -> None:
        self.rate, self._rows = rate, deque([np.zeros(INPUTS, np.float32)] * steps, steps)
        self._last: int | None = None

    def add(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        """(steps * INPUTS,) with this observation at the end."""
        self._rows.append(inputs_of(observation, self._last, self.rate))
        return np.concatenate(self._rows)

    def took(self, action: int) -> None:
        """What is done next."""
        self._last = action


class StackedInputs(gymnasium.Wrapper):
    """Observations as SB3's networks for vectors take them."""

    def __init__(self, env: ContinuousNavEnv, steps: int) -> None:
        super().__init__(env)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (steps * INPUTS,), np.float32)
        self._steps, self._rate = steps, env.setting.bank.rate

    def reset(self, **options: Any) -> tuple[np.ndarray, dict[str, Any]]:
        """The first observation of an episode."""
        observation, info = self.env.reset(**options)
        self._stack = Stack(self._steps, self._rate)
        return self._stack.add(observation), info

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """As of the environment."""
        self._stack.took(int(action))
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._stack.add(observation), float(reward), terminated, truncated, info


class SbAgent:
    """Draws actions as an SB3 policy says."""

    name = "PPO"

    def __init__(self, policy: Any, stack: int, rate: int) -> None:
        self.policy, self._steps, self._rate = policy, stack, rate

    def reset(self, state: ContinuousState, seed: int) -> None:
        """A new episode begins."""
        del state
        self._rng, self._stack = np.random.default_rng(seed), Stack(self._steps, self._rate)

    @torch.no_grad()
    def act(self, observation: dict[str, np.ndarray]) -> int:
        """The next action."""
        inputs = torch.from_numpy(self._stack.add(observation))[None]
        chances = self.policy.get_distribution(inputs).distribution.probs[0].double().numpy()
        action = int(self._rng.choice(len(chances), p=chances / chances.sum()))
        self._stack.took(action)
        return action


def draw_tests(env: ContinuousNavEnv, config: SbConfig) -> list[ContinuousEpisode]:
    """So many in each scene of the environment."""
    setting, rules = env.setting, env.setting.task.rules
    found = []
    for row, scene in enumerate(setting.scenes):
        rng, world = np.random.default_rng((row, 0x5B3)), setting.world(scene)
        for k in range(config.episodes):
            found.append(draw_episode(world, rng, f"{scene}-{k}", rules, setting.sounds))
    return found


class _Watch(BaseCallback):
    """Writes a row of the curve every `every` steps."""

    def __init__(
        self, config: SbConfig, path: Path, test: Callable[[Any], Result], log: Callable[[str], None]
    ) -> None:
        super().__init__()
        self.config, self.path, self.test, self.log = config, path, test, log
        self._recent: deque[tuple[float, float]] = deque(maxlen=_RECENT)
        self._episodes = 0
        self._testing_s = 0.0
        self._began = time.process_time()

    def _on_step(self) -> bool:
        for done, info in zip(self.locals["dones"], self.locals["infos"], strict=True):
            if done:
                self._episodes += 1
                self._recent.append((info["success"], info["spl"]))
        due = self.num_timesteps % self.config.every < self.config.agents
        if (
            due and self.num_timesteps < self.config.steps
        ):  # the last row is of the network that has learnt all
            self.write()
        return True

    def write(self) -> Result:
        """A row: what the last episodes of training were, and a test, which is returned."""
        began = time.process_time()
        tested = self.test(self.model.policy)
        rows = tested.rows
        self._testing_s += time.process_time() - began
        success, spl = np.mean(list(self._recent) or [(0.0, 0.0)], axis=0)
        spent = time.process_time() - self._began - self._testing_s
        row = {
            "steps": self.num_timesteps,
            "episodes": self._episodes,
            "processor_s": spent,
            "train_success": float(success),
            "train_spl": float(spl),
            "test_success": float(rows["success"].mean()),
            "test_spl": float(rows["spl"].mean()),
        }
        with open(self.path, "a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        self.log(", ".join(f"{name} {value:.3g}" for name, value in row.items()))
        return tested


def run_sb3(
    data: Path | NavData,
    out: Path,
    config: SbConfig | None = None,
    seed: int = 0,
    log: Callable[[str], None] = print,
    scenes: Mapping[str, Scene] | None = None,
) -> Path:
    """Train in the split ``train`` of a folder of datasets, test in ``test``, and write the page with the curve;
    its path. `scenes`: those that cannot be loaded by name."""
    config = config or SbConfig()
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    out.mkdir(parents=True, exist_ok=True)
    (out / CURVE).unlink(missing_ok=True)
    data = data if isinstance(data, NavData) else NavData(data)
    more: dict[str, Any] = {"scenes": scenes or {}}
    tested = ContinuousNavEnv(**config.options(data, "test"), **more)
    rate = tested.setting.bank.rate
    episodes = draw_tests(tested, config)
    follower = evaluate(DirectionFollower(rate), tested, episodes, seed)
    log(
        f"follower: success {follower.rows['success'].mean():.3f}, SPL {follower.rows['spl'].mean():.3f}"
    )
    first = ContinuousNavEnv(**config.options(data, "train"), **more)

    def make() -> gymnasium.Env:
        env = ContinuousNavEnv(**config.options(data, "train"), **more)
        env.setting = first.setting  # its spectra
        return StackedInputs(env, config.stack)

    agents = VecNormalize(
        DummyVecEnv([make] * config.agents), norm_obs=False
    )  # rewards by their spread, as in `small`
    agents.seed(seed)
    model = PPO(
        "MlpPolicy", agents, learning_rate=lambda left: config.rate * left, n_steps=config.rollout,
        batch_size=config.batch, n_epochs=config.epochs, ent_coef=config.entropy, seed=seed, device="cpu",
        policy_kwargs={"net_arch": [config.width, config.width]},
    )  # fmt: skip
    with torch.no_grad():
        model.policy.action_net.bias[STOP] = config.stop_bias

    def test(policy: Any) -> Result:
        return evaluate(SbAgent(policy, config.stack, rate), tested, episodes, seed)

    watch = _Watch(config, out / CURVE, test, log)
    model.learn(config.steps, callback=watch)
    last = watch.write()
    model.save(out / "ppo.zip")
    return _write_page(out, config, follower, last)


def _write_page(out: Path, config: SbConfig, follower: Result, last: Result) -> Path:
    rows = [json.loads(line) for line in (out / CURVE).read_text(encoding="utf-8").splitlines()]
    _draw(rows, follower, out / PICTURE)
    lines = ["| agent | success | SPL | actions |", "|---|---|---|---|"]
    for name, result in (("SB3's PPO, at the end", last), ("DirectionFollower", follower)):
        s = result.summary()
        lines.append(f"| {name} | {s['success']} | {s['spl']} | {result.rows['na'].mean():.0f} |")
    more = [last.compare(follower, measure) for measure in ("success", "spl")]
    lines += [f"| paired difference | {more[0]} | {more[1]} | |", ""]
    lines += [
        "| steps | processor s | episodes | success, training | success, test | SPL, test |",
        "|" + "---|" * 6,
    ]
    lines += [
        f"| {r['steps']:,} | {r['processor_s']:.0f} | {r['episodes']:,} | {r['train_success']:.3f} "
        f"| {r['test_success']:.3f} | {r['test_spl']:.3f} |"
        for r in rows
    ]
    lines += ["", f"![success by steps]({PICTURE})", "", f"`{json.dumps(asdict(config))}`"]
    publish(out / PAGE, ("\n".join(lines) + "\n").encode())
    return out / PAGE


def _draw(rows: list[dict[str, float]], follower: Result, path: Path) -> None:
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.add_subplot()
    steps = [row["steps"] / 1e3 for row in rows]
    axes.plot(
        steps, [r["train_success"] for r in rows], "--", color="#0072B2", label="PPO, while training"
    )
    axes.plot(
        steps, [r["test_success"] for r in rows], "o-", color="#0072B2", label="PPO, homes never seen"
    )
    level = float(follower.rows["success"].mean())
    axes.axhline(level, color="#D55E00", label="DirectionFollower, the same episodes")
    axes.set_xlabel("steps (thousands)")
    axes.set_ylabel("success")
    axes.set_ylim(0.0, 1.0)
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=100)
