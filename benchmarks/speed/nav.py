"""Steps per second of the environments and of training, beside sb3-contrib's RecurrentPPO on the same environment.

Question: How many steps per second do an agent's environments and its training take?

Method: On a study's data, views and sounds baked. One thread; rates are per second of processor time, so that
other work on the machine counts only by what it takes of caches and clock; the best of three. Training: the
best update's rate on features and while encoders learn, and the whole run that follows from these, warm start
included. sb3-contrib is compared where it is installed.

Amortised: The first views and the caches' first filling; the whole run holds them, the warm start and the first
encoding of all states.

Takes: 10 minutes. Arguments: the study's folder (out/nav, of `make nav PRESET=quick`), and a scene whose depth
is drawn (the first flat). Needs the extra ``train``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tools.record import Table, UnavailableError, table
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.depth import depth_views
from soundspaces_sim.nav.env import AudioNavEnv
from soundspaces_sim.nav.vector import AudioNavVectorEnv
from soundspaces_sim.scene.load import load_scene

MEASURES = ("core", "scene", "echogram", "rendering", "dataset", "nav")
_STEPS = 2000


def _best(run: Callable[[], int], times: int = 3) -> float:
    """Largest number of steps per second."""
    rates = []
    for _ in range(times):
        began = time.process_time()
        steps = run()
        rates.append(steps / (time.process_time() - began))
    return max(rates)


def _single(env: AudioNavEnv, steps: int) -> int:
    rng = np.random.default_rng(0)
    actions = rng.choice(4, steps, p=(0.01, 0.5, 0.25, 0.24))
    env.reset(seed=0)
    for action in actions:
        _, _, terminated, truncated, _ = env.step(int(action))
        if terminated or truncated:
            env.reset()
    return steps


def _many(env: AudioNavVectorEnv, steps: int) -> int:
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(steps):
        env.step(rng.choice(4, env.num_envs, p=(0.01, 0.5, 0.25, 0.24)))
    return steps * env.num_envs


def _training(data: Path, episodes: Path) -> list[tuple[str, str, float]]:
    """Rates of updates on features and of those in which encoders learn, the best of three each; and of a whole
    run, warm start and first encoding included, reckoned from these."""
    import tempfile

    from soundspaces_agents.learn.train import Run, train_agent
    from soundspaces_agents.presets import preset

    small = preset("small")
    config = replace(small, updates=8, finetune=4)
    with tempfile.TemporaryDirectory() as folder:
        run = Run("AG", "AudioGoal", ("spectrogram", "depth", "collision"))
        ends = [time.process_time()]
        train_agent(
            run, config, data, Path(folder), 0, episodes, lambda _: ends.append(time.process_time())
        )
    each, took = config.envs * config.steps, np.diff(ends)
    features, learning = float(took[1:4].min()), float(took[5:].min())
    whole = float(took[0]) + features * (small.updates - small.finetune - 1) + learning * small.finetune
    return [
        ("PPO on features, preset small, one core", "steps/s", each / features),
        ("the same while encoders learn", "steps/s", each / learning),
        (
            "a whole run of 1.5 million steps, warm start included",
            "steps/s",
            small.updates * each / whole,
        ),
    ]


def _sb3(data: NavData, settings: dict[str, Any], steps: int) -> float:
    from sb3_contrib import RecurrentPPO
    from stable_baselines3.common.vec_env import DummyVecEnv

    envs = DummyVecEnv([lambda: AudioNavEnv(data, **settings) for _ in range(64)])
    model = RecurrentPPO(
        "MultiInputLstmPolicy", envs, n_steps=64, batch_size=1024, n_epochs=3, device="cpu",
        policy_kwargs={"lstm_hidden_size": 128, "shared_lstm": True, "enable_critic_lstm": False},
    )  # fmt: skip
    began = time.process_time()
    model.learn(steps)
    return steps / (time.process_time() - began)


def run(folder: str = "out/nav", source: str | None = None) -> list[Table]:
    """Rates."""
    study = Path(folder)
    if not (study / "data").is_dir() or not find_spec("torch"):
        raise UnavailableError(
            f"{study} is no study with baked data, or the extra train is not installed"
        )
    import torch

    torch.set_num_threads(1)
    root, episodes = study / "data", study / "episodes" / "replica" / "v1" / "train"
    data = NavData(root)
    rows: list[tuple[str, str, float]] = []
    scene = load_scene(source or data.names[0])
    camera, headings = scene.center, np.arange(4) * 90.0

    def draw() -> int:
        depth_views(scene, camera, headings, 128)
        return 4

    draw()
    rows.append((f"depth 128 × 128, {len(scene.faces):,} triangles", "frames/s", _best(draw)))
    for size in (128, 32):
        settings: dict[str, Any] = {"episodes": episodes, "depth_size": size, "max_steps": 200}
        env = AudioNavEnv(data, **settings)
        _single(env, 4 * _STEPS)
        rows.append(
            (
                f"one environment, cached, depth {size}",
                "steps/s",
                _best(lambda e=env: _single(e, _STEPS)),
            )
        )
        many = AudioNavVectorEnv(64, data, **settings)
        _many(many, _STEPS // 4)
        rows.append(
            (
                f"64 in the vector, cached, depth {size}",
                "steps/s",
                _best(lambda e=many: _many(e, _STEPS // 8)),
            )
        )
    fresh = AudioNavEnv(data, episodes=episodes, cache="none", depth_size=32)
    rows.append(
        ("one environment, nothing cached, 16 kHz", "steps/s", _best(lambda: _single(fresh, 100)))
    )
    rows += _training(root, episodes)
    if find_spec("sb3_contrib"):
        small = {"episodes": episodes, "depth_size": 32, "max_steps": 200}
        rows.append(("sb3-contrib RecurrentPPO, 64 environments", "steps/s", _sb3(data, small, 64 * 64)))
    heads = ["", "rate", "unit"]
    return [table("Per second of the processor, one thread", heads, [(w, r, u) for w, u, r in rows])]
