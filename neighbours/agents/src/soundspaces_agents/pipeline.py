"""`make nav`: homes, datasets, views, what is heard, episodes, agents, results, a report. Every stage goes on
where it was stopped; what is finished is left alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_agents import learn, pictures
from soundspaces_agents.experiments import (
    ACOUSTICS,
    HEARD,
    LEARNT_IN,
    LEARNT_IN_MANY,
    UNHEARD,
    VARIANTS,
    Trial,
    choose_variants,
    heard_in,
    trials_of,
)
from soundspaces_agents.homes import choose_homes, largest_piece
from soundspaces_agents.learn.run_files import read_curve
from soundspaces_agents.presets import TrainConfig, preset
from soundspaces_agents.study import (
    CHOICE,
    Log,
    RunSpec,
    Study,
    agent_folder,
    data_folder,
    episodes_path,
    open_data,
    open_test,
    record_spec,
    result_path,
    study,
)
from soundspaces_sim import (
    ConfigError,
    JobConfig,
    SoundSpacesSimError,
    build_dataset,
    load_scene,
    open_dataset,
)
from soundspaces_sim.nav import (
    Episode,
    NavData,
    Result,
    SoundBank,
    bake_sound,
    bake_views,
    evaluate,
    make_episodes,
    read_episodes,
    write_episodes,
)
from soundspaces_sim.parts import (
    DEFAULT_SOUND as DEFAULT,
    MANIFEST_NAME as MANIFEST,
    SPLITS,
    EpisodeMaker,
    EpisodeRules as Rules,
    core_count,
    read_manifest,
    worker_pool,
    write_splits,
)

GOALS = 20  # points per home at which sounds stand
_Task = tuple[Path, str | None, dict[str, set[int]]]  # to bake: a dataset, its renderer, goals by sound


def run_study(
    name: str,
    out: Path,
    seeds: int = 1,
    jobs: int | None = None,
    variants: Sequence[str] | None = None,
    updates: int | None = None,
    log: Log = print,
    homes: tuple[int, int, int] | None = None,
) -> Path:
    """All stages; returns the report. `jobs`: processes; `variants`: some of the study's; `updates`: shorter
    runs; `homes`: fewer or more, to train with, to validate and to test with."""
    jobs = max(1, min(jobs or core_count(), core_count()))
    if seeds < 1:
        raise ConfigError(f"SEEDS: expected at least 1, got {seeds}")
    if homes is not None and (len(homes) != 3 or min(homes) < 1):
        raise ConfigError(f"homes: expected three numbers of at least 1 (train, val, test), got {homes}")
    chosen = choose_variants(study(name).variants if variants is None else variants)
    spec = RunSpec(name, tuple(variant.name for variant in chosen), seeds, updates, homes)
    plan = spec.plan
    record_spec(spec, out)
    build_homes(plan, out / "data", jobs, log)
    build_others(spec, out, jobs, log)
    bake_goals(out, jobs, log)
    write_episode_sets(plan, out, any(variant.varied for variant in chosen), log)
    bake_all(spec, out, jobs, log)
    train_all(spec, out, jobs, log)
    evaluate_all(spec, out, jobs, log)
    pictures.write_replays(plan, out, chosen, log)
    return pictures.write_report(out, log)


def build_homes(
    plan: Study, folder: Path, jobs: int, log: Log, names: Sequence[str] | None = None
) -> None:
    """Datasets of all homes, or of splits by `names`, and what splits there are. Which homes, is kept beside
    `folder`."""
    chosen = choose_homes(sum(plan.homes), plan.job.grid, folder.parent / CHOICE)
    splits = {name: of for name, of in plan.parted(chosen).items() if names is None or name in names}
    scenes = [scene for of in splits.values() for scene in of]
    for k, scene in enumerate(scenes):
        if not (folder / scene / MANIFEST).exists() or not read_manifest(folder / scene).complete:
            log(
                f"dataset {k + 1} of {len(scenes)}: {scene}{'' if names is None else f', {folder.name}'}"
            )
            build_home(scene, folder, plan.job, jobs)
    write_splits(folder, splits)


def build_home(name: str, folder: Path, config: JobConfig, jobs: int | None) -> Path:
    """The dataset of a home's largest piece; its folder."""
    scene = load_scene(name)
    points = largest_piece(scene, config.grid)
    command = f"soundspaces-agents homes {name}"
    return build_dataset(scene, folder, config, jobs, points=points, command=command).folder


def build_others(spec: RunSpec, out: Path, jobs: int, log: Log) -> None:
    """Datasets with other numbers of walks, of the splits in which they are heard."""
    needed: dict[Path, tuple[Study, set[str]]] = {}
    for name, sets in heard_in(spec.runs).items():
        acoustics = ACOUSTICS[name]
        folder = data_folder(spec.plan, out, acoustics)
        if folder != out / "data":
            plan = replace(spec.plan, walks=acoustics.walks)  # type: ignore[arg-type]
            needed.setdefault(folder, (plan, set()))[1].update(map(split_of, sets))
    for folder, (plan, splits) in needed.items():
        before = set(NavData(folder).splits) if (folder / SPLITS).exists() else set()
        build_homes(plan, folder, jobs, log, sorted(splits | before))


def bake_goals(out: Path, jobs: int, log: Log) -> None:
    """What is heard of `DEFAULT` wherever episodes of training and testing may have it. Which episodes are loud
    enough is then read, not rendered for that alone."""
    data = NavData(out / "data")
    tasks: list[_Task] = []
    for split in ("train", "test"):
        if not episodes_path(out, split).exists():
            maker = EpisodeMaker(
                data,
                split,
                SoundBank(data.dataset(data.scenes(split)[0]).rate),
                (DEFAULT,),
                Rules(goals=GOALS),
            )
            tasks += [
                (data.root / scene, None, {DEFAULT: set(maker.goals(scene).tolist())})
                for scene in maker.scenes
            ]
    data.close()
    _bake(tasks, jobs, log)


def split_of(episodes: str) -> str:
    """The split in whose homes a set of episodes is."""
    return episodes.partition("_")[0]


def write_episode_sets(plan: Study, out: Path, varied: bool, log: Log) -> None:
    """Episodes of the three splits, sounds standing at `GOALS` points per home; `varied`: those of training and
    testing once more with other sounds, so that what changes is the sound alone."""
    data = NavData(out / "data")
    for split, count in (
        ("train", plan.train_episodes),
        ("val", plan.test_episodes),
        ("test", plan.test_episodes),
    ):
        path = episodes_path(out, split)
        if not path.exists():
            log(f"episodes: {count:,} of split {split}")
            write_episodes(make_episodes(data, split, count, sounds=(DEFAULT,), goals=GOALS), path)
    bank = SoundBank(plan.rate)
    for name, split, of, each in (
        (LEARNT_IN_MANY, LEARNT_IN, "train", plan.sounds_at_a_goal),
        (HEARD.episodes, "test", "train", 1),
        (UNHEARD.episodes, "test", "test", 1),
    ):
        path = episodes_path(out, name)
        if varied and not path.exists():
            log(f"episodes: {name}, those of {split} with {len(bank.names(of))} sounds")
            write_episodes(
                with_sounds(read_episodes(episodes_path(out, split), data), bank.names(of), each), path
            )


def with_sounds(
    episodes: Sequence[Episode], names: Sequence[str], each: int, seed: int = 0
) -> list[Episode]:
    """The same episodes with other sounds: `each` of `names` at every goal, one of them per episode, at
    random."""
    places = sorted({(e.scene, e.goal) for e in episodes})
    rng = np.random.default_rng((seed, len(names)))
    at = {place: rng.choice(len(names), each, replace=False) for place in places}
    return [replace(e, sound=names[int(rng.choice(at[e.scene, e.goal]))]) for e in episodes]


def bake_all(spec: RunSpec, out: Path, jobs: int, log: Log) -> None:
    """Views, and what is heard of every goal that agents are sent to, home by home, in all acoustics."""
    tasks: list[_Task] = []
    for name, sets in heard_in(spec.runs).items():
        data = open_data(spec.plan, out, name)
        goals: dict[str, dict[str, set[int]]] = {}
        for of in sorted(sets):
            for e in read_episodes(episodes_path(out, of), data):
                goals.setdefault(e.scene, {}).setdefault(e.sound, set()).add(e.goal)
        tasks += [(data.root / scene, data.renderer, sounds) for scene, sounds in goals.items()]
        data.close()
    _bake(tasks, jobs, log)


def _bake(tasks: Sequence[_Task], jobs: int, log: Log) -> None:
    for k, scene in enumerate(_each(_bake_one, tasks, jobs)):
        log(f"views and sounds {k + 1} of {len(tasks)}: {scene}")


def _bake_one(task: _Task) -> str:
    folder, renderer, sounds = task
    with open_dataset(folder, renderer=renderer) as ds:
        bake_views(ds, scene=load_scene(ds.scene))
        bank = SoundBank(ds.rate)
        for sound, goals in sounds.items():
            bake_sound(ds, bank, sound, sorted(goals))
        return ds.scene


def train_all(spec: RunSpec, out: Path, jobs: int, log: Log) -> None:
    """Every run to its end, `jobs` at a time."""
    tasks = [(spec, str(out), variant.name, seed) for variant, seed in spec.runs]
    for line in _each(_train_one, tasks, jobs):
        log(line)


def _train_one(task: tuple[RunSpec, str, str, int]) -> str:
    spec, out, variant_name, seed = task
    variant, root = VARIANTS[variant_name], Path(out)
    config: TrainConfig = learn.shortened(preset(spec.preset), spec.updates)
    folder = agent_folder(root, variant, seed)
    label = f"{variant.name}, seed {seed}"

    def progress(row: dict[str, Any]) -> None:
        if row["update"] % 10 == 0 or row["update"] == row["updates"]:
            left = (row["updates"] - row["update"]) * row["seconds"] / max(row["update"], 1)
            rate = row["episodes"] / row["seconds"]
            speed = f"{row['steps']:>9,} steps, {row['steps_per_s']:5.0f}/s, {rate:5.1f} episodes/s"
            well = f"success {row['success']:.2f}, SPL {row['spl']:.2f}"
            print(f"{label}: {speed}, {well}, {left / 60:.0f} min left", flush=True)

    run = learn.Run(variant.name, variant.task, variant.sensors, variant.method, ears=variant.ears)  # type: ignore[arg-type]
    data = open_data(spec.plan, root, variant.acoustics)
    learn.train_agent(run, config, data, folder, seed, episodes_path(root, variant.episodes), progress)
    last = read_curve(folder)[-1]
    return f"trained {label}: {last['steps']:,} steps in {last['seconds'] / 60:.1f} min, SPL {last['spl']:.2f}"


def evaluate_all(spec: RunSpec, out: Path, jobs: int, log: Log) -> None:
    """Every test that has no result yet, `jobs` at a time."""
    trials = [trial for trial in trials_of(spec.runs) if not result_path(out, trial).exists()]
    for line in _each(_evaluate_one, [(spec.plan, str(out), trial) for trial in trials], jobs):
        log(line)


def _evaluate_one(task: tuple[Study, str, Trial]) -> str:
    plan, out, trial = task
    if trial.agent in VARIANTS:
        learn.one_thread()
    agent, env, episodes = open_test(plan, Path(out), trial)
    rows = evaluate(agent, env, episodes, trial.seed).rows
    path = result_path(Path(out), trial)
    path.parent.mkdir(parents=True, exist_ok=True)
    Result(trial.agent, rows).save(path)
    return (
        f"tested {trial.agent}, seed {trial.seed}, {trial.condition.name}: SPL {rows['spl'].mean():.3f}, success "
        f"{rows['success'].mean():.3f} on {len(rows)} episodes"
    )


def _each(function: Callable[[Any], str], tasks: Sequence[Any], jobs: int) -> Iterable[str]:
    """Results of a function in order of tasks; in processes of their own where that pays."""
    if jobs == 1 or len(tasks) < 2:
        yield from map(function, tasks)
        return
    try:  # where Ctrl-C, or what a process raised, ends the stage, the pool ends too: what it has kept is whole
        with worker_pool(jobs) as pool:
            yield from pool.map(function, tasks)
    except BrokenProcessPool as error:
        raise SoundSpacesSimError(
            "a process was killed (out of memory?); what is finished is safe: run it again, with JOBS=1"
        ) from error
