"""What training asks for: random rooms, and steps of agents in continuous space.

Question: How many random rooms, and how many steps with sound, does a core make in a second?

Method: Processor seconds of one thread. Rooms of `RoomStream` with one talker and four microphones, responses
rendered at 16 kHz: until early and late energies have the error that is asked for, and with a number of subpaths;
medians of the errors that the labels state. Random steps of 250 ms in a generated home whose dataset has points
0.75 m apart, sounds anywhere, `audiogoal`, `intensity` and `pose`: resets, first steps and further ones, in
short episodes and in long ones, when they are new, and when they are repeated as those of a training's list are.

Amortised: Rooms: compiling alone. Steps: responses of pairs of points that 400 episodes before have met, which are
kept; in repeated episodes all that they have met.

Takes: Three minutes. Arguments: rooms (16), rounds of repeated episodes (3). Needs the neighbours rooms,
buildings and continuous.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools.record import Table, UnavailableError, table
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count

_NEIGHBOURS = "soundspaces_rooms", "soundspaces_buildings", "soundspaces_continuous"
_HOME, _SPACING, _RATE = "home-5", 0.75, 16000
_EPISODES = (8, 60), (60, 10)  # steps of an episode, episodes of a round
_MET = 400  # short episodes before, by which pairs of points are met


def _rooms(count: int) -> Table:
    import soundspaces_rooms as sr

    rows = []
    settings = {
        "target_error = 0.05": ss.SimulationConfig(target_error=0.05, max_walks=4096),
        "target_error = 0.1": ss.SimulationConfig(target_error=0.1, max_walks=4096),
        "walks = 100": ss.SimulationConfig(walks=100),
    }
    ends: dict[str, Any] = {"sources": (1, 1), "microphones": (4, 4)}
    for name, config in settings.items():
        list(sr.RoomStream(seed=1, count=1, config=config, **ends))
        start = time.process_time()
        items = list(sr.RoomStream(seed=3, count=count, config=config, **ends))
        seconds = time.process_time() - start
        t30 = np.concatenate([(item["t30_error"] / item["t30"]).ravel() for item in items])
        c50 = np.concatenate([item["c50_error"].ravel() for item in items])
        rows.append((name, count / seconds, float(np.nanmedian(t30)), float(np.nanmedian(c50))))
    heads = ("setting", "rooms per second", "median error of T30, relative", ("of C50", "dB"))
    return table("Random rooms of all kinds, one talker, four microphones", heads, rows)


def _episode(env: Any, steps: int, seed: int) -> np.ndarray:
    """Processor seconds of the reset, of the first step, and of the others."""
    turns = np.random.default_rng(seed).integers(1, 4, steps)
    at = [time.process_time()]
    env.reset(seed=seed)
    at.append(time.process_time())
    env.step(turns[0])
    at.append(time.process_time())
    for turn in turns[1:]:
        env.step(turn)
    return np.diff([*at, time.process_time()])


def _steps(rounds: int) -> Table:
    import gymnasium
    import soundspaces_continuous  # noqa: F401 - makes the environment known

    job = ss.JobConfig(
        grid=ss.GridConfig(spacing=_SPACING, standing=True),
        simulation=ss.SimulationConfig(walks=100),
        dataset=DatasetConfig(rate=_RATE),
    )
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        ss.build_dataset(ss.load_scene(_HOME), Path(folder), job, 1)
        env = gymnasium.make(
            "SoundSpaces/AudioGoalContinuous-v0", data=folder, sensors=["audiogoal", "intensity", "pose"]
        )
        for seed in range(_MET):
            _episode(env, _EPISODES[0][0], seed)
        for steps, episodes in _EPISODES:
            found = np.array(
                [[_episode(env, steps, _MET + k) for k in range(episodes)] for _ in range(1 + rounds)]
            )
            rate = episodes * steps / found.sum(axis=(1, 2))
            for name, of in (("new", slice(0, 1)), ("repeated", slice(1, None))):
                reset, first, rest = 1e3 * np.median(found[of], axis=(0, 1))
                each = reset, first, rest / (steps - 1)
                rows.append((steps, name, *each, *np.quantile(rate[of], (0.5, 0.0, 1.0))))
        env.close()
    heads = (
        "steps of an episode", "episodes", ("reset", "ms"), ("first step", "ms"), ("further steps", "ms"),
        "steps per second, resets included", "least", "most",
    )  # fmt: skip
    return table(f"Steps in continuous space, {_HOME}, points {_SPACING} m apart", heads, rows)


def run(rooms: str = "16", rounds: str = "3") -> list[Table]:
    """Rates."""
    if absent := [name for name in _NEIGHBOURS if find_spec(name) is None]:
        raise UnavailableError(f"{', '.join(absent)}: not installed")
    threads = thread_count()
    set_thread_count(1)
    try:
        return [_rooms(int(rooms)), _steps(int(rounds))]
    finally:
        set_thread_count(threads)
