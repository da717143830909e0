"""Memory that is left."""

from __future__ import annotations

import os
from pathlib import Path

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
