"""Ctrl-C where nothing is half done.

Python raises `KeyboardInterrupt` between any two instructions of the main thread: while a pool starts a thread
that nobody then waits for, or inside a look-up of Numba's that takes no exceptions. So long work runs in
`deferred()`, which only notes the signal, and calls `check()` where stopping is safe.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_noted = False


def _note(number: int, frame: FrameType | None) -> None:
    global _noted
    if _noted:  # a second Ctrl-C takes effect at once
        signal.default_int_handler(number, frame)
    _noted = True


def check() -> None:
    """Raise `KeyboardInterrupt` if Ctrl-C was pressed since the outermost `deferred()` began; in any thread."""
    if _noted:
        raise KeyboardInterrupt


@contextmanager
def deferred() -> Iterator[None]:
    """Within, the first Ctrl-C is raised by `check()` only, and at the end at the latest; a second one at once.

    Does nothing where Ctrl-C is not Python's to raise: outside the main thread, and under a handler of the
    caller's own, or of an outer `deferred()`.
    """
    global _noted
    own = threading.current_thread() is threading.main_thread()
    if not own or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, _note)
    try:
        yield
        check()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _noted = False
