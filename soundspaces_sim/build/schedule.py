"""In which order the tiles of a job are done, and which of them are whose. The order changes no byte."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from soundspaces_sim.build.engines import Task
from soundspaces_sim.build.plan import JobPlan
from soundspaces_sim.core.errors import ConfigError


def in_order(plans: Mapping[Path, JobPlan]) -> list[Task]:
    """All tiles of some folders' jobs, the longest first, so that none is left for the end alone.

    Of tiles that take about as long (within a factor of two) those of one scene follow each other: a worker
    prepares a scene when it meets it.
    """
    tasks = [
        Task(folder, number, tile.cost * plan.draft.duration)
        for folder, plan in plans.items()
        for number, tile in enumerate(plan.tiles)
    ]
    rank = {folder: k for k, folder in enumerate(plans)}
    return sorted(tasks, key=lambda t: (-round(math.log2(t.cost)), rank[t.folder], -t.cost, t.number))


def share_of(tasks: Sequence[Task], share: tuple[int, int] | None) -> list[Task]:
    """Share k of n (from 1) of tasks in order, each n-th; None: all. Raises `ConfigError`."""
    if share is None:
        return list(tasks)
    k, n = share
    if not 1 <= k <= n:
        raise ConfigError(f"tiles: expected share k/n with 1 <= k <= n, got {k}/{n}")
    return list(tasks[k - 1 :: n])
