"""Steps per second of agents in continuous space, beside what SAVN-CE publishes of its own.

Question: How many steps per second does an agent take that may be anywhere and hears sound go on?

Method: A random walk of five minutes, 1,200 steps of 250 ms at 16 kHz (60 % FORWARD .25 m, 20 % LEFT, 20 % RIGHT by
15 degrees, collisions with sliding), in one environment, on one thread; the best of three, per second of processor
time, so that other work on the machine counts only by what it takes of caches and clock. Its audio is the dataset's
order-2 field with up to four points' reverberation and all moved paths. A trained agent takes as many steps, from
episode to episode, in the setting of `soundspaces-sim nav continuous` (turns of 30 degrees, eight goals a scene);
then the environment walks its ways again without it. SAVN-CE's audio runs 500 rays a step with materials switched
off, on 128 threads, learning included (its README, "Tips": 200 and 120 frames per second).

Amortised: In the rows of warm caches, the spectra of the pairs met in an earlier walk; the row of cold caches makes
them in its first walk.

Takes: 3 minutes. Arguments: a folder of datasets at 16 kHz whose scenes are known by name (out, of `make rirs
SCENE=home-0 SPACING=1` with `dataset.rate = 16000`); the folder of a run of `nav continuous`, without which no
trained agent walks; it needs the extra ``train``.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tools.record import Table, UnavailableError, table
from soundspaces_sim.nav.continuous.env import ContinuousNavEnv
from soundspaces_sim.nav.continuous.episodes import Rules
from soundspaces_sim.nav.data import NavData

MEASURES = ("core", "scene", "echogram", "rendering", "dataset", "nav")
_STEPS, _THREADS = 1200, 128  # of a walk; of a server of SAVN-CE: dual Xeon Platinum 8378A
_RATE = 16_000  # Hz
_HEADS = ["observation", ("warm caches", "steps/s"), ("first walk", "steps/s")]
_PUBLISHED = (("SAVN-CE, clean", 200.0), ("SAVN-CE, with a distractor", 120.0))  # frames/s, its README


def _walk(env: ContinuousNavEnv) -> float:
    """Steps per second of a walk."""
    actions = 1 + np.random.default_rng(1).choice(3, _STEPS, p=(0.6, 0.2, 0.2))
    env.reset(seed=3)
    began = time.process_time()
    for action in actions:
        env.step(int(action))
    return _STEPS / (time.process_time() - began)


class _Replay:
    """Walks as an agent has walked."""

    def __init__(self, actions: Sequence[int]) -> None:
        self.actions, self.step = actions, 0

    def reset(self, *_: object, **__: object) -> None:
        """An episode more."""

    def act(self, _: object) -> int:
        """The next action."""
        self.step += 1
        return self.actions[(self.step - 1) % len(self.actions)]


def _agents_walk(env: ContinuousNavEnv, agent: Any) -> tuple[float, list[int]]:
    """Steps per second of a walk from episode to episode, and its actions; the same episodes in every walk."""
    actions: list[int] = []
    began, over = time.process_time(), True
    for k in range(_STEPS):
        if over:
            observation, _ = env.reset(seed=k)
            agent.reset(env.state, seed=k)
        actions.append(agent.act(observation))
        observation, _, terminated, truncated, _ = env.step(actions[-1])
        over = terminated or truncated
    return _STEPS / (time.process_time() - began), actions


def _trained(data: NavData, folder: Path) -> Table:
    """Steps per second of a trained agent with its network, and of the environment alone on the same walks."""
    import torch
    from soundspaces_agents.learn.continuous_dagger import load_policy
    from soundspaces_agents.learn.continuous_policy import SENSORS, ContinuousAgent

    torch.set_num_threads(1)
    rows = []
    for paths in ("moved", "simulated"):
        options: dict[str, Any] = {
            "max_steps": 160,
            "turn_deg": 30.0,
            "sensors": SENSORS,
            "paths": paths,
        }
        options["rules"] = Rules(min_distance=3.0, places=8)
        walker: Any = ContinuousAgent(load_policy(folder), "trained", data.dataset(data.names[0]).rate)
        for what in ("with the agent", "the environment alone"):
            env = ContinuousNavEnv(data, **options)
            walks = [_agents_walk(env, walker) for _ in range(4)]
            rows.append((f"{what}, paths {paths}", max(rate for rate, _ in walks[1:]), walks[0][0]))
            walker = _Replay(walks[0][1])
    return table("A trained agent, per second of the processor, one thread", _HEADS, rows)


def run(folder: str = "out", trained: str | None = None) -> list[Table]:
    """Rates."""
    if not Path(folder).is_dir():
        raise UnavailableError(f"{folder} is no folder of datasets")
    data = NavData(folder)
    rates_hz = {data.dataset(name).rate for name in data.names}
    if rates_hz != {_RATE}:
        raise UnavailableError(f"{folder} has datasets at {sorted(rates_hz)} Hz, expected {_RATE} Hz")
    cases: list[tuple[str, dict[str, Any]]] = [
        ("two ears", {"sensors": ("audiogoal",)}),
        ("two ears, paths simulated at the place", {"sensors": ("audiogoal",), "paths": "simulated"}),
        ("two ears, one distractor", {"sensors": ("audiogoal",), "rules": Rules(distractors=1)}),
        ("spectrogram", {"sensors": ("spectrogram",)}),
        ("interaural features (SAVN-CE's), pose", {"sensors": ("interaural", "pose")}),
        ("no sound: moves, collisions, measures", {"sensors": ("pose",)}),
        ("two ears, depth 128 × 128", {"sensors": ("audiogoal", "depth")}),
    ]
    rows: list[tuple[object, ...]] = []
    for name, options in cases:
        env = ContinuousNavEnv(data, max_steps=10**6, **options)
        rates = [_walk(env) for _ in range(4)]
        rows.append((name, max(rates[1:]), rates[0]))
    ours = table("Per second of the processor, one thread", _HEADS, rows)
    published = table(
        "Published by SAVN-CE: a server of 128 threads and four A800, learning included",
        ["task", ("server", "frames/s"), ("a thread", "frames/s")],
        [(name, rate, rate / _THREADS) for name, rate in _PUBLISHED],
        "README of github.com/yichenzeng24/SAVN-CE, Tips 2: 240 million steps in 14 and 23 days.",
    )
    agents = [] if trained is None else [_trained(data, Path(trained))]
    return [ours, *agents, published]
