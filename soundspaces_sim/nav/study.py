"""`make nav`: flats, datasets, views, what is heard, episodes, agents, results, a report. Every stage goes on
where it was stopped; what is finished is left alone.

    OUT/data/<flat>/                        datasets, views.h5, heard_<sound>.h5; splits.toml
    OUT/episodes/replica/v1/<set>/          train, val, test; train_varied, test_heard, test_unheard
    OUT/agents/<name>-<seed>/               agent.pt, curve.jsonl
    OUT/results/<name>/<condition>/<seed>.json
    OUT/replays, OUT/study.json, OUT/report.md
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from soundspaces_sim.base.config import GridConfig, JobConfig, SimulationConfig
from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.base.files import publish
from soundspaces_sim.files.door import read_json
from soundspaces_sim.nav.agents import BASELINES, load_agent
from soundspaces_sim.nav.data import NavData, nearest, write_splits
from soundspaces_sim.nav.env import AudioNavEnv
from soundspaces_sim.nav.episodes import Episode, read_episodes, split_file, write_episodes
from soundspaces_sim.nav.evaluate import Result, evaluate, load_result
from soundspaces_sim.nav.experiments import (
    ARMS,
    CONDITIONS,
    HEARD,
    LEARNT_IN,
    LEARNT_IN_MANY,
    UNHEARD,
    Arm,
    Condition,
    Test,
    choose_arms,
    tests_of,
)  # fmt: skip
from soundspaces_sim.nav.generate import make_episodes
from soundspaces_sim.nav.hearing import bake_sound
from soundspaces_sim.nav.presets import TrainConfig, preset
from soundspaces_sim.nav.sounds import DEFAULT, SoundBank
from soundspaces_sim.nav.views import bake_views
from soundspaces_sim.storage.manifest import NAME as MANIFEST
from soundspaces_sim.storage.manifest import read_manifest

Say = Callable[[str], None]
GOALS = 20  # points per flat at which sounds stand
SOUNDS_AT_A_GOAL = 3  # of the many; every one of them at every goal would be 54 GB
_NAME = "study.json"


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
        dataset = replace(JobConfig().dataset, rate=self.rate)
        grid, simulation = GridConfig(spacing=self.spacing), SimulationConfig(walks=self.walks)
        return JobConfig(grid=grid, simulation=simulation, dataset=dataset)


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


@dataclass(frozen=True)
class Order:
    """What was asked for: `arms` in order, `seeds` of each, `updates` of training (None: the preset's)."""

    preset: str
    arms: tuple[str, ...]
    seeds: int = 1
    updates: int | None = None

    @property
    def runs(self) -> list[tuple[Arm, int]]:
        """Every arm's first seed before any second."""
        return [(ARMS[name], seed) for seed in range(self.seeds) for name in self.arms]

    @property
    def command(self) -> str:
        """What repeats it."""
        updates = f" --updates {self.updates}" if self.updates is not None else ""
        run = f"soundspaces-sim nav run --preset {self.preset} --seeds {self.seeds}"
        return f"{run} --agents {','.join(self.arms)}{updates}"


def read_order(out: Path) -> Order:
    """What was last asked for in a folder. Raises `ConfigError`."""
    try:
        return msgspec.convert(read_json(out / _NAME, ConfigError, "record of a study"), Order)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{out / _NAME}: not a record of a study ({error})") from error


def run_study(
    name: str, out: Path, seeds: int = 1, jobs: int | None = None, arms: Sequence[str] | None = None,
    updates: int | None = None, say: Say = print,
) -> Path:  # fmt: skip
    """All stages; returns the report. `jobs`: processes; `arms`: some of the study's; `updates`: shorter runs."""
    plan = study(name)
    jobs = max(1, min(jobs or os.cpu_count() or 1, os.cpu_count() or 1))
    if seeds < 1:
        raise ConfigError(f"SEEDS: expected at least 1, got {seeds}")
    chosen = choose_arms(plan.arms if arms is None else arms)
    order = Order(name, tuple(arm.name for arm in chosen), seeds, updates)
    build_flats(plan, out / "data", jobs, say)
    publish(out / _NAME, msgspec.json.encode(asdict(order)))
    varied = any(arm.varied for arm in chosen)
    write_episode_sets(plan, out, varied, say)
    bake_all(out, varied, jobs, say)
    train_all(order, out, jobs, say)
    evaluate_all(order, out, jobs, say)
    from soundspaces_sim.nav.report import write_replays, write_report

    write_replays(plan, out, chosen, say)
    return write_report(out, say)


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


def episodes_path(out: Path, name: str) -> Path:
    """The file of a set of episodes."""
    return split_file(out / "episodes" / "replica" / "v1" / name)


def write_episode_sets(plan: Study, out: Path, varied: bool, say: Say) -> None:
    """Episodes of the three splits, sounds standing at `GOALS` points per flat; `varied`: those of training and
    testing once more with other sounds, so that what changes is the sound alone."""
    data = NavData(out / "data")
    for split, count in (
        ("train", plan.train_episodes), ("val", plan.test_episodes), ("test", plan.test_episodes),
    ):  # fmt: skip
        path = episodes_path(out, split)
        if not path.exists():
            say(f"episodes: {count:,} of split {split}")
            write_episodes(make_episodes(data, split, count, sounds=(DEFAULT,), goals=GOALS), path)
    bank = SoundBank(plan.rate)
    for name, split, of in (
        (LEARNT_IN_MANY, LEARNT_IN, "train"), (HEARD.episodes, "test", "train"), (UNHEARD.episodes, "test", "test"),
    ):  # fmt: skip
        path = episodes_path(out, name)
        if varied and not path.exists():
            say(f"episodes: {name}, those of {split} with {len(bank.names(of))} sounds")
            write_episodes(
                with_sounds(read_episodes(episodes_path(out, split), data), bank.names(of)), path
            )


def with_sounds(episodes: Sequence[Episode], names: Sequence[str], seed: int = 0) -> list[Episode]:
    """The same episodes with other sounds: `SOUNDS_AT_A_GOAL` of `names` at every goal, one per episode, by lot."""
    places = sorted({(e.scene, e.goal) for e in episodes})
    rng = np.random.default_rng((seed, len(names)))
    at = {place: rng.choice(len(names), SOUNDS_AT_A_GOAL, replace=False) for place in places}
    return [replace(e, sound=names[int(rng.choice(at[e.scene, e.goal]))]) for e in episodes]


def bake_all(out: Path, varied: bool, jobs: int, say: Say) -> None:
    """Views, and what is heard of every goal that agents are sent to, flat by flat."""
    data = NavData(out / "data")
    goals: dict[str, dict[str, set[int]]] = {}
    many = (LEARNT_IN_MANY, HEARD.episodes, UNHEARD.episodes) if varied else ()
    for name in (LEARNT_IN, "test", *many):
        for e in read_episodes(episodes_path(out, name), data):
            goals.setdefault(e.scene, {}).setdefault(e.sound, set()).add(e.goal)
    tasks = [(out / "data" / scene, sounds) for scene, sounds in goals.items()]
    for k, scene in enumerate(_each(_bake_one, tasks, jobs)):
        say(f"views and sounds {k + 1} of {len(tasks)}: {scene}")


def _bake_one(task: tuple[Path, dict[str, set[int]]]) -> str:
    from soundspaces_sim.reading.dataset import open_dataset

    folder, sounds = task
    with open_dataset(folder) as ds:
        bake_views(ds)
        bank = SoundBank(ds.rate)
        for sound, goals in sounds.items():
            bake_sound(ds, bank, sound, sorted(goals))
        return ds.scene


def agent_folder(out: Path, arm: Arm, seed: int) -> Path:
    """Where a run of training is kept."""
    return out / "agents" / f"{arm.name}-{seed}"


def train_all(order: Order, out: Path, jobs: int, say: Say) -> None:
    """Every run to its end, `jobs` at a time."""
    tasks = [(order.preset, str(out), arm.name, seed, order.updates) for arm, seed in order.runs]
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

    run = Run(arm.name, arm.task, arm.sensors, arm.method, ears=arm.ears)  # type: ignore[arg-type]
    train(run, config, root / "data", folder, seed, episodes_path(root, arm.episodes), progress)
    last = read_curve(folder)[-1]
    return f"trained {label}: {last['steps']:,} steps in {last['seconds'] / 60:.1f} min, SPL {last['spl']:.2f}"


def result_path(out: Path, test: Test) -> Path:
    """Where a result is kept."""
    return out / "results" / test.agent / test.condition.name / f"{test.seed}.json"


def evaluate_all(order: Order, out: Path, jobs: int, say: Say) -> None:
    """Every test that has no result yet, `jobs` at a time."""
    tests = [test for test in tests_of(order.runs) if not result_path(out, test).exists()]
    for line in _each(_evaluate_one, [(order.preset, str(out), test) for test in tests], jobs):
        say(line)


def open_test(name: str, out: Path, test: Test) -> tuple[Any, AudioNavEnv, list[Episode]]:
    """An agent, the environment that it is tested in, and the episodes. `name`: of the preset."""
    config, data, arm = preset(name), NavData(out / "data"), ARMS.get(test.agent)
    episodes = read_episodes(episodes_path(out, test.condition.episodes), data)
    env = AudioNavEnv(
        data, task=arm.task if arm else "AudioGoal", split="test", episodes=episodes,
        sensors=arm.sensors if arm else ("intensity", "collision"), max_steps=config.max_steps,
        depth_size=config.depth_size, gps_sigma=test.condition.sigma, ears=arm.ears if arm else "binaural",
    )  # fmt: skip
    if arm is None:
        return BASELINES[test.agent](), env, episodes
    from soundspaces_sim.nav.learn.train import NAME

    return load_agent(agent_folder(out, arm, test.seed) / NAME), env, episodes


def _evaluate_one(task: tuple[str, str, Test]) -> str:
    name, out, test = task
    if test.agent in ARMS:
        from soundspaces_sim.nav.learn.train import one_thread

        one_thread()
    agent, env, episodes = open_test(name, Path(out), test)
    rows = evaluate(agent, env, episodes, test.seed).rows
    path = result_path(Path(out), test)
    path.parent.mkdir(parents=True, exist_ok=True)
    Result(test.agent, rows).save(path)
    return (
        f"tested {test.agent}, seed {test.seed}, {test.condition.name}: SPL {rows['spl'].mean():.3f}, success "
        f"{rows['success'].mean():.3f} on {len(rows)} episodes"
    )


def load_results(out: Path) -> dict[tuple[str, Condition], list[Result]]:
    """All results by agent and condition, one per seed."""
    found: dict[tuple[str, Condition], list[Result]] = {}
    for path in sorted((out / "results").glob("*/*/*.json")):
        agent, condition = path.parts[-3:-1]
        if condition in CONDITIONS:
            found.setdefault((agent, CONDITIONS[condition]), []).append(load_result(path))
    return found


def _each(function: Callable[[Any], str], tasks: Sequence[Any], jobs: int) -> Iterable[str]:
    """Results of a function in order of tasks; in processes of their own where that pays."""
    if jobs == 1 or len(tasks) < 2:
        yield from map(function, tasks)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(function, tasks)
