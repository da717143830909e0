"""The record of a study: one file, of which its page is made (`pictures.write_page`), single episodes included.

Gzipped JSON: what was asked for, which homes were looked at, digests of the data, learning curves, and what every
test measured, by agent, condition and seed, one number per episode.
"""

from __future__ import annotations

import gzip
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from soundspaces_agents.experiments import CONDITIONS, VARIANTS, Condition, Variant
from soundspaces_agents.homes import Choice, read_choice
from soundspaces_agents.learn.run_files import read_curve
from soundspaces_agents.pictures.provenance import data_lines
from soundspaces_agents.study import CHOICE, RunSpec, load_results, read_specs
from soundspaces_sim import ConfigError
from soundspaces_sim.nav import Result
from soundspaces_sim.parts import publish_file as publish, unpacked_episodes as unpacked

NAME = "record.json.gz"
_KEYS = ("scene", "episode_id", "seed")
_POINTS = 24  # of a learning curve that are kept


@dataclass(frozen=True)
class Curve:
    """Of a run of training: rows of its learning curve, the last one included."""

    agent: str
    seed: int
    rows: list[dict[str, float]]


@dataclass(frozen=True)
class Tested:
    """What an agent's run measured in a condition, by measure; episodes are those of `Record.episodes` under the
    condition's name of a set."""

    agent: str
    condition: str
    seed: int
    measures: dict[str, list[float]]


@dataclass(frozen=True)
class Record:
    """A study. `about`: how it was made, in words; `data`: lines that name its data by digest; `episodes`: scene
    and number of each, by set."""

    about: str
    specs: list[RunSpec]
    homes: Choice | None
    data: list[str]
    curves: list[Curve]
    episodes: dict[str, list[tuple[str, str]]]
    tests: list[Tested]

    @property
    def results(self) -> dict[tuple[str, Condition], list[Result]]:
        """Results by agent and condition, one per seed."""
        found: dict[tuple[str, Condition], list[Result]] = {}
        for test in self.tests:
            condition = CONDITIONS[test.condition]
            found.setdefault((test.agent, condition), []).append(
                Result(test.agent, _rows(test, self.episodes[condition.episodes]))
            )
        return found

    def curves_of(self) -> Iterator[tuple[Variant, int, list[dict[str, float]]]]:
        """(arm, seed, learning curve) of every run that there is, arm by arm."""
        for variant in VARIANTS.values():
            for curve in sorted((c for c in self.curves if c.agent == variant.name), key=_seed):
                yield variant, curve.seed, curve.rows


def _seed(curve: Curve) -> int:
    return curve.seed


def gather(out: Path, about: str = "") -> Record:
    """The record of what there is in a study's folder. Raises `ConfigError`."""
    episodes: dict[str, list[tuple[str, str]]] = {}
    tests = []
    for (agent, condition), results in load_results(out).items():
        for result in results:
            rows = result.rows
            own = list(zip(rows["scene"].tolist(), rows["episode_id"].tolist(), strict=True))
            (seed,) = set(rows["seed"].tolist())
            if episodes.setdefault(condition.episodes, own) != own:
                raise ConfigError(
                    f"{out}: {agent} in '{condition.name}' walked other episodes than those before; delete the "
                    "results, and test anew"
                )
            measures = {
                name: rows[name].tolist() for name in rows.dtype.names or () if name not in _KEYS
            }
            tests.append(Tested(agent, condition.name, seed, measures))
    choice = out / CHOICE
    return Record(
        about,
        read_specs(out),
        read_choice(choice) if choice.exists() else None,
        data_lines(out),
        list(_curves(out)),
        episodes,
        tests,
    )


def _curves(out: Path) -> Iterator[Curve]:
    for name in VARIANTS:
        for folder in sorted((out / "agents").glob(f"{name}-[0-9]*")):
            if rows := read_curve(folder):
                kept = np.unique(np.linspace(0, len(rows) - 1, _POINTS).round().astype(int))
                yield Curve(name, int(folder.name.rpartition("-")[2]), [rows[k] for k in kept])


def write_record(record: Record, path: Path) -> None:
    """The same record gives the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    publish(path, gzip.compress(msgspec.json.encode(record), mtime=0))


def read_record(path: Path) -> Record:
    """Raises `ConfigError`."""
    try:
        return msgspec.json.decode(unpacked(path), type=Record)
    except msgspec.DecodeError as error:
        raise ConfigError(f"{path}: not a record of a study ({error})") from error


def _rows(test: Tested, episodes: Iterable[tuple[str, str]]) -> np.ndarray:
    scenes, numbers = zip(*episodes, strict=True)
    kinds = [("scene", "U64"), ("episode_id", "U64"), ("seed", "i8")]
    rows = np.zeros(len(scenes), np.dtype([*kinds, *((name, "f8") for name in test.measures)]))
    rows["scene"], rows["episode_id"], rows["seed"] = scenes, numbers, test.seed
    for name, values in test.measures.items():
        rows[name] = values
    return rows
