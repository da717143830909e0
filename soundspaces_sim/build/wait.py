"""Waiting for files of other machines: network file systems show a new name some seconds late."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

_FIRST_S, _LONGEST_S = 0.05, 2.0


def wait_for(there: Callable[[], bool], folder: Path, timeout_s: float) -> bool:
    """Wait for `there()` to hold, at most `timeout_s`; whether it does.

    Between looks the folder is listed, which makes NFS clients ask the server for its names.
    """
    deadline, pause = time.monotonic() + timeout_s, _FIRST_S
    while not there():
        left = deadline - time.monotonic()
        if left <= 0.0:
            return False
        time.sleep(min(pause, left))
        pause = min(2.0 * pause, _LONGEST_S)
        with suppress(OSError):
            os.listdir(folder)
    return True
