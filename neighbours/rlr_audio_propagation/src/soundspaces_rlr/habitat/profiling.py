"""`habitat_sim.utils.profiling_utils`: habitat's marks for NVIDIA's profiler. As there, they do nothing unless the
environment variable HABITAT_PROFILING is set; here that is refused."""

from __future__ import annotations

import os
from types import TracebackType

from soundspaces_rlr.errors import RlrError

ENVIRONMENT_VARIABLE = "HABITAT_PROFILING"


def configure(capture_start_step: int = -1, num_steps_to_capture: int = -1) -> None:
    """Which steps to profile. Raises `RlrError` where the environment asks for a profile."""
    del capture_start_step, num_steps_to_capture
    if os.environ.get(ENVIRONMENT_VARIABLE, "0") != "0":
        raise RlrError(
            f"{ENVIRONMENT_VARIABLE} is set: nothing is marked for NVIDIA's profiler here; unset it"
        )


def on_start_step() -> None:
    """Another step begins."""


def range_push(msg: str) -> None:
    """A part begins."""
    del msg


def range_pop() -> None:
    """It ends."""


class RangeContext:
    """A part of a program, for `with`; also what decorates a function."""

    def __init__(self, msg: str) -> None:
        self.msg = msg

    def __enter__(self) -> RangeContext:
        range_push(self.msg)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        range_pop()
