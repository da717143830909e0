"""Workers end with the command that started them, also where that is killed and can tell them nothing."""

from __future__ import annotations

import os
import threading
import time

from soundspaces_sim.core.processes import is_running

_EVERY_S = 0.5


def end_with(parent: int) -> None:
    """End this process within about a second of the end of process `parent`, from which it stems."""
    threading.Thread(target=_watch, args=(parent,), name="end with parent", daemon=True).start()


def _watch(parent: int) -> None:
    own = os.getppid() == parent
    while os.getppid() == parent if own else is_running(parent):
        time.sleep(_EVERY_S)
    os._exit(1)  # nothing is left to clean up for: files are whole or absent
