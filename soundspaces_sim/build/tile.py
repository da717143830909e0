"""Tiles of a job: make what is missing of its shards.

Idempotent: the shards of a tile have the same bytes on every machine and in every run, and those that are
there and whole are left alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from soundspaces_sim.build.job_file import Job
from soundspaces_sim.build.plan import Span, echogram_entry, shard_attributes, shard_key
from soundspaces_sim.build.square import Square, squares
from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.interrupts import check
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.core.numerics.kernel import at_once, thread_count
from soundspaces_sim.core.numerics.threads import renderer_count
from soundspaces_sim.core.profile import here, stage, working_in
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.manifest import ShardEntry
from soundspaces_sim.dataset.format.shard import is_valid
from soundspaces_sim.dataset.format.writing import encode_echograms, encode_waveforms
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.rendering.ambisonics import pair_seed
from soundspaces_sim.rendering.binaural import binaural_rirs
from soundspaces_sim.rendering.renderers import find_renderer
from soundspaces_sim.transport.integrator import Progress
from soundspaces_sim.transport.simulate import simulate_pairs


def build_tiles(
    job: Job, numbers: Sequence[int], progress: Progress | None = None, upcoming: Sequence[int] = ()
) -> dict[int, int]:
    """Make what is missing of tiles, those that can as one (`build.square`); by number how many shards that was.

    `progress` is told how many of the tiles' points are traced. `upcoming`: tiles that this process makes
    afterwards: what is traced serves them as well.
    """
    built, lacking = {}, {}
    for number in numbers:
        wanted = _wanted(job, number)
        if any(span.entries and span.source is None for span in wanted):
            lacking[number] = wanted
        else:
            built[number] = _publish(job, wanted)
    groups, later = squares(job.plan, [*lacking], job.side), squares(job.plan, upcoming, job.side)
    for k, square in enumerate(groups):
        for number, sources in _simulated(job, square, progress, [*groups[k + 1 :], *later]):
            wanted = [w._replace(source=s) for w, s in zip(lacking[number], sources, strict=True)]
            built[number] = _publish(job, wanted)
    return built


_THREADS = 4  # for each tile whose shards are encoded side by side: more would wait for HDF5


class _Wanted(NamedTuple):
    """Shards of a span that are to be made, and its echogram shard, where there is one."""

    span: Span
    entries: list[ShardEntry]
    source: Path | bytes | None


def _wanted(job: Job, number: int) -> list[_Wanted]:
    """What a tile lacks. Raises `DatasetError` if there is no such tile."""
    tiles = job.plan.tiles
    if not 0 <= number < len(tiles):
        raise DatasetError(
            f"{job.folder}: tile {number} is out of range: this job has 0 to {len(tiles) - 1}"
        )
    found = []
    for span in tiles[number].spans:
        stored = _stored_echograms(job, span)
        entries = [
            e
            for e in job.plan.entries(span)
            if (stored is None if e.form == "echogram" else missing(job, e))
        ]
        found.append(_Wanted(span, entries, stored))
    return found


def _publish(job: Job, wanted: Sequence[_Wanted]) -> int:
    """Write what a tile lacks, of echograms that are there; how many shards."""
    for span, entries, source in wanted:
        for entry in entries:
            assert source is not None
            if entry.form == "echogram":
                assert isinstance(source, bytes)
                publish(job.folder / entry.file, source)
            else:
                with stage("rendering"):
                    publish(job.folder / entry.file, _waveforms(job, span, entry, source))
    return sum(len(w.entries) for w in wanted)


def missing(job: Job, entry: ShardEntry, every_byte: bool = True) -> bool:
    """True unless the shard is there, whole, and what the plan asks for; without `every_byte`, a glance."""
    key = shard_key(job.plan.draft, entry)
    return not is_valid(job.folder / entry.file, entry.form, key, every_byte)


def _stored_echograms(job: Job, span: Span) -> Path | bytes | None:
    """The span's echogram shard, if it is there and whole."""
    entry = echogram_entry(span)
    return None if missing(job, entry) else job.folder / entry.file


def _simulated(
    job: Job, square: Square, progress: Progress | None, later: Sequence[Square]
) -> Iterator[tuple[int, list[bytes]]]:
    """The number of each tile of a square, and the echogram shards of its spans."""
    tiles = [job.plan.tiles[number] for number in square.numbers]
    a, b = square.points(job.points)
    kept = job.kept if later or job.keeps else None
    if kept is not None:
        kept.expect([(a, b), *(other.points(job.points) for other in later)])

    def told(traced: int) -> None:
        if progress is not None:  # a point counts once for each tile that it is in
            progress(traced * sum(tile.cost for tile in tiles) // square.cost)

    there, back = simulate_pairs(job.model, a, b, progress=told, kept=kept, waves=job.waves)
    together = max(thread_count() // _THREADS, 1)
    for first in range(0, len(tiles), together):
        some = slice(first, first + together)
        spans = [tile.spans for tile in tiles[some]]
        with stage("encoding"):
            each = (partial(_encoded, job, square, s, there, back) for s in itertools.chain(*spans))
            encoded = iter(at_once(*each))  # while one waits for HDF5's lock, others have the cores
        for number, of_tile in zip(square.numbers[some], spans, strict=True):
            yield number, [next(encoded) for _ in of_tile]


def _encoded(job: Job, square: Square, span: Span, there: Echograms, back: Echograms | None) -> bytes:
    """A span's echogram shard."""
    echoes = square.echograms(span, there, back)
    geodesic = job.geodesic[slice(*span[0]), slice(*span[1])]
    attributes = shard_attributes(job.plan.draft, echogram_entry(span))
    return encode_echograms(echoes, np.arange(*span[0]), np.arange(*span[1]), attributes, geodesic)


def _waveforms(job: Job, span: Span, entry: ShardEntry, source: Path | bytes) -> bytes:
    config = job.plan.draft.config.dataset
    shard = EchogramShard(source, job.plan.draft.config.simulation.air)
    make = find_renderer(config.renderer)
    turns = [(heading, 0.0, 0.0) for heading in config.headings]

    def render(s: int) -> list[tuple[np.ndarray, np.ndarray]]:
        check()
        echograms = [shard.echogram(s, l) for l in range(len(shard.listeners))]

        def one(l: int) -> tuple[np.ndarray, np.ndarray]:
            with working_in(rendering):
                seed = pair_seed(config.seed, span[0][0] + s, span[1][0] + l)
                field = make(echograms[l], config.rate, seed)
                none = np.empty((0, 2, field.shape[1]))
                return field, binaural_rirs(field, config.rate, turns) if turns else none

        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(one, range(len(echograms))))

    threads, rendering = renderer_count(thread_count()), here()
    rows = slice(entry.sources[0] - span[0][0], entry.sources[1] - span[0][0])
    attributes = shard_attributes(job.plan.draft, entry)
    try:
        return encode_waveforms(shard, rows, attributes, config.headings, config.sample_format, render)
    finally:
        shard.close()
