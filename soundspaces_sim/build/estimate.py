"""How long a job may take and how much it will store, from a few of its pairs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soundspaces_sim.build.engines.capacity import choose_shape
from soundspaces_sim.build.job_file import Job
from soundspaces_sim.build.plan import PointBlocks, echogram_entry, shard_attributes
from soundspaces_sim.build.square import Square, squares
from soundspaces_sim.build.tile import missing
from soundspaces_sim.core.memory import free_memory
from soundspaces_sim.core.numerics.kernel import thread_count
from soundspaces_sim.core.profile import Stage, profiled, stage
from soundspaces_sim.dataset.format.low import stored_bytes
from soundspaces_sim.dataset.format.writing import encode_echograms
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.radiance_transfer.prepared import late_decay
from soundspaces_sim.transport.simulate import simulate_rays

_ENCODING = "encoding"
#: Stages that work on pairs; in all others it is points.
_OF_PAIRS = (
    "arrivals", "connections", "products", "products by batch", "energy by batch", "echograms and error bars",
    "smoothing", _ENCODING,
)  # fmt: skip
_LEAST, _MOST = 8, 16  # points of the larger of two tiles that are timed; the other has a fourth
_SHARE = 10  # of a job's points in it, one in so many, but for small jobs
BUDGET_S = 40.0  # for a tile that is timed: one of few points alone says too much, by up to four times
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
    """A tile of k points costs `subpaths` k + `pair` k² seconds at most, and `fixed` + `point` k + `least_pair` k²
    at least, with the threads it was measured with: two tiles tell neither what is every tile's from what is its
    points', nor, in the stages that work on pairs, that from what is the pairs'. The two differ little where large
    tiles were timed. A pair stores `stored` bytes. Rendering of waveforms is not in it, nor are the transfer
    subpaths, which all points share."""

    subpaths: float
    pair: float
    fixed: float
    point: float
    least_pair: float
    stored: float
    waves: float  # seconds of a point's run below an edge
    measured: tuple[int, ...]  # points of the one or two tiles that it comes from

    def seconds(self, tile: PointBlocks | Square) -> float:
        """Of a whole tile, or several as one: at most."""
        return (self.subpaths + self.waves) * tile.cost + self.pair * tile.pairs

    def least_seconds(self, tile: PointBlocks | Square) -> float:
        """The same, at least."""
        least = self.fixed + (self.point + self.waves) * tile.cost + self.least_pair * tile.pairs
        return min(least, self.seconds(tile))


def estimate(job: Job, tell: Callable[[int], None] | None = None) -> Estimate:
    """Measure a few pairs of a job, chosen over all its points; `tell` as `measure` has it.

    The larger tile has at most a tenth of the points, but `_LEAST`; where that is more than half: nan seconds.
    """
    draft = job.plan.draft
    count = len(draft.points)
    left = [n for n, tile in enumerate(job.plan.tiles) if _lacks(job, tile)]
    most = min(_MOST, max(count // _SHARE, _LEAST))
    if most > count // 2 or not left:
        return Estimate(count, count**2, draft.duration, 0, float("nan"))
    threads = thread_count()
    # Processor time, for the clock on the wall also tells what else the machine does during a short measurement.
    cost = measure(job, (most // 4, most), BUDGET_S, lambda: time.process_time() / threads, tell)
    shape = choose_shape(threads, free_memory(), len(left))
    parts: Sequence[PointBlocks | Square] = [job.plan.tiles[n] for n in left]
    if shape.processes == 1:  # which simulates tiles as one
        parts = squares(job.plan, left, job.side)
    seconds = sum(0.5 * (cost.least_seconds(part) + cost.seconds(part)) for part in parts)
    return Estimate(count, count**2, draft.duration, int(count**2 * cost.stored), seconds)


def load_shared(model: Model) -> None:
    """Trace, or read, what all points share: once, for all tiles."""
    if len(model.world.patches.weight):
        model.once(late_decay)


def measure(
    job: Job,
    sizes: Sequence[int],
    budget_s: float,
    clock: Callable[[], float] = time.perf_counter,
    tell: Callable[[int], None] | None = None,
) -> Cost:
    """Time tiles of some `sizes` (points, ascending) by a clock, and look at what they would store.

    The first is made twice, unless it takes more than `budget_s`: kernels are loaded with it, and what all points
    share is made. A tile is left out, with all larger ones, if by the numbers of its points and pairs it should
    take more than `budget_s`; so the work is at most the transfer subpaths, a tile of `sizes[0]` points, and what
    fits into the budget for each size and once more. `tell` is told of the number of points before each.
    """
    load_shared(job.model)
    done = [_timed(job, sizes[0], clock, tell)]
    if done[0].seconds <= budget_s:
        done = [_timed(job, sizes[0], clock, tell)]
    for k in sizes[1:]:
        some, more = done[-1], k / done[-1].points
        if more * (some.seconds - some.of_pairs) + more**2 * some.of_pairs > budget_s:
            break
        done.append(_timed(job, k, clock, tell))
    return _cost(job, done, _waves_seconds(job, clock))


def _waves_seconds(job: Job, clock: Callable[[], float]) -> float:
    """Of a point's run, to which all points listen; what is run is kept for the job."""
    if job.waves is None:
        return 0.0
    few = job.points[: job.waves.sources]
    start = clock()
    job.waves.responses(few, few)
    return (clock() - start) / job.waves.sources


def _cost(job: Job, done: Sequence[_Timed], waves: float = 0.0) -> Cost:
    """From the last two of the tiles that were timed, or the only one."""
    some = done[-1]
    subpaths = (some.seconds - some.of_pairs) / some.points
    pair = some.of_pairs / some.points**2
    if len(done) == 1:
        stored = _bytes_per_pair(job, some.bytes / some.points**2)
        return Cost(subpaths, pair, some.seconds, 0.0, 0.0, stored, waves, (some.points,))
    few = done[-2]
    grown = some.of_pairs / some.points - few.of_pairs / few.points
    least_pair = min(max(grown / (some.points - few.points), 0.0), pair)
    rest = [t.seconds - least_pair * t.points**2 for t in (few, some)]
    point = max((rest[1] - rest[0]) / (some.points - few.points), 0.0)
    # a file's head weighs nothing in a large one
    stored = (some.bytes - few.bytes) / (some.points**2 - few.points**2)
    return Cost(
        subpaths,
        pair,
        rest[1] - point * some.points,
        point,
        least_pair,
        _bytes_per_pair(job, stored),
        waves,
        (few.points, some.points),
    )


class _Timed(NamedTuple):
    points: int
    seconds: float
    of_pairs: float  # of them, in stages that work on pairs
    bytes: int


def _timed(
    job: Job, points: int, clock: Callable[[], float], tell: Callable[[int], None] | None
) -> _Timed:
    """A tile of so many points, spread over the job's."""
    if tell is not None:
        tell(points)
    draft, rows = job.plan.draft, np.arange(points)
    chosen = job.points[np.linspace(0, len(draft.points) - 1, points).astype(int)]
    start = clock()
    with profiled(f"{points} points") as found:
        echoes, _ = simulate_rays(job.model, chosen, None)
        attributes = shard_attributes(draft, echogram_entry(((0, points), (0, points))))
        with stage(_ENCODING):
            size = len(encode_echograms(echoes, rows, rows, attributes))
    seconds, whole = clock() - start, found.stage
    return _Timed(points, seconds, seconds * _of_pairs(whole) / max(whole.total, 1e-9), size)


def _of_pairs(of: Stage) -> float:
    """Processor seconds of a stage, and of those within, that grow with the number of pairs."""
    return of.total if of.name in _OF_PAIRS else sum(_of_pairs(inner) for inner in of.stages)


def sum_estimates(parts: Sequence[Estimate]) -> Estimate:
    """Of several jobs together; `duration` is the longest."""
    return Estimate(
        sum(e.points for e in parts),
        sum(e.pairs for e in parts),
        max(e.duration for e in parts),
        sum(e.bytes for e in parts),
        sum(e.seconds for e in parts),
    )


def _lacks(job: Job, tile: PointBlocks) -> bool:
    entries = [e for span in tile.spans for e in job.plan.entries(span)]
    return any(missing(job, e, every_byte=False) for e in entries)


def _bytes_per_pair(job: Job, echogram: float) -> float:
    """Of all forms that the job stores."""
    config = job.plan.draft.config.dataset
    samples = job.plan.draft.duration * config.rate * (9 + 2 * len(config.headings))
    waveform = samples * (2.0 * _PACKED if config.sample_format == "int16" else 4.0 * 0.9)
    echogram += stored_bytes(job.waves.samples) if job.waves is not None else 0.0
    return (config.store != "waveform") * echogram + (config.store != "echogram") * waveform
