"""Steps per second of agents in continuous space, beside what SAVN-CE publishes of its own.

Question: How many steps per second does an agent take that may be anywhere and hears sound go on?

Method: A random walk of five minutes, 1,200 steps of 250 ms at 16 kHz (60 % FORWARD .25 m, 20 % LEFT, 20 % RIGHT by
15 degrees, collisions with sliding), in one environment, on one thread; the best of three, per second of processor
time, so that other work on the machine counts only by what it takes of caches and clock. Its audio is the dataset's
order-2 field with up to four points' reverberation and all discrete paths, simulated at the place where nothing
else is said; SAVN-CE's runs 500 rays a step with materials switched off, on 128 threads, learning included (its
README, "Tips": 200 and 120 frames per second).

Amortised: In the rows of warm caches, the spectra of the pairs met in an earlier walk and what is kept of the
source; the row of cold caches makes them in its first walk.

Takes: 3 minutes. Arguments: a folder of datasets at 16 kHz whose scenes are known by name (out, of `make rirs
SCENE=apartment-0 SPACING=1` with `dataset.rate = 16000`).
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
_PUBLISHED = (("SAVN-CE, clean", 200.0), ("SAVN-CE, with a distractor", 120.0))  # frames/s, its README


def _walk(env: ContinuousNavEnv) -> float:
    """Steps per second of a walk."""
    actions = 1 + np.random.default_rng(1).choice(3, _STEPS, p=(0.6, 0.2, 0.2))
    env.reset(seed=3)
    began = time.process_time()
    for action in actions:
        env.step(int(action))
    return _STEPS / (time.process_time() - began)


def run(folder: str = "out") -> list[Table]:
    """Rates."""
    if not Path(folder).is_dir():
        raise UnavailableError(f"{folder} is no folder of datasets")
    data = NavData(folder)
    cases: list[tuple[str, dict[str, Any]]] = [
        ("two ears", {"sensors": ("audiogoal",)}),
        ("two ears, paths moved from the points around", {"sensors": ("audiogoal",), "paths": "moved"}),
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
    heads = ["observation", ("warm caches", "steps/s"), ("first walk", "steps/s")]
    ours = table("Per second of the processor, one thread", heads, rows)
    published = table(
        "Published by SAVN-CE: a server of 128 threads and four A800, learning included",
        ["task", ("server", "frames/s"), ("a thread", "frames/s")],
        [(name, rate, rate / _THREADS) for name, rate in _PUBLISHED],
        "README of github.com/yichenzeng24/SAVN-CE, Tips 2: 240 million steps in 14 and 23 days.",
    )
    return [ours, published]
