"""State of other processes of this machine."""

from __future__ import annotations

from soundspaces_sim.core.platforms import process_runs


def is_running(process: int) -> bool:
    """Whether a process of this machine exists and has not ended; a zombie has ended."""
    return process_runs(process)
