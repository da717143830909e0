"""The version, in one place, and the commit of the code at hand."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

__version__ = "0.3.0"

_HERE = Path(__file__).resolve().parent


@cache
def commit() -> str:
    """The commit of the code, with ``-dirty`` where a checkout differs from it; empty where none is known.

    A checkout is asked by git; a wheel has it in a file beside this one (`hatch_build.py`).
    """
    kept = _HERE / "commit.txt"
    if kept.is_file():
        return kept.read_text("utf-8").strip()
    if not (_HERE.parents[1] / ".git").exists():
        return ""
    command = ["git", "-C", str(_HERE), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10.0)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def version_text() -> str:
    """As ``0.3.0 (commit 0123456789ab)``."""
    return f"{__version__} (commit {commit()})" if commit() else __version__
