"""Memory that is left, and refusals of what needs more."""

from __future__ import annotations

from pathlib import Path

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.platforms import machine_memory

_LIMITS = ("memory.max", "memory/memory.limit_in_bytes")  # of control groups, version 2 and 1


def free_memory(root: Path = Path("/sys/fs/cgroup")) -> float:
    """Bytes that this process may still take: those of the machine, or of its control group if fewer."""
    free = machine_memory()
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
