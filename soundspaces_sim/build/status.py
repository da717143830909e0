"""How far the job in a folder is, from what lies there alone: also while it runs, on any machine that sees it."""

from __future__ import annotations

import os
import time
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.manifest import NAME, ShardEntry, datasets_in, read_manifest
from soundspaces_sim.dataset.format.shard import Shard
from soundspaces_sim.dataset.format.waveform_shard import WaveformShard

_SAMPLE = 8  # shards whose errors are read


@dataclass(frozen=True)
class FolderStatus:
    """Of one dataset: `tiles` and room impulse responses (`rirs`) that are done, of how many; `bytes` on disk.

    `error`: median relative standard error of late energy, all bands, of pairs in some finished shards, nan
    where there is none. `age_s`: seconds since the last shard, nan where there is none.
    """

    folder: Path
    scene: str
    complete: bool
    tiles: tuple[int, int]
    rirs: tuple[int, int]
    bytes: int
    error: float
    age_s: float


def find_datasets(folder: str | Path) -> list[Path]:
    """Datasets, finished or not: the folder itself, or those in it. Raises `DatasetError` if there is none."""
    folder = Path(folder)
    if (folder / NAME).is_file():
        return [folder]
    found = datasets_in(folder)
    if not found:
        raise DatasetError(f"no dataset at {folder}, nor in a folder in it: {NAME} is missing")
    return found


def read_status(folder: Path) -> FolderStatus:
    """What is done in a dataset's folder. Raises `DatasetError` if its manifest cannot be read."""
    manifest = read_manifest(folder)
    there = _files(folder)
    done = [e for e in manifest.shards if e.file in there]
    # Where they begin: every block listens somewhere.
    blocks = sorted({e.listeners[0] for e in manifest.shards})
    tiles = {_tile(blocks, e) for e in manifest.shards}
    lacking = {_tile(blocks, e) for e in manifest.shards if e.file not in there}
    form = manifest.shards[0].form if manifest.shards else "echogram"
    newest = max((there[e.file].st_mtime for e in done), default=float("nan"))
    return FolderStatus(
        folder,
        manifest.scene,
        manifest.complete,
        (len(tiles - lacking), len(tiles)),
        (_pairs(done, form), _pairs(manifest.shards, form)),
        sum(there[e.file].st_size for e in done),
        _error(folder, done),
        time.time() - newest,
    )


def _files(folder: Path) -> dict[str, os.stat_result]:
    with os.scandir(folder) as entries:
        return {e.name: e.stat() for e in entries if e.name.endswith(".h5") and e.is_file()}


def _pairs(entries: list[ShardEntry] | tuple[ShardEntry, ...], form: str) -> int:
    spans = ((e.sources, e.listeners) for e in entries if e.form == form)
    return sum((s[1] - s[0]) * (l[1] - l[0]) for s, l in spans)


def _tile(blocks: list[int], entry: ShardEntry) -> tuple[int, int]:
    """The two blocks of an entry's tile."""
    a, b = (bisect_right(blocks, first) for first in (entry.sources[0], entry.listeners[0]))
    return min(a, b), max(a, b)


def _error(folder: Path, done: list[ShardEntry]) -> float:
    some = np.linspace(0, len(done) - 1, min(_SAMPLE, len(done))).astype(int)
    late = []
    for entry in (done[k] for k in some):
        try:
            kind: type[Shard] = EchogramShard if entry.form == "echogram" else WaveformShard
            shard = kind(folder / entry.file)  # type: ignore[call-arg]
        except DatasetError:
            continue  # damaged, or of an older job: `verify` and the next run say so
        late.append(shard.pairs["relative_error"][:, :, 1].astype(float).ravel())
        shard.close()
    values = np.concatenate([np.empty(0), *late])
    values = values[np.isfinite(values) & (values > 0.0)]
    return float(np.median(values)) if len(values) else float("nan")
