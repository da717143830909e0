"""The command line in this process: a process of its own takes seconds to load what computes."""

from __future__ import annotations

import contextlib
import io
import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from soundspaces_sim.cli import main


@dataclass(frozen=True)
class Ended:
    """How a command ended, and what it said."""

    returncode: int
    stdout: str
    stderr: str


def run_command(*arguments: str, cwd: Path, entry: Callable[[], None] = main) -> Ended:
    """Run `soundspaces-sim`, or a neighbour's `entry`, with these arguments by its entry point, in the folder `cwd`, on 200 columns.

    Log lines go to pytest, not to stderr: tests of these need a process.
    """
    out, errors, code = io.StringIO(), io.StringIO(), 0
    levels = {
        name: logging.getLogger(name).level for name in ("soundspaces_sim", "trimesh", "matplotlib")
    }
    with (
        contextlib.chdir(cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors),
        pytest.MonkeyPatch.context() as patch,
    ):  # fmt: skip
        patch.setattr(sys, "argv", ["soundspaces-sim", *arguments])
        patch.setenv("COLUMNS", "200")
        try:
            entry()
        except SystemExit as end:
            assert end.code is None or isinstance(end.code, int)
            code = end.code or 0
        finally:
            for name, level in levels.items():
                logging.getLogger(name).setLevel(level)
    return Ended(code, out.getvalue(), errors.getvalue())
