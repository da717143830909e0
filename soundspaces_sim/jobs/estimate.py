"""How long a job may take and how much it will store, from a few of its pairs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from soundspaces_sim.jobs.plan import Tile, echogram_entry, shard_attributes
from soundspaces_sim.jobs.record import Job
from soundspaces_sim.jobs.tile import missing
from soundspaces_sim.storage.writing import encode_echograms
from soundspaces_sim.transport.simulate import simulate_pairs

_FEW, _SOME = 3, 9  # points of the two tiles that are timed
_PACKED = 0.8  # of int16 noise, after compression


@dataclass(frozen=True)
class Estimate:
    """Of a whole job: `points`, `pairs`, `duration` s of an echogram, `bytes` on disk. Of what is left of it:
    `seconds` on this machine, if all is done here."""

    points: int
    pairs: int
    duration: float
    bytes: int
    seconds: float


@dataclass(frozen=True)
class Cost:
    """A tile of k points costs `walks` k + `pair` k^2 seconds, with the threads it was measured with; a pair
    stores `stored` bytes. Rendering of waveforms is not in it."""

    walks: float
    pair: float
    stored: float

    def seconds(self, tile: Tile) -> float:
        """Of a whole tile."""
        return self.walks * tile.cost + self.pair * tile.pairs


def estimate(job: Job) -> Estimate:
    """Measure a few pairs of a job, chosen over all its points.

    Jobs of fewer points than twice those measured are not measured: nan seconds.
    """
    draft = job.plan.draft
    count = len(draft.points)
    left = [t for t in job.plan.tiles if _lacks(job, t)]
    if count < 2 * _SOME or not left:
        return Estimate(count, count**2, draft.duration, 0, float("nan"))
    cost = measure(job, _FEW, _SOME)
    seconds = sum(cost.seconds(t) for t in left)
    return Estimate(count, count**2, draft.duration, int(count**2 * cost.stored), seconds)


def measure(job: Job, few: int, some: int, clock: Callable[[], float] = time.perf_counter) -> Cost:
    """Time tiles of `few` and of `some` points by a clock, and look at what they would store."""
    draft = job.plan.draft
    times, sizes = [], []
    for k in (few, few, some):  # the first one loads kernels
        chosen = job.points[np.linspace(0, len(draft.points) - 1, k).astype(int)]
        start = clock()
        echoes, _ = simulate_pairs(job.model, chosen, None)
        rows = np.arange(k)
        attributes = shard_attributes(draft, echogram_entry(((0, k), (0, k))))
        sizes.append(len(encode_echograms(echoes, rows, rows, attributes)))
        times.append(clock() - start)
    pair = max((times[2] - times[1] * some / few) / (some * (some - few)), 0.0)
    walks = max(times[2] / some - pair * some, 0.0)
    stored = (sizes[2] - sizes[1]) / (some**2 - few**2)  # a file's head weighs nothing in a large one
    return Cost(walks, pair, _bytes_per_pair(job, stored))


def sum_estimates(parts: Sequence[Estimate]) -> Estimate:
    """Of several jobs together; `duration` is the longest."""
    return Estimate(
        sum(e.points for e in parts), sum(e.pairs for e in parts), max(e.duration for e in parts),
        sum(e.bytes for e in parts), sum(e.seconds for e in parts),
    )  # fmt: skip


def _lacks(job: Job, tile: Tile) -> bool:
    entries = [e for span in tile.spans for e in job.plan.entries(span)]
    return any(missing(job, e, every_byte=False) for e in entries)


def _bytes_per_pair(job: Job, echogram: float) -> float:
    """Of all forms that the job stores."""
    config = job.plan.draft.config.dataset
    samples = job.plan.draft.duration * config.rate * (9 + 2 * len(config.headings))
    waveform = samples * (2.0 * _PACKED if config.sample_format == "int16" else 4.0 * 0.9)
    return (config.store != "waveform") * echogram + (config.store != "echogram") * waveform
