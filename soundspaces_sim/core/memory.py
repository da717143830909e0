"""Memory that is left, and refusals of what needs more."""

from __future__ import annotations

import re
from pathlib import Path

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.platforms import machine_memory

_GROUPS = (  # files of control groups, version 2 and 1: limit, use, and of that, what can be taken back
    ("memory.max", "memory.current", "memory.stat", "inactive_file"),
    (
        "memory/memory.limit_in_bytes",
        "memory/memory.usage_in_bytes",
        "memory/memory.stat",
        "total_inactive_file",
    ),
)


def free_memory(root: Path = Path("/sys/fs/cgroup")) -> float:
    """Bytes that this process may still take: those of the machine, or of its control group if fewer."""
    free = machine_memory()
    for limit, use, statistics, files in _GROUPS:
        most = _number(root / limit)
        if most is not None:
            used = (_number(root / use) or 0) - (_number(root / statistics, f"{files} ") or 0)
            free = max(min(free, most - max(used, 0)), 0.0)
    return float(free)


def _number(path: Path, name: str = "") -> int | None:
    """The number in a line of a control group's file, after a name; None if there is none, as of "max"."""
    try:
        found = re.search(rf"^{name}(\d+)$", path.read_text(encoding="ascii"), re.MULTILINE)
    except (OSError, ValueError):
        return None
    return int(found[1]) if found else None


def check_memory(wanted: float, what: str) -> None:
    """Raise `ConfigError` if `what` needs more bytes, `wanted`, than are free."""
    free = free_memory()
    if not wanted <= free:
        raise ConfigError(
            f"{what}: {wanted / 1e9:.1f} GB of memory are needed, and {free / 1e9:.1f} GB are free; shorten "
            "simulation.duration, widen its time_grid, or take fewer bands or subpaths (walks)"
        )
