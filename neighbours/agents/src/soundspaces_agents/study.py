"""Parts of a study and their paths; `pipeline` makes them.

OUT/homes.json                          which homes were looked at, which taken
OUT/data/<home>/                        datasets, views.h5, heard_<sound>.h5; splits.toml
OUT/data-walks-<n>/<home>/              the same with other numbers of walks, of splits that need them
OUT/episodes/replica/v1/<set>/          train, val, test; train_varied, test_heard, test_unheard
OUT/agents/<name>-<seed>/               agent.pt, curve.jsonl
OUT/results/<name>/<condition>/<seed>.json
OUT/replays, OUT/study.json, OUT/record.json.gz, OUT/report.md
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from soundspaces_agents.experiments import (
    ACOUSTICS,
    CONDITIONS,
    PPO_VARIANTS,
    VARIANTS,
    Acoustics,
    Condition,
    Trial,
    Variant,
    without_twins,
)
from soundspaces_agents.learn import run_files
from soundspaces_agents.presets import preset
from soundspaces_agents.trained import load_agent
from soundspaces_sim import (
    ConfigError,
    GridConfig,
    JobConfig,
    SimulationConfig,
)
from soundspaces_sim.nav import (
    AudioNavEnv,
    Episode,
    NavData,
    Result,
    read_episodes,
)
from soundspaces_sim.parts import (
    BASELINES,
    DatasetConfig,
    load_result,
    nearest_name as nearest,
    publish_file as publish,
    read_json,
    split_file,
)

Log = Callable[[str], None]
_NAME = "study.json"
CHOICE = "homes.json"  # which homes were taken


@dataclass(frozen=True)
class Study:
    """`homes`: per split; `walks` per point; episodes to train with and to test with; which `variants`;
    `sounds_at_a_goal`: of many, in training; every one of 73 at every goal of Replica would be 54 GB."""

    preset: str
    homes: tuple[int, int, int]
    walks: int
    train_episodes: int
    test_episodes: int
    variants: tuple[str, ...]
    replays: int
    sounds_at_a_goal: int = 1
    rate: int = 16000
    spacing: float = 0.75

    def parted(self, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
        """Homes by split: training takes the first."""
        a, b, _ = np.cumsum(self.homes)
        return {"train": tuple(names[:a]), "val": tuple(names[a:b]), "test": tuple(names[b:])}

    @property
    def job(self) -> JobConfig:
        """Settings of the datasets."""
        return JobConfig(
            grid=GridConfig(spacing=self.spacing, standing=True),
            simulation=SimulationConfig(walks=self.walks),
            dataset=DatasetConfig(rate=self.rate),
        )


STUDIES = {
    "quick": Study("quick", (5, 1, 2), 100, 2000, 100, ("AG-dagger",), 1),
    "small": Study(
        "small", (24, 4, 16), 100, 20_000, 400, (*without_twins(PPO_VARIANTS, 100), "AG-dagger"), 10
    ),
    # The paper's numbers of Replica: 100,000 episodes to train with, 1,000 to test; its rate and grid.
    "paper": Study(
        "paper", (24, 4, 16), 1000, 100_000, 1000, without_twins(PPO_VARIANTS, 1000), 10, 3, 44100, 0.5
    ),
}


def study(name: str) -> Study:
    """A study by its preset's name. Raises `ConfigError`."""
    if name not in STUDIES:
        raise ConfigError(
            f"PRESET: expected one of {', '.join(STUDIES)}, got '{name}'{nearest(name, STUDIES)}"
        )
    return STUDIES[name]


@dataclass(frozen=True)
class RunSpec:
    """What to run: `variants` in order, `seeds` of each, `updates` of training and `homes` per split (None: those
    of the preset)."""

    preset: str
    variants: tuple[str, ...]
    seeds: int = 1
    updates: int | None = None
    homes: tuple[int, int, int] | None = None

    @property
    def plan(self) -> Study:
        """The study of its preset, with the homes that were asked for. Raises `ConfigError`."""
        plan = study(self.preset)
        return plan if self.homes is None else replace(plan, homes=self.homes)

    @property
    def runs(self) -> list[tuple[Variant, int]]:
        """Every arm's first seed before any second."""
        return [(VARIANTS[name], seed) for seed in range(self.seeds) for name in self.variants]

    @property
    def command(self) -> str:
        """What repeats it."""
        updates = f" --updates {self.updates}" if self.updates is not None else ""
        if self.homes is not None:
            updates += f" --homes {','.join(map(str, self.homes))}"
        run = f"soundspaces-agents run --preset {self.preset} --seeds {self.seeds}"
        return f"{run} --agents {','.join(self.variants)}{updates}"


def read_specs(out: Path) -> list[RunSpec]:
    """All runs that were asked for in a folder, the last at the end. Raises `ConfigError`."""
    rows = read_json(out / _NAME, ConfigError, "record of a study")
    try:
        return msgspec.convert(rows, list[RunSpec])
    except msgspec.ValidationError as error:
        raise ConfigError(f"{out / _NAME}: not a record of a study ({error})") from error


def record_spec(spec: RunSpec, out: Path) -> None:
    """Put down what is asked for. Raises `ConfigError` if the folder is of another preset, or of other homes."""
    before = read_specs(out) if (out / _NAME).exists() else []
    if before and before[-1].preset != spec.preset:
        raise ConfigError(
            f"{out}: this folder holds a study of preset '{before[-1].preset}', not '{spec.preset}'; take another"
        )
    if before and before[-1].plan.homes != spec.plan.homes:
        a, b = (",".join(map(str, one.plan.homes)) for one in (before[-1], spec))
        raise ConfigError(f"{out}: this folder holds a study of {a} homes, not {b}; take another")
    specs = [asdict(one) for one in (*(o for o in before if o != spec), spec)]
    out.mkdir(parents=True, exist_ok=True)
    publish(out / _NAME, msgspec.json.encode(specs))


def episodes_path(out: Path, name: str) -> Path:
    """The file of a set of episodes."""
    return split_file(out / "episodes" / "replica" / "v1" / name)


def agent_folder(out: Path, variant: Variant, seed: int) -> Path:
    """Where a run of training is kept."""
    return out / "agents" / f"{variant.name}-{seed}"


def result_path(out: Path, trial: Trial) -> Path:
    """Where a result is kept."""
    return out / "results" / trial.agent / trial.condition.name / f"{trial.seed}.json"


def data_folder(plan: Study, out: Path, acoustics: Acoustics) -> Path:
    """Where the datasets of some acoustics are."""
    own = acoustics.walks is None or acoustics.walks == plan.walks
    return out / ("data" if own else f"data-walks-{acoustics.walks}")


def open_data(plan: Study, out: Path, acoustics: str) -> NavData:
    """The datasets of some acoustics, by name, as they are rendered there."""
    chosen = ACOUSTICS[acoustics]
    return NavData(data_folder(plan, out, chosen), chosen.renderer)


def open_test(plan: Study, out: Path, trial: Trial) -> tuple[Any, AudioNavEnv, list[Episode]]:
    """An agent, the environment that it is tested in, and the episodes."""
    config, variant = preset(plan.preset), VARIANTS.get(trial.agent)
    data = open_data(plan, out, trial.condition.acoustics)
    episodes = read_episodes(episodes_path(out, trial.condition.episodes), data)
    env = AudioNavEnv(
        data,
        task=variant.task if variant else "AudioGoal",
        split="test",
        episodes=episodes,
        sensors=variant.sensors if variant else ("intensity", "collision"),
        max_steps=config.max_steps,
        depth_size=config.depth_size,
        gps_sigma=trial.condition.sigma,
        ears=variant.ears if variant else "binaural",
    )
    if variant is None:
        return BASELINES[trial.agent](), env, episodes
    return load_agent(agent_folder(out, variant, trial.seed) / run_files.NAME), env, episodes


def load_results(out: Path) -> dict[tuple[str, Condition], list[Result]]:
    """All results by agent and condition, one per seed."""
    found: dict[tuple[str, Condition], list[Result]] = {}
    for path in sorted((out / "results").glob("*/*/*.json")):
        agent, condition = path.parts[-3:-1]
        if condition in CONDITIONS:
            found.setdefault((agent, CONDITIONS[condition]), []).append(load_result(path))
    return found
