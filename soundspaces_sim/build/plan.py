"""What a job is going to make: tiles, shards, keys. Pure: no files, no kernels.

The points are cut into blocks; a tile is a pair of blocks (i <= j) and yields the shards i -> j and
j -> i. A shard's key covers all that decides its content, so a finished shard is recognised and skipped
and a rebuilt one has the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import msgspec
import numpy as np

from soundspaces_sim.core.config import DatasetConfig, JobConfig
from soundspaces_sim.core.numerics.target import code_target
from soundspaces_sim.core.version import __version__, commit
from soundspaces_sim.dataset.format.manifest import Manifest, ShardEntry
from soundspaces_sim.layout.records import WalkGraph
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.memory import tile_memory
from soundspaces_sim.transport.model import Model

_TILE_BYTES = 3.4e9  # working memory of a tile, of which tables by batch are .4e9
_THREADS = 2  # that the plan reckons with: it is the same on every machine
_TILE_MAX = 160  # so that tiles come often, and many workers have some
_LEAST_BLOCKS = 2  # three tiles, so that an interrupted job keeps something
_WAVEFORM_PAIRS = 1024  # in a shard: some 200 MB at 44.1 kHz

Range = tuple[int, int]  # points from, to (exclusive)
Span = tuple[Range, Range]  # sources, listeners


@dataclass(frozen=True)
class PointBlocks:
    """Two blocks of points, `a` and `b`, or one with itself."""

    a: Range
    b: Range

    @property
    def spans(self) -> list[Span]:
        """(sources, listeners) of the echograms that it yields, there and back."""
        return [(self.a, self.b)] if self.a == self.b else [(self.a, self.b), (self.b, self.a)]

    @property
    def pairs(self) -> int:
        """How many echograms it yields."""
        return sum((a[1] - a[0]) * (b[1] - b[0]) for a, b in self.spans)

    @property
    def cost(self) -> int:
        """Points whose subpaths it traces."""
        return self.a[1] - self.a[0] + (self.b[1] - self.b[0] if self.a != self.b else 0)


@dataclass(frozen=True)
class JobPlan:
    """A job: the manifest as it stands while the job runs, and how many points a block has."""

    draft: Manifest
    block: int

    @cached_property
    def tiles(self) -> tuple[PointBlocks, ...]:
        """The tiles, in order; a worker knows one by its number."""
        return make_tiles(len(self.draft.points), self.block)

    def entries(self, span: Span) -> list[ShardEntry]:
        """The manifest's shards of a span."""
        (first, last), listeners = span
        return [
            e for e in self.draft.shards if e.listeners == listeners and first <= e.sources[0] < last
        ]


def make_plan(
    scene: Scene,
    points: np.ndarray,
    graph: WalkGraph,
    model: Model,
    config: JobConfig,
    command: str = "",
    height: float | None = None,
) -> JobPlan:
    """The plan of all pairs of `points` (N, 3) m in a scene, prepared as `model`; `command` rebuilds it.
    `height`: of the points above the floor, m, if a grid made them."""
    block = block_size(len(points), model, config.dataset.tile)
    tiles = make_tiles(len(points), block)
    draft = Manifest(
        status="building",
        scene=scene.name,
        scene_digest=scene.digest,
        key=job_key(scene.digest, config, model.duration, points),
        code_version=__version__,
        code_commit=commit(),
        config=config,
        duration=model.duration,
        notes=(*scene.notes, *model.notes),
        points=tuple((float(x), float(y), float(z)) for x, y, z in points),
        command=command,
        nodes=tuple(int(n) for n in graph.nodes),
        edges=tuple((int(a), int(b)) for a, b in graph.edges),
        components=tuple(int(c) for c in graph.component),
        target=code_target(),
        height=height,
        shards=tuple(
            e for t in tiles for span in t.spans for e in _entries(span, config.dataset, block)
        ),
    )
    shards = tuple(msgspec.structs.replace(e, key=shard_key(draft, e)) for e in draft.shards)
    return JobPlan(msgspec.structs.replace(draft, shards=shards), block)


def block_size(points: int, model: Model, wanted: int | None = None) -> int:
    """Points per side of a tile: those `wanted`, or as many as memory allows, evenly shared."""
    if wanted is not None:
        return wanted
    largest = tile_memory(model, _THREADS).largest_side(_TILE_BYTES)
    return even_block(points, min(largest, _TILE_MAX))


def even_block(points: int, largest: int) -> int:
    """At most `largest` points, so that blocks of so many are of about one size."""
    blocks = max(-(-points // largest), _LEAST_BLOCKS)
    return max(-(-points // blocks), 1)


def make_tiles(points: int, block: int) -> tuple[PointBlocks, ...]:
    """Tiles of `block` points a side that cover all pairs of `points` points."""
    blocks = [(s, min(s + block, points)) for s in range(0, points, block)]
    return tuple(PointBlocks(a, b) for i, a in enumerate(blocks) for b in blocks[i:])


def echogram_entry(span: Span) -> ShardEntry:
    """The echogram shard of a span."""
    sources, listeners = span
    return ShardEntry(
        file=f"s{sources[0]:05d}_l{listeners[0]:05d}.h5", sources=sources, listeners=listeners
    )


def _entries(span: Span, config: DatasetConfig, block: int) -> list[ShardEntry]:
    """Shards of one span: echograms, and waveforms of some sources each."""
    sources, listeners = span
    found = [echogram_entry(span)] if config.store != "waveform" else []
    if config.store != "echogram":
        step = max(_WAVEFORM_PAIRS // block, 1)
        for first in range(sources[0], sources[1], step):
            name = f"w{first:05d}_l{listeners[0]:05d}.h5"
            rows = (first, min(first + step, sources[1]))
            found.append(ShardEntry(file=name, form="waveform", sources=rows, listeners=listeners))
    return found


def job_key(scene_digest: str, config: JobConfig, duration: float, points: np.ndarray) -> str:
    """Of all that decides the echograms. What is stored of them, and how, is no part of it."""
    sha = hashlib.sha256()
    content = {
        "simulation": msgspec.to_builtins(config.simulation),
        "seed": config.dataset.seed,
        "duration": duration,
        "code": __version__,
        "target": code_target(),
        "scene": scene_digest,
    }
    sha.update(json.dumps(content, sort_keys=True).encode())
    sha.update(np.ascontiguousarray(points, "<f8").tobytes())
    return sha.hexdigest()


def shard_key(manifest: Manifest, entry: ShardEntry) -> str:
    """Of all that decides a shard's bytes."""
    config = manifest.config.dataset
    content: list[Any] = [manifest.key, entry.sources, entry.listeners]
    content += [manifest.config.grid, manifest.config.graph]
    content += [config.licence, config.citation]
    if entry.form == "waveform":
        content += [config.rate, config.renderer, config.headings, config.sample_format]
    return hashlib.sha256(json.dumps(msgspec.to_builtins(content)).encode()).hexdigest()


def shard_attributes(manifest: Manifest, entry: ShardEntry) -> dict[str, Any]:
    """The attributes of a shard that say what it was made from."""
    config = manifest.config
    own = {}
    if entry.form == "waveform":
        own = {"rate": config.dataset.rate, "renderer": config.dataset.renderer}
    return {
        "key": shard_key(manifest, entry),
        "scene": manifest.scene,
        "scene_digest": manifest.scene_digest,
        "config": json.dumps(msgspec.to_builtins([config.grid, config.graph, config.simulation])),
        "code_version": manifest.code_version,
        "seed": config.dataset.seed,
        "speed_of_sound": config.simulation.c,
        "licence": config.dataset.licence,
        "citation": config.dataset.citation,
        **own,
    }
