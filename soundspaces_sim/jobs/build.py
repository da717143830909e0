"""The job behind `make rirs`: grid, tiles, shards, manifest. Resumable and idempotent.

The points are cut into blocks; a tile is a pair of blocks (i <= j) and yields the shards i -> j and
j -> i. A shard's key covers all that decides its content, so a finished shard is recognised and skipped
and a rebuilt one has the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from soundspaces_sim.base.config import DatasetConfig, JobConfig
from soundspaces_sim.base.errors import ConfigError, DatasetError
from soundspaces_sim.base.files import file_sha256, publish, remove_stale
from soundspaces_sim.base.kernel import set_thread_count
from soundspaces_sim.places.floorplan import make_floorplan
from soundspaces_sim.places.graph import make_graph
from soundspaces_sim.places.grid import grid_at, make_grid
from soundspaces_sim.places.records import Grid, WalkGraph
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.sound.ambisonics import ambisonic_rir, pair_seed
from soundspaces_sim.sound.binaural import binaural_rirs
from soundspaces_sim.sound.seed_paper import paper_rir
from soundspaces_sim.storage.echogram_shard import EchogramShard, encode_echograms
from soundspaces_sim.storage.floorplan import NAME as FLOORPLAN
from soundspaces_sim.storage.floorplan import encode_floorplan
from soundspaces_sim.storage.manifest import NAME, Manifest, ShardEntry, read_manifest, write_manifest
from soundspaces_sim.storage.shard import is_valid
from soundspaces_sim.storage.waveform_shard import encode_waveforms
from soundspaces_sim.transport.model import Model, make_model
from soundspaces_sim.transport.simulate import as_points, simulate_pairs
from soundspaces_sim.version import __version__

_TILE_BYTES = 1.5e9  # working memory of a tile
_TILE_MAX = 96
_LEAST_TILES = 3  # blocks at least, so that an interrupted job keeps something
_WAVEFORM_PAIRS = 1024  # in a shard: some 200 MB at 44.1 kHz


@dataclass(frozen=True)
class BuildProgress:
    """`done` of `total` points traced (a point counts once per tile it is in); `rirs` finished in this run."""

    stage: str
    done: int
    total: int
    rirs: int


Progress = Callable[[BuildProgress], None]


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
    def spans(self) -> list[tuple[tuple[int, int], tuple[int, int]]]:
        """(sources, listeners) of the echograms that it yields, there and back."""
        return [(self.a, self.b)] if self.a == self.b else [(self.a, self.b), (self.b, self.a)]

    @property
    def pairs(self) -> int:
        return sum((a[1] - a[0]) * (b[1] - b[0]) for a, b in self.spans)

    @property
    def cost(self) -> int:
        """Points whose walks it traces."""
        return self.a[1] - self.a[0] + (self.b[1] - self.b[0] if self.a != self.b else 0)


def _entries(
    sources: tuple[int, int], listeners: tuple[int, int], config: DatasetConfig, tile: int
) -> list[ShardEntry]:
    """Shards of one span: echograms, and waveforms of some sources each."""
    end = f"{sources[0]:05d}_l{listeners[0]:05d}.h5"
    found = []
    if config.store != "waveform":
        found.append(ShardEntry(file=f"s{end}", sources=sources, listeners=listeners))
    if config.store != "echogram":
        step = max(_WAVEFORM_PAIRS // tile, 1)
        for first in range(sources[0], sources[1], step):
            name = f"w{first:05d}_l{listeners[0]:05d}.h5"
            rows = (first, min(first + step, sources[1]))
            found.append(ShardEntry(file=name, form="waveform", sources=rows, listeners=listeners))
    return found


def build_dataset(
    scene: Scene,
    out: str | Path,
    config: JobConfig | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
    points: np.ndarray | None = None,
    command: str = "",
) -> BuildResult:
    """Simulate all pairs of a scene's grid into `out`/<scene name>/; goes on where it was stopped.

    `jobs`: threads. `points` (N, 3) m: these instead of a grid. `command`: what rebuilds the dataset.
    Raises `SceneError` if no point survives, `PointError` for points outside, `DatasetError` if the
    folder holds a dataset made from something else or cannot be written.
    """
    config = config or JobConfig()
    _set_threads(jobs)
    folder = Path(out) / scene.name
    if points is None:
        grid = make_grid(scene, config=config.grid)
    else:
        grid = grid_at(scene, as_points(points, "points"), config.grid)
    graph = make_graph(scene, grid, config.graph)
    model = make_model(scene, grid.points, config.simulation, config.dataset.seed)
    tiles = plan_tiles(len(grid.points), model, config.dataset.tile)
    draft = _draft(scene, config, grid, graph, model, tiles, command)
    if _already_complete(folder, draft):
        return BuildResult(folder, read_manifest(folder), 0, len(draft.shards))
    _open_folder(folder, draft)
    publish(folder / FLOORPLAN, encode_floorplan(make_floorplan(scene, grid)))
    job = _Job(folder, draft, model, grid.points, graph.geodesic)
    total, done, built, rirs = sum(t.cost for t in tiles), 0, 0, 0
    for tile in tiles:

        def report(points: int, stage: str = "Simulating", before: int = done, rirs: int = rirs) -> None:
            if progress is not None:
                progress(BuildProgress(stage, before + points, total, rirs))

        made = _build_tile(job, tile, report)
        built += made
        rirs += tile.pairs if made else 0
        done += tile.cost
        report(0, "Stored", done, rirs)
    entries = tuple(
        msgspec.structs.replace(
            e, bytes=(folder / e.file).stat().st_size, sha256=file_sha256(folder / e.file)
        )
        for e in draft.shards
    )
    manifest = msgspec.structs.replace(draft, status="complete", shards=entries)
    write_manifest(folder, manifest)
    return BuildResult(folder, manifest, built, len(entries))


def _draft(
    scene: Scene, config: JobConfig, grid: Grid, graph: WalkGraph, model: Model, tiles: list[_Tile],
    command: str,
) -> Manifest:  # fmt: skip
    size = tiles[0].a[1] - tiles[0].a[0]
    return Manifest(
        status="building",
        scene=scene.name,
        scene_digest=scene.digest,
        key=_job_key(model, config, grid.points),
        code_version=__version__,
        config=config,
        duration=model.duration,
        notes=scene.notes,
        points=tuple((float(x), float(y), float(z)) for x, y, z in grid.points),
        command=command,
        nodes=tuple(int(n) for n in graph.nodes),
        edges=tuple((int(a), int(b)) for a, b in graph.edges),
        components=tuple(int(c) for c in graph.component),
        shards=tuple(
            e for t in tiles for span in t.spans for e in _entries(*span, config.dataset, size)
        ),
    )


def _open_folder(folder: Path, draft: Manifest) -> None:
    """Make the folder, or take over one whose job was interrupted or stored less."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(
            f"{folder}: cannot make this folder ({error.strerror}); choose another OUT"
        ) from error
    remove_stale(folder)
    write_manifest(folder, draft)


def _set_threads(jobs: int | None) -> None:
    most = os.cpu_count() or 1
    if jobs is None:
        return
    if not 1 <= jobs <= most:
        raise ConfigError(f"jobs: expected 1 to {most} (the cores of this machine), got {jobs}")
    set_thread_count(jobs)


def plan_tiles(points: int, model: Model, tile: int | None) -> list[_Tile]:
    """Tiles that cover all pairs of `points` points; `tile` points per side, or as memory allows."""
    if tile is None:
        bins, bands = len(model.time_edges) - 1, len(model.config.bands) - 1
        bytes_per_pair = 4 * bins * 9 * bands * 4  # two tables each way, float32
        largest = int(min(np.sqrt(_TILE_BYTES / bytes_per_pair), _TILE_MAX))
        tile = max(min(largest, int(np.ceil(points / _LEAST_TILES))), 1)
    starts = list(range(0, points, tile))
    blocks = [(s, min(s + tile, points)) for s in starts]
    return [_Tile(a, b) for i, a in enumerate(blocks) for b in blocks[i:]]


def _job_key(model: Model, config: JobConfig, points: np.ndarray) -> str:
    """Of all that decides the echograms. What is stored of them, and how, is no part of it."""
    sha = hashlib.sha256()
    content = {
        "simulation": msgspec.to_builtins(config.simulation),
        "seed": config.dataset.seed,
        "duration": model.duration,
        "code": __version__,
        "scene": model.scene.digest,
    }
    sha.update(json.dumps(content, sort_keys=True).encode())
    sha.update(np.ascontiguousarray(points, "<f8").tobytes())
    return sha.hexdigest()


def _shard_key(manifest: Manifest, entry: ShardEntry) -> str:
    config = manifest.config.dataset
    content: list[Any] = [manifest.key, entry.sources, entry.listeners]
    content += [manifest.config.grid, manifest.config.graph]
    content += [config.licence, config.citation]
    if entry.form == "waveform":
        content += [config.rate, config.renderer, config.headings, config.sample_format]
    return hashlib.sha256(json.dumps(msgspec.to_builtins(content)).encode()).hexdigest()


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
    if not found.complete or found.config != draft.config:
        return False
    return all(
        (folder / e.file).is_file() and (folder / e.file).stat().st_size == e.bytes for e in found.shards
    )


@dataclass(frozen=True)
class _Job:
    """What every tile needs."""

    folder: Path
    manifest: Manifest
    model: Model
    points: np.ndarray
    geodesic: np.ndarray

    def attributes(self, entry: ShardEntry) -> dict[str, Any]:
        manifest = self.manifest
        config = manifest.config.dataset
        own = {"rate": config.rate, "renderer": config.renderer} if entry.form == "waveform" else {}
        return {
            "key": _shard_key(manifest, entry),
            "scene": manifest.scene,
            "scene_digest": manifest.scene_digest,
            "config": json.dumps(
                msgspec.to_builtins(
                    [manifest.config.grid, manifest.config.graph, manifest.config.simulation]
                )
            ),
            "code_version": manifest.code_version,
            "seed": config.seed,
            "speed_of_sound": manifest.config.simulation.c,
            "licence": config.licence,
            "citation": config.citation,
            **own,
        }

    def entries(self, span: tuple[tuple[int, int], tuple[int, int]]) -> list[ShardEntry]:
        """The manifest's shards of a span."""
        (first, last), listeners = span
        shards = self.manifest.shards
        return [e for e in shards if e.listeners == listeners and first <= e.sources[0] < last]

    def missing(self, entry: ShardEntry) -> bool:
        return not is_valid(self.folder / entry.file, entry.form, _shard_key(self.manifest, entry))


def _build_tile(job: _Job, tile: _Tile, report: Callable[..., None]) -> int:
    """Make what is missing of a tile; the number of shards made."""
    sources = [_stored_echograms(job, span) for span in tile.spans]
    wanted = [
        [e for e in job.entries(span) if (stored is None if e.form == "echogram" else job.missing(e))]
        for span, stored in zip(tile.spans, sources, strict=True)
    ]
    if any(w and source is None for w, source in zip(wanted, sources, strict=True)):
        a = job.points[slice(*tile.a)]
        b = None if tile.a == tile.b else job.points[slice(*tile.b)]
        for i, (span, echoes) in enumerate(
            zip(tile.spans, simulate_pairs(job.model, a, b, progress=report), strict=False)
        ):
            if echoes is None:
                continue
            entry = ShardEntry(file="", sources=span[0], listeners=span[1])
            geodesic = job.geodesic[slice(*span[0]), slice(*span[1])]
            sources[i] = encode_echograms(
                echoes, np.arange(*span[0]), np.arange(*span[1]), job.attributes(entry), geodesic
            )
    built = 0
    for span, entries, source in zip(tile.spans, wanted, sources, strict=True):
        for entry in entries:
            assert source is not None
            if entry.form == "echogram":
                assert isinstance(source, bytes)
                publish(job.folder / entry.file, source)
            else:
                publish(job.folder / entry.file, _waveforms(job, span, entry, source))
            built += 1
    return built


def _stored_echograms(job: _Job, span: tuple[tuple[int, int], tuple[int, int]]) -> Path | bytes | None:
    """The span's echogram shard, if it is there and whole."""
    name = f"s{span[0][0]:05d}_l{span[1][0]:05d}.h5"
    entry = ShardEntry(file=name, sources=span[0], listeners=span[1])
    return None if job.missing(entry) else job.folder / name


def _waveforms(
    job: _Job, span: tuple[tuple[int, int], tuple[int, int]], entry: ShardEntry, source: Path | bytes
) -> bytes:
    config = job.manifest.config.dataset
    shard = EchogramShard(source)
    make = paper_rir if config.renderer == "paper" else ambisonic_rir
    turns = [(heading, 0.0, 0.0) for heading in config.headings]

    def render(s: int) -> list[tuple[np.ndarray, np.ndarray]]:
        echograms = [shard.echogram(s, l) for l in range(len(shard.listeners))]

        def one(l: int) -> tuple[np.ndarray, np.ndarray]:
            seed = pair_seed(config.seed, span[0][0] + s, span[1][0] + l)
            field = make(echograms[l], config.rate, seed)
            ears = (
                binaural_rirs(field, config.rate, turns) if turns else np.empty((0, 2, field.shape[1]))
            )
            return field, ears

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            return list(pool.map(one, range(len(echograms))))

    rows = slice(entry.sources[0] - span[0][0], entry.sources[1] - span[0][0])
    try:
        return encode_waveforms(
            shard, rows, job.attributes(entry), config.headings, config.sample_format, render
        )
    finally:
        shard.close()
