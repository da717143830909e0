"""Evaluation: an agent on a list of episodes, with intervals and paired differences.

Intervals concern scenes and seeds (runs of training) like these, not these: the variance of a mean is the sum of
that between scenes and that between seeds, each by the deviations of whole clusters (Liang & Zeger, Biometrika
1986), and the ends are at Student's quantile of as many degrees of freedom as the two leave (Satterthwaite,
Biometrics Bulletin 1946; Welch, Biometrika 1947), for scenes and seeds are few. Of one scene episodes are the
clusters.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy.stats import t as student

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.core.io.untrusted import read_json
from soundspaces_sim.nav.agents import Agent
from soundspaces_sim.nav.metrics import NAMES


@dataclass(frozen=True)
class Interval:
    """A mean, the ends of its 95 % interval, its standard `error` and that error's degrees of `freedom`."""

    mean: float
    low: float
    high: float
    error: float = float("nan")
    freedom: float = float("inf")

    def among(self, comparisons: int) -> Interval:
        """The interval that holds with 95 % for all of so many `comparisons` together (Bonferroni's correction,
        Dunn 1961), from the standard error and its degrees of freedom."""
        reach = float(student.ppf(1.0 - 0.025 / comparisons, self.freedom)) * self.error
        return Interval(self.mean, self.mean - reach, self.mean + reach, self.error, self.freedom)

    def __str__(self) -> str:
        known = np.isfinite(self.low) and np.isfinite(self.high)
        return f"{self.mean:.3f} " + (f"[{self.low:.3f}, {self.high:.3f}]" if known else "(no interval)")


@dataclass(frozen=True)
class Result:
    """`rows`: structured array with scene, episode_id, seed, return (the sum of rewards) and the environment's
    measures, such as those of `metrics.Metrics`, one row per episode and seed."""

    agent: str
    rows: np.ndarray

    def summary(self) -> dict[str, Interval]:
        """Mean and 95 % interval of every measure."""
        return {name: _interval(self.rows, self.rows[name]) for name in ("return", *self.measures)}

    @property
    def measures(self) -> tuple[str, ...]:
        """Names of its measures."""
        return tuple(name for name in self.rows.dtype.names or () if name not in _OTHERS)

    def compare(self, other: Result, measure: str = "spl") -> Interval:
        """This minus the other, episode by episode and seed by seed. Raises `ConfigError` unless both walked the
        same episodes. With different numbers of seeds, means over seeds are compared."""
        if measure not in self.measures:
            raise ConfigError(f"measure: expected one of {', '.join(self.measures)}, got {measure!r}")
        mine, theirs = self.rows, other.rows
        if set(mine["seed"]) != set(theirs["seed"]):
            mine, theirs = _mean_over_seeds(mine), _mean_over_seeds(theirs)
        mine, theirs = np.sort(mine, order=_KEYS), np.sort(theirs, order=_KEYS)
        if len(mine) != len(theirs) or any((mine[k] != theirs[k]).any() for k in _KEYS):
            raise ConfigError(
                f"{self.agent} ({len(mine)} rows) and {other.agent} ({len(theirs)}) did not walk the same episodes"
            )
        return _interval(mine, mine[measure] - theirs[measure])

    def by_seed(self, measure: str = "spl") -> np.ndarray:
        """(seeds,) means over episodes: how runs of training differ."""
        seeds, row = np.unique(self.rows["seed"], return_inverse=True)
        return np.bincount(row, self.rows[measure], len(seeds)) / np.bincount(row)

    def save(self, path: Path) -> None:
        """Write as JSON."""
        columns = {name: self.rows[name].tolist() for name in self.rows.dtype.names or ()}
        publish(path, json.dumps({"agent": self.agent, "rows": columns}).encode())


_KEYS = ["scene", "episode_id", "seed"]
_OTHERS = (*_KEYS, "return")


def _dtype(measures: Sequence[str] = NAMES) -> np.dtype:
    text = [("scene", "U64"), ("episode_id", "U64"), ("seed", "i8"), ("return", "f8")]
    return np.dtype([*text, *((name, "f8") for name in measures)])


def load_result(path: Path) -> Result:
    """A result written by `Result.save`. Raises `ConfigError`."""
    try:
        raw = read_json(path, ConfigError, "result of an evaluation")
        columns = raw["rows"]
        measures = [str(name) for name in columns if name not in _OTHERS]
        rows = np.zeros(len(columns["scene"]), _dtype(measures or NAMES))
        for name in rows.dtype.names or ():
            rows[name] = columns[name]
        return Result(str(raw["agent"]), rows)
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: not a result of an evaluation ({error})") from error


def merge(results: Sequence[Result]) -> Result:
    """Results of several seeds of one agent as one."""
    return Result(results[0].agent, np.concatenate([r.rows for r in results]))


class Walked(Protocol):
    """What `evaluate` asks of an episode: an `Episode`, a `ContinuousEpisode`."""

    @property
    def scene(self) -> str: ...

    @property
    def episode_id(self) -> str: ...


def evaluate(
    agent: Agent,
    env: Any,
    episodes: Sequence[Walked],
    seed: int = 0,
    progress: Callable[[dict[str, float]], None] | None = None,
) -> Result:
    """Walk `episodes` once each in `env`, an `AudioNavEnv` or one in wrappers.

    `seed` decides the sensors' noise and what the agent draws: each episode has numbers of its own, so that their
    order does not matter. `progress` is told the rate of episodes and means so far.
    """
    if not episodes:
        raise ConfigError("episodes: expected at least one to evaluate")
    measures = env.unwrapped.names
    rows = np.zeros(len(episodes), _dtype(measures))
    started = time.monotonic()
    for k, episode in enumerate(episodes):
        own = int(np.random.SeedSequence((seed, k)).generate_state(1)[0])
        observation, info = env.reset(seed=own, options={"episode": episode})
        agent.reset(env.unwrapped.state, own)
        total, over = 0.0, False
        while not over:
            observation, reward, terminated, truncated, info = env.step(agent.act(observation))
            total += float(reward)
            over = bool(terminated or truncated)
        rows[k] = (episode.scene, episode.episode_id, seed, total, *(info[name] for name in measures))
        if progress is not None:
            done = rows[: k + 1]
            rate = (k + 1) / max(time.monotonic() - started, 1e-9)
            progress(
                {
                    "episodes": k + 1,
                    "per_s": rate,
                    "success": done["success"].mean(),
                    "spl": done["spl"].mean(),
                }
            )
    return Result(agent.name, rows)


def _mean_over_seeds(rows: np.ndarray) -> np.ndarray:
    _, first, inverse = np.unique(rows[_KEYS[:2]], return_index=True, return_inverse=True)
    out = rows[first].copy()
    count = np.bincount(inverse)
    out["seed"] = 0
    for name in (n for n in rows.dtype.names or () if n not in _KEYS):
        out[name] = np.bincount(inverse, rows[name]) / count
    return out


def _interval(rows: np.ndarray, values: np.ndarray) -> Interval:
    """Of the mean of `values` (n,), one for each of `rows`; no interval where a single episode tells no spread."""
    mean = float(values.mean())
    scenes = rows["scene"] if len(np.unique(rows["scene"])) > 1 else rows["episode_id"]
    terms = [_between(labels, values - mean) for labels in (scenes, rows["seed"])]
    if terms[0][1] == 0:
        return Interval(mean, float("nan"), float("nan"))
    variance = sum(v for v, _ in terms)
    of_terms = sum(v * v / freedom for v, freedom in terms if freedom > 0)
    freedom = variance * variance / of_terms if of_terms > 0.0 else float("inf")
    error = float(np.sqrt(variance))
    return Interval(mean, mean, mean, error, float(freedom)).among(1)


def _between(labels: np.ndarray, deviations: np.ndarray) -> tuple[float, int]:
    """Variance of a mean from clusters by `labels` (n,), from `deviations` (n,) from it, and its degrees of
    freedom; (0, 0) of one cluster."""
    names, row = np.unique(labels, return_inverse=True)
    count = len(names)
    if count < 2:
        return 0.0, 0
    sums = np.bincount(row, deviations, count) / len(deviations)
    return float((sums**2).sum()) * count / (count - 1), count - 1
