"""A collection as tasks use it: homes by split, subsets of the homes for training, and pairs drawn by seed.

No home is in two splits. Of `n` training homes a seed draws its own, so that intervals over seeds hold the
choice of homes as well as the start and the order of training."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from soundspaces_rooms.many_rooms import in_processes

from soundspaces_sim import ConfigError, RirCollection, open_datasets
from soundspaces_sim.parts import SPLITS, read_splits

RATE = 16000  # Hz, of everything that tasks hear
_SPLITS = ("train", "val", "test")
_STREAM = 0x7A5C  # keeps these draws apart from others with the same seed
_Made = TypeVar("_Made")


@dataclass(frozen=True)
class Setting:
    """`root`: the collection's folder; `splits`: homes of train, val and test; `homes`: numbers of training homes,
    ascending; `seeds` runs of everything that is trained; `pairs` of a home; `updates` of a network; `jobs`
    processes. `about`: grid and accuracy of the homes, for people."""

    root: Path
    splits: dict[str, tuple[str, ...]]
    homes: tuple[int, ...]
    seeds: int = 3
    pairs: int = 32
    updates: int = 600
    jobs: int | None = None
    say: Callable[[str], None] = print
    about: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Homes of all splits: train, val, test."""
        return tuple(name for split in _SPLITS for name in self.splits[split])

    def rows(self, split: str) -> np.ndarray:
        """Rows of `names` that belong to a split."""
        return np.flatnonzero([name in self.splits[split] for name in self.names])

    def chosen(self, count: int, seed: int) -> np.ndarray:
        """Rows of `names` of `count` training homes, drawn by a seed."""
        rows = self.rows("train")
        return np.sort(np.random.default_rng((_STREAM, seed, count)).permutation(rows)[:count])

    def within(self, split: str, home: np.ndarray) -> np.ndarray:
        """(n,) which of the rows `home` (n,) of `names` belong to a split."""
        return np.isin(home, self.rows(split))

    def trained_on(self, count: int, seed: int, home: np.ndarray) -> np.ndarray:
        """(n,) which of the rows `home` (n,) of `names` are `chosen`."""
        return np.isin(home, self.chosen(count, seed))


@dataclass(frozen=True)
class HomeJob:
    """One home whose examples are to be made: its folder, its number in the collection, and how many pairs."""

    folder: Path
    number: int
    pairs: int

    def rng(self, stream: int) -> np.random.Generator:
        """Random numbers of this home and of one purpose."""
        return np.random.default_rng((_STREAM, stream, self.number))


def examples(setting: Setting, make: Callable[[HomeJob], _Made]) -> list[_Made]:
    """`make` of every home of `setting.names`, in that order, in `setting.jobs` processes."""
    jobs = [HomeJob(setting.root / name, _number(name), setting.pairs) for name in setting.names]
    return list(in_processes(make, jobs, setting.jobs))


def _number(name: str) -> int:
    """A number of a home that other homes beside it do not change: that in its name, or one of its letters."""
    tail = name.rpartition("-")[2]
    return int(tail) if tail.isdigit() else int.from_bytes(name.encode()[-8:], "little")


def open_setting(
    root: str | Path,
    homes: Sequence[int] = (),
    seeds: int = 3,
    pairs: int = 32,
    updates: int = 600,
    jobs: int | None = None,
    say: Callable[[str], None] = print,
) -> Setting:
    """The setting of a collection. `homes`: numbers of training homes; by default 10, 30, 100, … of those that are
    there, and all. Raises `ConfigError`, `DatasetError`."""
    for what, value, most in (
        ("seeds", seeds, 100),
        ("pairs", pairs, 10_000),
        ("updates", updates, 10**6),
    ):
        if not 1 <= value <= most:
            raise ConfigError(f"{what}: expected 1 to {most:,}, got {value}")
    root = Path(root)
    splits, about = _splits_of(root)
    there = len(splits["train"])
    counts = tuple(sorted(set(homes))) or (*(n for n in (10, 30, 100, 300) if n < there), there)
    if counts[0] < 1 or counts[-1] > there:
        raise ConfigError(
            f"homes: expected 1 to {there}, the homes of split 'train' in {root}, got "
            f"{counts[0] if counts[0] < 1 else counts[-1]}; `make collection` makes more"
        )
    return Setting(root, splits, counts, seeds, pairs, updates, jobs, say, about)


def _splits_of(root: Path) -> tuple[dict[str, tuple[str, ...]], str]:
    """Homes by split, and what all of them are like."""
    with open_datasets(root) as found:
        names = list(found)
        about = _checked(found)
    splits = read_splits(root / SPLITS, names)
    missing = [split for split in _SPLITS if not splits.get(split)]
    if missing:
        raise ConfigError(
            f"{root / SPLITS}: expected the splits train, val and test with a home each, found none in "
            f"'{missing[0]}'; of ten homes of `make collection` the ninth is in val, the tenth in test"
        )
    return {split: splits[split] for split in _SPLITS}, about


def _checked(found: RirCollection) -> str:
    """Grid, points and subpaths of the homes. Raises `ConfigError` for one of too few points."""
    for name, ds in found.items():
        if len(ds.points) < 3:
            raise ConfigError(
                f"{found.root / name}: expected at least 3 points, got {len(ds.points)}; tasks draw pairs of them"
            )
    config = next(iter(found.values())).manifest.config
    mean = np.mean([len(ds.points) for ds in found.values()])
    walks, error = config.simulation.walks, config.simulation.target_error
    accuracy = f"an error of {error:g}" if walks is None else f"{walks:,} subpaths a point"
    return f"a grid of {config.grid.spacing:g} m, {mean:.0f} points a home, {accuracy}"
