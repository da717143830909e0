"""The job behind `make rirs`: grid, tiles, shards, manifest. Resumable and idempotent.

The points are cut into blocks; a tile is a pair of blocks (i <= j) and yields the shards i -> j and
j -> i. A shard's key covers all that decides its content, so a finished shard is recognised and skipped
and a rebuilt one has the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import logging
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numba
import numpy as np

from soundspaces_sim.config import JobConfig
from soundspaces_sim.echogram import Echograms
from soundspaces_sim.errors import ConfigError, DatasetError
from soundspaces_sim.grid import make_grid
from soundspaces_sim.manifest import NAME, Manifest, ShardEntry, read_manifest, write_manifest
from soundspaces_sim.prepare import Engine, prepare
from soundspaces_sim.scene import Scene
from soundspaces_sim.shard import encode, file_sha256, is_valid, remove_stale, write_shard
from soundspaces_sim.simulate import simulate_pairs
from soundspaces_sim.version import __version__

_log = logging.getLogger(__name__)

_TILE_BYTES = 1.5e9  # working memory of a tile
_TILE_MAX = 96
_LEAST_TILES = 3  # blocks at least, so that an interrupted job keeps something

Progress = Callable[[int, int], None]  # points traced, of how many


@dataclass(frozen=True)
class BuildResult:
    """Where the dataset is; `built` of `shards` were made now, the others were there."""

    folder: Path
    manifest: Manifest
    built: int
    shards: int


@dataclass(frozen=True)
class _Tile:
    a: tuple[int, int]
    b: tuple[int, int]

    @property
    def entries(self) -> list[ShardEntry]:
        forward = _entry(self.a, self.b)
        return [forward] if self.a == self.b else [forward, _entry(self.b, self.a)]

    @property
    def cost(self) -> int:
        """Points whose walks it traces."""
        return self.a[1] - self.a[0] + (self.b[1] - self.b[0] if self.a != self.b else 0)


def _entry(sources: tuple[int, int], listeners: tuple[int, int]) -> ShardEntry:
    name = f"s{sources[0]:05d}_l{listeners[0]:05d}.h5"
    return ShardEntry(file=name, sources=sources, listeners=listeners)


def build_dataset(
    scene: Scene,
    out: str | Path,
    config: JobConfig | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Simulate all pairs of a scene's grid into `out`/<scene name>/; goes on where it was stopped.

    `jobs`: threads. Raises `SceneError` if no point survives, `DatasetError` if the folder holds a
    dataset made from something else or cannot be written.
    """
    config = config or JobConfig()
    _set_threads(jobs)
    folder = Path(out) / scene.name
    grid = make_grid(scene, config=config.grid)
    engine = prepare(scene, grid.points, config.simulation, config.dataset.seed)
    tiles = plan_tiles(len(grid.points), engine, config.dataset.tile)
    draft = Manifest(
        status="building",
        scene=scene.name,
        scene_digest=scene.digest,
        key=_job_key(engine, config, grid.points),
        code_version=__version__,
        config=config,
        duration=engine.duration,
        notes=scene.notes,
        points=tuple((float(x), float(y), float(z)) for x, y, z in grid.points),
        shards=tuple(e for t in tiles for e in t.entries),
    )
    if _already_complete(folder, draft):
        return BuildResult(folder, read_manifest(folder), 0, len(draft.shards))

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(
            f"{folder}: cannot make this folder ({error.strerror}); choose another OUT"
        ) from error
    remove_stale(folder)
    if not (folder / NAME).exists():
        write_manifest(folder, draft)
    total, done, built = sum(t.cost for t in tiles), 0, 0
    for tile in tiles:
        missing = [e for e in tile.entries if not is_valid(folder / e.file, _shard_key(draft, e))]
        if missing:

            def report(points: int, before: int = done) -> None:
                if progress is not None:
                    progress(before + points, total)

            for entry, echoes in _run(engine, tile, grid.points, report):
                if entry in missing:
                    _store(folder, draft, entry, echoes)
                    built += 1
        done += tile.cost
        if progress is not None:
            progress(done, total)
    entries = tuple(
        msgspec.structs.replace(
            e, bytes=(folder / e.file).stat().st_size, sha256=file_sha256(folder / e.file)
        )
        for e in draft.shards
    )
    manifest = msgspec.structs.replace(draft, status="complete", shards=entries)
    write_manifest(folder, manifest)
    return BuildResult(folder, manifest, built, len(entries))


def _set_threads(jobs: int | None) -> None:
    most = numba.get_num_threads()
    if jobs is None:
        return
    if not 1 <= jobs <= most:
        raise ConfigError(f"jobs: expected 1 to {most} (the cores of this machine), got {jobs}")
    numba.set_num_threads(jobs)


def plan_tiles(points: int, engine: Engine, tile: int | None) -> list[_Tile]:
    """Tiles that cover all pairs of `points` points; `tile` points per side, or as memory allows."""
    if tile is None:
        bins, bands = len(engine.time_edges) - 1, engine.air.shape[1]
        bytes_per_pair = 4 * bins * 9 * bands * 4  # two tables each way, float32
        largest = int(min(np.sqrt(_TILE_BYTES / bytes_per_pair), _TILE_MAX))
        tile = max(min(largest, int(np.ceil(points / _LEAST_TILES))), 1)
    starts = list(range(0, points, tile))
    blocks = [(s, min(s + tile, points)) for s in starts]
    return [_Tile(a, b) for i, a in enumerate(blocks) for b in blocks[i:]]


def _job_key(engine: Engine, config: JobConfig, points: np.ndarray) -> str:
    sha = hashlib.sha256()
    content = {
        "config": msgspec.to_builtins(config),
        "duration": engine.duration,
        "code": __version__,
        "scene": engine.scene.digest,
    }
    sha.update(json.dumps(content, sort_keys=True).encode())
    sha.update(np.ascontiguousarray(points, "<f8").tobytes())
    return sha.hexdigest()


def _shard_key(manifest: Manifest, entry: ShardEntry) -> str:
    span = f"{manifest.key}:{entry.sources}:{entry.listeners}"
    return hashlib.sha256(span.encode()).hexdigest()


def _already_complete(folder: Path, draft: Manifest) -> bool:
    """True if the folder holds this very dataset, whole. Raises if it holds another."""
    if not (folder / NAME).exists():
        return False
    found = read_manifest(folder)
    if found.key != draft.key:
        raise DatasetError(
            f"{folder} holds a dataset made from another scene, grid, config, seed or version (key "
            f"{found.key[:12]}, now {draft.key[:12]}); choose another OUT, or delete that folder"
        )
    if not found.complete:
        return False
    return all(
        (folder / e.file).is_file() and (folder / e.file).stat().st_size == e.bytes for e in found.shards
    )


def _run(
    engine: Engine, tile: _Tile, points: np.ndarray, report: Callable[[int], None]
) -> Iterator[tuple[ShardEntry, Echograms]]:
    a = points[slice(*tile.a)]
    b = None if tile.a == tile.b else points[slice(*tile.b)]
    forward, backward = simulate_pairs(engine, a, b, progress=report)
    results = [forward] if backward is None else [forward, backward]
    yield from zip(tile.entries, results, strict=True)


def _store(folder: Path, manifest: Manifest, entry: ShardEntry, echoes: Echograms) -> None:
    data = encode(echoes, np.arange(*entry.sources), np.arange(*entry.listeners))
    needed = int(sum(v.nbytes for v in data.values()))
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise DatasetError(
            f"{folder}: {free / 1e6:.0f} MB are free, the next shard may need {needed / 1e6:.0f} MB; "
            "finished shards are safe, free some space and run again"
        )
    write_shard(
        folder / entry.file,
        data,
        {
            "key": _shard_key(manifest, entry),
            "scene": manifest.scene,
            "scene_digest": manifest.scene_digest,
            "config": json.dumps(msgspec.to_builtins(manifest.config)),
            "code_version": manifest.code_version,
            "seed": manifest.config.dataset.seed,
            "speed_of_sound": echoes.speed_of_sound,
            "licence": "",
            "citation": "soundspaces_sim; C. Chen et al., SoundSpaces, ECCV 2020",
        },
    )
