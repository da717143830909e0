"""Rates by the processor's time, which other work on the machine changes least."""

from __future__ import annotations

import time
from collections.abc import Callable


def per_second(run: Callable[[int], object], seconds: float = 3.0) -> float:
    """How often `run` (given a counter) goes in a second of the processor; the first call is not counted."""
    run(0)
    count, start = 0, time.process_time()
    while time.process_time() - start < seconds:
        count += 1
        run(count)
    return count / (time.process_time() - start)
