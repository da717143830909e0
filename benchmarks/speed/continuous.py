"""Steps per second of agents in continuous space, beside what SAVN-CE publishes of its own.

Question: How many steps per second does an agent take that may be anywhere and hears sound go on?

Method: A random walk of five minutes, 1,200 steps of 250 ms at 16 kHz (60 % FORWARD .25 m, 20 % LEFT, 20 % RIGHT by
15 degrees, collisions with sliding), in one environment, on one thread; the best of three, per second of processor
time, so that other work on the machine counts only by what it takes of caches and clock. Its audio is the dataset's
order-2 field with up to four points' reverberation and all moved paths. A trained agent takes as many steps, from
episode to episode, in the setting of `soundspaces-sim nav continuous` (turns of 30 degrees, eight goals in a
scene). SAVN-CE's audio runs 500 rays a step with materials switched off, on 128 threads, learning included (its
README, "Tips": 200 and 120 frames per second).

Amortised: In the rows of warm caches, the spectra of the pairs met in an earlier walk; the row of cold caches makes
them in its first walk.

Takes: 3 minutes. Arguments: a folder of datasets at 16 kHz whose scenes are known by name (out, of `make rirs
SCENE=flat-0 SPACING=1` with `dataset.rate = 16000`); the folder of a run of `nav continuous`, without which no
trained agent walks; it needs the extra ``train``.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tools.record import Table, UnavailableError, table
from soundspaces_sim.nav.continuous.env import ContinuousNavEnv
from soundspaces_sim.nav.continuous.episodes import Rules
from soundspaces_sim.nav.data import NavData

MEASURES = ("core", "scene", "echogram", "rendering", "dataset", "nav")
_STEPS, _THREADS = 1200, 128  # of a walk; of a server of SAVN-CE: dual Xeon Platinum 8378A
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


def _trained(data: NavData, folder: Path) -> Table:
    """Steps per second of a trained agent's walks, of the environment alone and with the agent's network."""
    import torch

    from soundspaces_sim.nav.learn.continuous_dagger import load_policy
    from soundspaces_sim.nav.learn.continuous_policy import SENSORS, ContinuousAgent

    torch.set_num_threads(1)
    rules = Rules(min_distance=3.0, places=8)
    rates = []
    for paths in ("moved", "simulated"):
        env = ContinuousNavEnv(
            data, max_steps=160, turn_deg=30.0, sensors=SENSORS, rules=rules, paths=paths
        )
        agent = ContinuousAgent(load_policy(folder), "trained", env.setting.bank.rate)
        rates.append([_agents_walk(env, agent) for _ in range(4)])
    rows = [
        (f"{what}, paths {paths}", max(walk[k] for walk in walks[1:]), walks[0][k])
        for paths, walks in zip(("moved", "simulated"), rates, strict=True)
        for k, what in enumerate(("the environment", "with the agent"))
    ]
    return table("A trained agent, per second of the processor, one thread", _HEADS, rows)


def _agents_walk(env: ContinuousNavEnv, agent: Any) -> tuple[float, float]:
    """Steps per second of the environment and of both together; the same episodes in every walk."""
    began, thinking, over = time.process_time(), 0.0, True
    for k in range(_STEPS):
        if over:
            observation, _ = env.reset(seed=k)
            agent.reset(env.state, seed=k)
        before = time.process_time()
        action = agent.act(observation)
        thinking += time.process_time() - before
        observation, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
    whole = time.process_time() - began
    return _STEPS / (whole - thinking), _STEPS / whole


def run(folder: str = "out", trained: str | None = None) -> list[Table]:
    """Rates."""
    if not Path(folder).is_dir():
        raise UnavailableError(f"{folder} is no folder of datasets")
    data = NavData(folder)
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
