"""An export before it is made: which pairs, how many files and bytes; then its writing.

Exports are many times as large as the datasets they are made from, so their size is known, and compared
with the free space, before anything is written.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soundspaces_sim.core.errors import ConfigError, DatasetError
from soundspaces_sim.core.io.untrusted import read_text
from soundspaces_sim.core.platforms import sync_all
from soundspaces_sim.dataset.reader import RirDataset

MOST_PAIRS = 256 * 2**20  # bytes of a file of pairs
_log = logging.getLogger(__name__)
Progress = Callable[[int, int], None]  # done, total


@dataclass(frozen=True)
class ExportPlan:
    """`files` under `out`, of about `bytes` in all; `write(progress)` writes them: the files `places`, or into the
    folders `places`, which hold nothing else."""

    out: Path
    files: int
    bytes: int
    write: Callable[[Progress], None]
    places: Sequence[Path]


def carry_out(plan: ExportPlan, progress: Progress | None = None) -> int:
    """Write a plan's files, if there is room for them; their number. Raises `DatasetError`."""
    check_space(plan.out, plan.bytes)
    plan.write(progress or (lambda _done, _total: None))
    sync_all()
    return plan.files


def check_space(out: Path, needed: int) -> None:
    """Raise `DatasetError` if fewer than `needed` bytes are free where `out` is or will be."""
    place = out.absolute()
    while not place.exists():
        place = place.parent
    free = shutil.disk_usage(place).free
    if free < needed:
        raise DatasetError(
            f"{out}: this export needs about {needed / 1e9:.2f} GB, {free / 1e9:.2f} GB are free; choose fewer "
            "pairs or headings, a lower rate, or another place"
        )


def choose_pairs(ds: RirDataset, which: str | Path = "nodes") -> np.ndarray:
    """(k, 2) sources and listeners: ``nodes`` (all pairs of points that the navigation graph has), ``all``, or a
    text file with lines ``source listener``. Raises `ConfigError`.

    A dataset without a navigation graph gives all pairs for ``nodes``, and says so.
    """
    points = np.arange(len(ds.points))
    if which == "nodes":
        nodes = np.array(ds.manifest.nodes, int)
        if len(nodes):
            points = nodes
        else:
            _log.info("%s has no navigation graph: all its points are taken", ds.scene)
    elif which != "all":
        return _pairs_of(Path(which), len(ds.points))
    return np.stack(np.meshgrid(points, points, indexing="ij"), axis=-1).reshape(-1, 2)


def _pairs_of(path: Path, points: int) -> np.ndarray:
    if not path.exists():
        raise ConfigError(f"pairs: expected nodes, all or a file of pairs; there is no file {path}")
    text = read_text(path, ConfigError, "file of pairs", MOST_PAIRS)
    rows = [line.split() for line in text.splitlines() if line.strip()]
    try:
        pairs = np.array([[int(x) for x in row] for row in rows], np.int64)
    except (ValueError, OverflowError) as error:
        raise ConfigError(
            f"{path}: expected lines of two integers, source and listener ({error})"
        ) from error
    if pairs.ndim != 2 or pairs.shape[1] != 2 or len(pairs) == 0:
        raise ConfigError(f"{path}: expected lines of two integers, source and listener, at least one")
    bad = ((pairs < 0) | (pairs >= points)).any(axis=1)
    if bad.any():
        raise ConfigError(f"{path}: pair {pairs[bad][0].tolist()} is not among points 0 to {points - 1}")
    return np.unique(pairs, axis=0)


def check_headings(headings: tuple[float, ...], name: str = "headings") -> tuple[float, ...]:
    """Different degrees from 0 to below 360. Raises `ConfigError`, which blames `name`."""
    found = tuple(float(h) for h in headings)
    if len(set(found)) != len(found) or not all(0.0 <= h < 360.0 for h in found):
        raise ConfigError(f"{name}: expected different degrees from 0 to below 360, got {headings}")
    return found


def samples_of(ds: RirDataset) -> int:
    """How many samples a response of the dataset has; a late arrival may add some."""
    return int(np.ceil(ds.manifest.duration * ds.rate))
