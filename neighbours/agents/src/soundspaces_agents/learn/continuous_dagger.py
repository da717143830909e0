"""DAgger in continuous space: agents walk whole episodes, the oracle says what is right at each step, and a network
learns from all episodes so far (Ross, Gordon & Bagnell 2011, with the data set aggregated).

At first the oracle acts, too, in a share of the episodes that falls to none. Beside actions the network learns the
direction and the length of the way to the goal. Each round has seeds of its own, so a run that was stopped goes on
to the bit from its files.
"""

from __future__ import annotations

import io
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from soundspaces_continuous import ContinuousOptions, ContinuousSetting, ContinuousState
from torch import nn

from soundspaces_agents.learn.checkpoint import load
from soundspaces_agents.learn.continuous_policy import INPUTS, ContinuousPolicy, draw, inputs_of
from soundspaces_agents.learn.run_files import CURVE, NAME, read_curve
from soundspaces_sim import ConfigError
from soundspaces_sim.parts import publish_file as publish

_PADDED = -100  # `cross_entropy` skips it


_RANDOM = 0.25  # of the actions of agents that the oracle leads


@dataclass(frozen=True)
class DaggerConfig:
    """`rounds` of `episodes` each, in the first `led` of which the oracle acts; after each, `batches` of `batch`
    episodes are learnt from; `where`: weight of the auxiliary loss."""

    rounds: int = 9
    led: int = 6
    episodes: int = 32
    batches: int = 40
    batch: int = 24
    rate: float = 2e-3
    where: float = 1.0


@dataclass(frozen=True)
class _Walked:
    """Episodes, one after the other: their lengths (e,), inputs (n, INPUTS), the oracle's actions (n,), where the
    way leads (n, 3)."""

    length: np.ndarray
    inputs: np.ndarray
    action: np.ndarray
    where: np.ndarray


def _where(state: ContinuousState) -> tuple[float, float, float]:
    """Cosine and sine of the direction in which the shortest way to the nearest goal begins, as sound comes by the
    same doors, and log(1 + its length / m)."""
    far, x, y = state.way()
    angle = math.atan2(y - state.y, x - state.x) - state.facing
    return math.cos(angle), math.sin(angle), math.log1p(far)


def _walk(
    setting: ContinuousSetting, policy: ContinuousPolicy | None, count: int, seed: tuple[int, int]
) -> tuple[_Walked, dict[str, float]]:
    """Walk `count` episodes at once. Without a policy the oracle acts."""
    rng = np.random.default_rng(seed)
    generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
    states = [setting.start(rng, None, k) for k in range(count)]
    rows: list[list[tuple[np.ndarray, int, tuple[float, float, float]]]] = [[] for _ in states]
    last: list[int | None] = [None] * count
    hidden = None if policy is None else torch.zeros(1, count, policy.gru.hidden_size)
    out, rate = setting.sensor_suite.empty(), setting.bank.rate
    while active := [k for k, state in enumerate(states) if not state.over]:
        seen = np.empty((1, len(active), INPUTS), np.float32)
        for i, k in enumerate(active):
            setting.sensor_suite.observe(states[k], rng, out)
            seen[0, i] = inputs_of(out, last[k], rate)
        right = [states[k].oracle_action() for k in active]
        if policy is None or hidden is None:
            chosen = [int(rng.integers(1, 4)) if rng.random() < _RANDOM else r for r in right]
        else:
            with torch.no_grad():
                logits, _, hidden[:, active] = policy(torch.from_numpy(seen), hidden[:, active])
            chosen = draw(logits[0], generator).tolist()
        for i, k in enumerate(active):
            rows[k].append((seen[0, i], right[i], _where(states[k])))
            last[k] = chosen[i]
            states[k].move(chosen[i])
    flat = [row for episode in rows for row in episode]
    measures = [state.metrics() for state in states]
    said = {name: float(np.mean([getattr(m, name) for m in measures])) for name in ("success", "spl")}
    walked = _Walked(
        np.array([len(episode) for episode in rows]),
        np.stack([row[0] for row in flat]),
        np.array([row[1] for row in flat]),
        np.array([row[2] for row in flat], np.float32),
    )
    return walked, said


class _Learner:
    """`policy`, its optimiser, and all that has been walked."""

    def __init__(self, config: DaggerConfig, seed: int) -> None:
        torch.manual_seed(seed)
        self.config, self.seed = config, seed
        self.policy = ContinuousPolicy()
        self.optimizer = torch.optim.Adam(self.policy.parameters(), config.rate)
        self.episodes: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = []

    def add(self, walked: _Walked) -> None:
        ends = np.cumsum(walked.length)
        for first, last in zip(ends - walked.length, ends, strict=True):
            parts = walked.inputs[first:last], walked.action[first:last], walked.where[first:last]
            self.episodes.append(tuple(torch.from_numpy(p) for p in parts))  # type: ignore[arg-type]

    def learn(self, done: int) -> dict[str, float]:
        """What a round learns: means of both losses and the share of right actions."""
        config, rng = self.config, np.random.default_rng((self.seed, done, 1))
        for group in self.optimizer.param_groups:
            group["lr"] = config.rate * (1.0 - 0.9 * done / config.rounds)
        said = []
        for _ in range(config.batches):
            chosen = [self.episodes[k] for k in rng.integers(len(self.episodes), size=config.batch)]
            inputs, where = (nn.utils.rnn.pad_sequence([e[i] for e in chosen]) for i in (0, 2))
            action = nn.utils.rnn.pad_sequence([e[1] for e in chosen], padding_value=_PADDED)
            there = action != _PADDED
            logits, told, _ = self.policy(inputs)
            loss = nn.functional.cross_entropy(
                logits.flatten(0, 1), action.flatten(), ignore_index=_PADDED
            )
            off = nn.functional.mse_loss(told[there], where[there])
            self.optimizer.zero_grad()
            (loss + config.where * off).backward()
            nn.utils.clip_grad_norm_(self.policy.parameters(), 1.0)
            self.optimizer.step()
            right = (logits.argmax(dim=2) == action)[there].float().mean()
            said.append((float(loss.detach()), float(off.detach()), float(right)))
        loss_mean, where_mean, agreement = np.mean(said, axis=0)
        return {"loss": loss_mean, "where": where_mean, "agreement": agreement}

    def save(self, path: Path, done: int) -> None:
        buffer = io.BytesIO()
        state = {"weights": self.policy.state_dict(), "optimizer": self.optimizer.state_dict()}
        torch.save({**state, "done": done}, buffer)
        publish(path, buffer.getvalue())

    def load(self, path: Path) -> int:
        content = load(path, "record of training")
        self.policy.load_state_dict(content["weights"])
        self.optimizer.load_state_dict(content["optimizer"])
        return int(content["done"])


def _file(out: Path, shared: Path, k: int, config: DaggerConfig) -> Path:
    """Where the episodes of a round are."""
    return (shared if k < config.led else out) / f"round-{k}.npz"


def _read(path: Path) -> _Walked:
    with np.load(path) as kept:
        return _Walked(*(kept[name] for name in ("length", "inputs", "action", "where")))


def train_continuous(
    options: ContinuousOptions,
    out: Path,
    shared: Path,
    seed: int = 0,
    config: DaggerConfig | None = None,
    progress: Callable[[dict[str, Any]], None] | None = None,
) -> ContinuousPolicy:
    """Train in episodes that `options` draw, into the folder `out`, or go on there; the policy. `shared`: folder of
    the oracle's walks."""
    torch.set_num_threads(1)
    for folder in (out, shared):
        folder.mkdir(parents=True, exist_ok=True)
    config = config or DaggerConfig()
    learner, done = _Learner(config, seed), 0
    if (out / NAME).exists():
        done = learner.load(out / NAME)
    if done >= config.rounds:
        return learner.policy
    rows = [row for row in read_curve(out) if row["update"] <= done]
    publish(out / CURVE, "".join(json.dumps(row) + "\n" for row in rows).encode())
    setting = ContinuousSetting(options)
    for k in range(done):
        learner.add(_read(_file(out, shared, k, config)))
    for k in range(done, config.rounds):
        began, path = time.process_time(), _file(out, shared, k, config)
        said: dict[str, float] = {}
        if path.exists():
            walked = _read(path)
        else:
            policy = None if k < config.led else learner.policy
            own = 0 if k < config.led else 1 + seed
            walked, said = _walk(setting, policy, config.episodes, (own, k))
            buffer = io.BytesIO()
            np.savez(buffer, **vars(walked))
            publish(path, buffer.getvalue())
        walking = time.process_time() - began
        learner.add(walked)
        row = {"update": k + 1, "steps": len(walked.action), **said, **learner.learn(k)}
        row |= {"walking_s": walking, "learning_s": time.process_time() - began - walking}
        learner.save(out / NAME, k + 1)
        with (out / CURVE).open("a", encoding="utf-8") as curve:
            curve.write(json.dumps(row) + "\n")
        if progress is not None:
            progress(row)
    return learner.policy


def load_policy(folder: Path) -> ContinuousPolicy:
    """The policy of a run. Raises `ConfigError` if there is none."""
    if not (folder / NAME).exists():
        raise ConfigError(f"{folder}: no agent was trained here")
    learner = _Learner(DaggerConfig(), 0)
    learner.load(folder / NAME)
    return learner.policy
