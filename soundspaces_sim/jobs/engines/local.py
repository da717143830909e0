"""Tiles one after the other in this process; each uses all of its threads."""

from __future__ import annotations

from soundspaces_sim.jobs.engines import BuildProgress, Progress
from soundspaces_sim.jobs.plan import Tile
from soundspaces_sim.jobs.record import Job
from soundspaces_sim.jobs.tile import build_tile


def run(job: Job, progress: Progress | None = None) -> int:
    """Make every tile of a job that is not there; the number of shards made."""
    tiles = job.plan.tiles
    total, done, built, rirs = sum(t.cost for t in tiles), 0, 0, 0

    def tell(stage: str, points: int, under_way: float = 0.0) -> None:
        if progress is not None:
            progress(BuildProgress(stage, points, total, rirs, under_way))

    for number, tile in enumerate(tiles):

        def traced(points: int, tile: Tile = tile, before: int = done) -> None:
            tell("Simulating", before + points, tile.pairs * points / tile.cost)

        made = build_tile(job, number, traced)
        built += made
        rirs += tile.pairs if made else 0
        done += tile.cost
        tell("Stored", done)
    return built
