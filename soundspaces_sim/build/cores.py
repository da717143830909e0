"""How many cores of this machine a job uses."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count
from soundspaces_sim.core.numerics.threads import core_count

_log = logging.getLogger(__name__)


@contextmanager
def use_cores(jobs: int | None) -> Iterator[int]:
    """Let kernels use `jobs` cores for a while, or as many as there are if it asks for more; how many."""
    before, most = thread_count(), core_count()
    if jobs is not None and jobs < 1:
        raise ConfigError(f"jobs: expected 1 to {most} (the cores of this machine), got {jobs}")
    if jobs is not None and jobs > most:
        _log.info("%d jobs were asked for; this machine has %d cores, so %d it is", jobs, most, most)
    set_thread_count(before if jobs is None else min(jobs, most))
    try:
        yield thread_count()
    finally:
        set_thread_count(before)
