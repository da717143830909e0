"""Memory that is left, and refusals of what needs more."""

from __future__ import annotations

import os
from pathlib import Path

from soundspaces_sim.core.errors import ConfigError

_LIMITS = ("memory.max", "memory/memory.limit_in_bytes")  # of control groups, version 2 and 1


def free_memory(root: Path = Path("/sys/fs/cgroup")) -> float:
    """Bytes that this process may still take: those of the machine, or of its control group if fewer."""
    free = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        (line,) = (line for line in lines if line.startswith("MemAvailable:"))
        free = int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass  # not Linux: all of the machine's memory
    for name in _LIMITS:
        try:
            free = min(free, int((root / name).read_text(encoding="ascii")))
        except (OSError, ValueError):
            continue  # no such group, or "max"
    return float(free)


def check_memory(wanted: float, what: str) -> None:
    """Raise `ConfigError` if `what` needs more bytes, `wanted`, than are free."""
    free = free_memory()
    if not wanted <= free:
        raise ConfigError(
            f"{what}: {wanted / 1e9:.1f} GB of memory are needed, and {free / 1e9:.1f} GB are free; shorten "
            "simulation.duration, widen its time_grid, or take fewer bands or subpaths (walks)"
        )
