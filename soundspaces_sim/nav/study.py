"""`make nav`: flats, datasets, views, what is heard, episodes, agents, results, a report. Every stage goes on
where it was stopped; what is finished is left alone.

    OUT/data/<flat>/            datasets, views.h5, heard_telephone.h5; splits.toml
    OUT/episodes/replica/v1/    train, val, test
    OUT/agents/<name>-<seed>/   agent.pt, curve.jsonl
    OUT/results/*.json          evaluations; OUT/replays, OUT/report.md
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.base.config import GridConfig, JobConfig, SimulationConfig
from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.nav.agents import BASELINES, load_agent
from soundspaces_sim.nav.data import NavData, nearest, write_splits
from soundspaces_sim.nav.env import AudioNavEnv
from soundspaces_sim.nav.episodes import Episode, read_episodes, split_file, write_episodes
from soundspaces_sim.nav.evaluate import Result, evaluate, load_result
from soundspaces_sim.nav.generate import make_episodes
from soundspaces_sim.nav.hearing import bake_sound
from soundspaces_sim.nav.presets import TrainConfig, preset
from soundspaces_sim.nav.sounds import SoundBank
from soundspaces_sim.nav.task import POINTGOAL, TaskName
from soundspaces_sim.nav.views import bake_views
from soundspaces_sim.storage.manifest import NAME as MANIFEST
from soundspaces_sim.storage.manifest import read_manifest

Say = Callable[[str], None]
GOALS = 20  # points per flat at which sounds stand
SIGMAS = (0.0, 0.5, 1.0, 1.5)  # m, of the GPS
SOUND = "telephone"


@dataclass(frozen=True)
class Arm:
    """One kind of agent that is trained and compared."""

    name: str
    task: TaskName
    sensors: tuple[str, ...]
    method: str = "ppo"
    noisy_gps: bool = False  # is also tested with noise in its GPS


ARMS = {
    arm.name: arm
    for arm in (
        Arm("AG", "AudioGoal", ("spectrogram", "depth", "collision")),
        Arm("APG", "AudioPointGoal", ("spectrogram", "depth", POINTGOAL, "collision"), noisy_gps=True),
        Arm("PG", "PointGoal", (POINTGOAL, "depth", "collision"), noisy_gps=True),
        Arm("AG-blind", "AudioGoal", ("spectrogram", "collision")),
        Arm("AG-intensity", "AudioGoal", ("intensity", "depth", "collision")),
        Arm("AG-dagger", "AudioGoal", ("spectrogram", "depth", "collision"), "dagger"),
    )
}


@dataclass(frozen=True)
class Study:
    """`flats`: per split; `walks` per point; episodes to train with and to test with; which `arms`."""

    preset: str
    flats: tuple[int, int, int]
    walks: int
    train_episodes: int
    test_episodes: int
    arms: tuple[str, ...]
    replays: int
    rate: int = 16000
    spacing: float = 1.0

    @property
    def splits(self) -> dict[str, tuple[str, ...]]:
        """Flats by split: training takes the first numbers."""
        names = [f"flat-{k}" for k in range(sum(self.flats))]
        a, b, _ = np.cumsum(self.flats)
        return {"train": tuple(names[:a]), "val": tuple(names[a:b]), "test": tuple(names[b:])}

    @property
    def job(self) -> JobConfig:
        """Settings of the datasets."""
        dataset = type(JobConfig().dataset)(rate=self.rate)
        return JobConfig(
            grid=GridConfig(spacing=self.spacing),
            simulation=SimulationConfig(walks=self.walks),
            dataset=dataset,
        )


STUDIES = {
    "quick": Study("quick", (5, 1, 2), 100, 2000, 100, ("AG-dagger",), 1),
    "small": Study("small", (24, 4, 8), 100, 20_000, 400, tuple(ARMS), 10),
    # The paper's numbers of Replica: 100,000 episodes to train with, 1,000 to test; its rate and grid.
    "paper": Study("paper", (24, 4, 8), 1000, 100_000, 1000, tuple(ARMS), 10, 44100, 0.5),
}


def study(name: str) -> Study:
    """A study by its preset's name. Raises `ConfigError`."""
    if name not in STUDIES:
        raise ConfigError(
            f"PRESET: expected one of {', '.join(STUDIES)}, got '{name}'{nearest(name, STUDIES)}"
        )
    return STUDIES[name]


def run_study(
    plan: Study, out: Path, seeds: int = 1, jobs: int | None = None, arms: Sequence[str] | None = None,
    updates: int | None = None, say: Say = print,
) -> Path:  # fmt: skip
    """All stages; returns the report. `jobs`: processes; `arms`: some of the plan's; `updates`: shorter runs."""
    jobs = max(1, min(jobs or os.cpu_count() or 1, os.cpu_count() or 1))
    chosen = [ARMS[a] for a in plan.arms if arms is None or a in arms]
    unknown = [a for a in arms or () if a not in ARMS]
    if unknown:
        raise ConfigError(
            f"agents: '{unknown[0]}' is not one of {', '.join(ARMS)}{nearest(unknown[0], ARMS)}"
        )
    if seeds < 1:
        raise ConfigError(f"SEEDS: expected at least 1, got {seeds}")
    build_flats(plan, out / "data", jobs, say)
    write_episode_splits(plan, out, say)
    bake_all(plan, out, jobs, say)
    runs = [(arm, seed) for seed in range(seeds) for arm in chosen]
    train_all(plan, out, runs, updates, jobs, say)
    evaluate_all(plan, out, runs, jobs, say)
    from soundspaces_sim.nav.report import write_replays, write_report

    write_replays(plan, out, chosen, say)
    return write_report(plan, out, say)


def build_flats(plan: Study, folder: Path, jobs: int, say: Say) -> None:
    """Datasets of all flats, and their splits."""
    from soundspaces_sim.jobs.build import build_dataset
    from soundspaces_sim.loaders import load_scene

    scenes = [scene for names in plan.splits.values() for scene in names]
    for k, scene in enumerate(scenes):
        if not (folder / scene / MANIFEST).exists() or not read_manifest(folder / scene).complete:
            say(f"dataset {k + 1} of {len(scenes)}: {scene}")
            build_dataset(
                load_scene(scene), folder, plan.job, jobs, command=f"soundspaces-sim rirs {scene}"
            )
    write_splits(folder, plan.splits)


def episodes_path(out: Path, split: str) -> Path:
    """The file of a split's episodes."""
    return split_file(out / "episodes" / "replica" / "v1" / split)


def write_episode_splits(plan: Study, out: Path, say: Say) -> None:
    """Episodes of the three splits, sounds standing at `GOALS` points per flat."""
    data = NavData(out / "data")
    for split, count in (
        ("train", plan.train_episodes), ("val", plan.test_episodes), ("test", plan.test_episodes),
    ):  # fmt: skip
        path = episodes_path(out, split)
        if not path.exists():
            say(f"episodes: {count:,} of split {split}")
            write_episodes(make_episodes(data, split, count, sounds=(SOUND,), goals=GOALS), path)


def bake_all(plan: Study, out: Path, jobs: int, say: Say) -> None:
    """Views and what is heard of every goal, flat by flat."""
    data = NavData(out / "data")
    goals: dict[str, set[int]] = {}
    for split in plan.splits:
        for episode in read_episodes(episodes_path(out, split), data):
            goals.setdefault(episode.scene, set()).add(episode.goal)
    tasks = [(out / "data" / scene, sorted(at)) for scene, at in goals.items()]
    for k, scene in enumerate(_each(_bake_one, tasks, jobs)):
        say(f"views and sounds {k + 1} of {len(tasks)}: {scene}")


def _bake_one(task: tuple[Path, list[int]]) -> str:
    from soundspaces_sim.reading.dataset import open_dataset

    folder, goals = task
    with open_dataset(folder) as ds:
        bake_views(ds)
        bake_sound(ds, SoundBank(ds.rate), SOUND, goals)
        return ds.scene


def agent_folder(out: Path, arm: Arm, seed: int) -> Path:
    """Where a run of training is kept."""
    return out / "agents" / f"{arm.name}-{seed}"


def train_all(
    plan: Study, out: Path, runs: Sequence[tuple[Arm, int]], updates: int | None, jobs: int, say: Say
) -> None:
    """Every run to its end, `jobs` at a time."""
    tasks = [(plan.preset, str(out), arm.name, seed, updates) for arm, seed in runs]
    for line in _each(_train_one, tasks, jobs):
        say(line)


def _train_one(task: tuple[str, str, str, int, int | None]) -> str:
    from soundspaces_sim.nav.learn.train import Run, read_curve, shortened, train

    name, out, arm_name, seed, updates = task
    arm, root = ARMS[arm_name], Path(out)
    config: TrainConfig = shortened(preset(name), updates)
    folder = agent_folder(root, arm, seed)
    label = f"{arm.name}, seed {seed}"

    def progress(row: dict[str, Any]) -> None:
        if row["update"] % 10 == 0 or row["update"] == row["updates"]:
            left = (row["updates"] - row["update"]) * row["seconds"] / max(row["update"], 1)
            rate = row["episodes"] / row["seconds"]
            speed = f"{row['steps']:>9,} steps, {row['steps_per_s']:5.0f}/s, {rate:5.1f} episodes/s"
            well = f"success {row['success']:.2f}, SPL {row['spl']:.2f}"
            print(f"{label}: {speed}, {well}, {left / 60:.0f} min left", flush=True)

    run = Run(arm.name, arm.task, arm.sensors, arm.method, SOUND)  # type: ignore[arg-type]
    train(run, config, root / "data", folder, seed, episodes_path(root, "train"), progress)
    last = read_curve(folder)[-1]
    return f"trained {label}: {last['steps']:,} steps in {last['seconds'] / 60:.1f} min, SPL {last['spl']:.2f}"


@dataclass(frozen=True)
class Test:
    """One evaluation: an arm's seed or a baseline, with noise in the GPS."""

    agent: str
    seed: int
    sigma: float = 0.0

    @property
    def name(self) -> str:
        return f"{self.agent}-{self.seed}" + (f"-gps{self.sigma:g}" if self.sigma else "")


def tests_of(runs: Iterable[tuple[Arm, int]]) -> list[Test]:
    """What is evaluated: baselines, and every run, some with noise."""
    out = [Test(name, 0) for name in BASELINES]
    for arm, seed in runs:
        out += [Test(arm.name, seed, sigma) for sigma in (SIGMAS if arm.noisy_gps else (0.0,))]
    return out


def result_path(out: Path, test: Test) -> Path:
    """Where a result is kept."""
    return out / "results" / f"{test.name}.json"


def evaluate_all(plan: Study, out: Path, runs: Sequence[tuple[Arm, int]], jobs: int, say: Say) -> None:
    """Every test on the test split, `jobs` at a time."""
    (out / "results").mkdir(parents=True, exist_ok=True)
    tasks = [
        (plan.preset, str(out), test) for test in tests_of(runs) if not result_path(out, test).exists()
    ]
    for line in _each(_evaluate_one, tasks, jobs):
        say(line)


def open_test(
    plan: Study, out: Path, agent: str, seed: int, sigma: float
) -> tuple[Any, AudioNavEnv, list[Episode]]:
    """An agent, the environment that it is tested in, and the episodes."""
    config, data = preset(plan.preset), NavData(out / "data")
    episodes = read_episodes(episodes_path(out, "test"), data)
    arm = ARMS.get(agent)
    sensors = arm.sensors if arm else ("intensity", "collision")
    env = AudioNavEnv(
        data, task=arm.task if arm else "AudioGoal", split="test", episodes=episodes, sensors=sensors,
        max_steps=config.max_steps, depth_size=config.depth_size, gps_sigma=sigma,
    )  # fmt: skip
    if arm is None:
        return BASELINES[agent](), env, episodes
    from soundspaces_sim.nav.learn.train import NAME

    return load_agent(agent_folder(out, arm, seed) / NAME), env, episodes


def _evaluate_one(task: tuple[str, str, Test]) -> str:
    name, out, test = task
    agent, env, episodes = open_test(STUDIES[name], Path(out), test.agent, test.seed, test.sigma)
    rows = evaluate(agent, env, episodes, test.seed).rows
    Result(test.agent, rows).save(result_path(Path(out), test))
    return (
        f"tested {test.name}: SPL {rows['spl'].mean():.3f}, success {rows['success'].mean():.3f} on "
        f"{len(rows)} episodes"
    )


def load_results(out: Path) -> dict[tuple[str, float], list[Result]]:
    """All results by agent and noise of the GPS, one per seed."""
    found: dict[tuple[str, float], list[Result]] = {}
    for path in sorted((out / "results").glob("*.json")):
        stem, _, sigma = path.stem.partition("-gps")
        result = load_result(path)
        assert stem.rpartition("-")[0] == result.agent
        found.setdefault((result.agent, float(sigma or 0.0)), []).append(result)
    return found


def _each(function: Callable[[Any], str], tasks: Sequence[Any], jobs: int) -> Iterable[str]:
    """Results of a function in order of tasks; in processes of their own where that pays."""
    if jobs == 1 or len(tasks) < 2:
        yield from map(function, tasks)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(function, tasks)
