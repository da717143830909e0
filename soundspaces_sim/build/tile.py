"""One tile of a job: make what is missing of its shards.

Idempotent: the shards of a tile have the same bytes on every machine and in every run, and those that are
there and whole are left alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from soundspaces_sim.build.job_file import Job, open_job
from soundspaces_sim.build.plan import PointBlocks, Span, echogram_entry, shard_attributes, shard_key
from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.interrupts import check
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.core.numerics.kernel import thread_count
from soundspaces_sim.core.profile import here, stage, working_in
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.manifest import ShardEntry
from soundspaces_sim.dataset.format.shard import is_valid
from soundspaces_sim.dataset.format.writing import encode_echograms, encode_waveforms
from soundspaces_sim.rendering.ambisonics import pair_seed
from soundspaces_sim.rendering.binaural import binaural_rirs
from soundspaces_sim.rendering.renderers import find_renderer
from soundspaces_sim.transport.integrator import Progress
from soundspaces_sim.transport.simulate import simulate_pairs


def run_tile(folder: str | Path, number: int) -> int:
    """Make a tile of the job in `folder`, in any process on any machine; how many shards were missing.

    Raises `DatasetError` if there is no such job, tile, or place to write to.
    """
    return build_tile(open_job(folder), number)


def build_tile(
    job: Job, number: int, progress: Progress | None = None, upcoming: Sequence[int] = ()
) -> int:
    """`run_tile` for those who hold the job. `progress` is told how many of the tile's points are traced.
    `upcoming`: tiles that this process makes afterwards: what is traced serves them as well."""
    tiles = job.plan.tiles
    if not 0 <= number < len(tiles):
        raise DatasetError(
            f"{job.folder}: tile {number} is out of range: this job has 0 to {len(tiles) - 1}"
        )
    tile = tiles[number]
    sources = [_stored_echograms(job, span) for span in tile.spans]
    wanted = [
        [
            e
            for e in job.plan.entries(span)
            if (stored is None if e.form == "echogram" else missing(job, e))
        ]
        for span, stored in zip(tile.spans, sources, strict=True)
    ]
    if any(w and source is None for w, source in zip(wanted, sources, strict=True)):
        sources = [*_simulated(job, tile, progress, [tiles[n] for n in upcoming])]
    built = 0
    for span, entries, source in zip(tile.spans, wanted, sources, strict=True):
        for entry in entries:
            assert source is not None
            if entry.form == "echogram":
                assert isinstance(source, bytes)
                publish(job.folder / entry.file, source)
            else:
                with stage("rendering"):
                    publish(job.folder / entry.file, _waveforms(job, span, entry, source))
            built += 1
    return built


def missing(job: Job, entry: ShardEntry, every_byte: bool = True) -> bool:
    """True unless the shard is there, whole, and what the plan asks for; without `every_byte`, a glance."""
    key = shard_key(job.plan.draft, entry)
    return not is_valid(job.folder / entry.file, entry.form, key, every_byte)


def _stored_echograms(job: Job, span: Span) -> Path | bytes | None:
    """The span's echogram shard, if it is there and whole."""
    entry = echogram_entry(span)
    return None if missing(job, entry) else job.folder / entry.file


def _simulated(
    job: Job, tile: PointBlocks, progress: Progress | None, upcoming: Sequence[PointBlocks]
) -> list[bytes]:
    """The echogram shards of a tile's spans."""
    a, b = job.blocks(tile)
    kept = job.kept if upcoming or job.keeps else None
    if kept is not None:
        kept.expect([(a, b), *map(job.blocks, upcoming)])
    out = []
    for span, echoes in zip(
        tile.spans, simulate_pairs(job.model, a, b, progress=progress, kept=kept), strict=False
    ):
        assert echoes is not None
        geodesic = job.geodesic[slice(*span[0]), slice(*span[1])]
        attributes = shard_attributes(job.plan.draft, echogram_entry(span))
        with stage("encoding"):
            rows, columns = np.arange(*span[0]), np.arange(*span[1])
            out.append(encode_echograms(echoes, rows, columns, attributes, geodesic))
    return out


def _waveforms(job: Job, span: Span, entry: ShardEntry, source: Path | bytes) -> bytes:
    config = job.plan.draft.config.dataset
    shard = EchogramShard(source, job.plan.draft.config.simulation.air_within_bands)
    make = find_renderer(config.renderer)
    turns = [(heading, 0.0, 0.0) for heading in config.headings]

    def render(s: int) -> list[tuple[np.ndarray, np.ndarray]]:
        check()
        echograms = [shard.echogram(s, l) for l in range(len(shard.listeners))]

        def one(l: int) -> tuple[np.ndarray, np.ndarray]:
            with working_in(rendering):
                return render_pair(l)

        def render_pair(l: int) -> tuple[np.ndarray, np.ndarray]:
            seed = pair_seed(config.seed, span[0][0] + s, span[1][0] + l)
            field = make(echograms[l], config.rate, seed)
            ears = (
                binaural_rirs(field, config.rate, turns) if turns else np.empty((0, 2, field.shape[1]))
            )
            return field, ears

        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(one, range(len(echograms))))

    threads, rendering = thread_count(), here()  # as many as the tracer was given
    rows = slice(entry.sources[0] - span[0][0], entry.sources[1] - span[0][0])
    attributes = shard_attributes(job.plan.draft, entry)
    try:
        return encode_waveforms(shard, rows, attributes, config.headings, config.sample_format, render)
    finally:
        shard.close()
