"""Threads that wait for work, and one way to give it to them: `share_out`.

A job calls `over_rows` thousands of times, often for a millisecond. Threads that were started anew for each would
take longer to start than to work on a machine with many cores. So they stay, and wait. Whoever shares work out does
some of it, and while others are busy with the rest does whatever else has been shared out: two calls side by side,
of which one ends sooner, keep all threads busy.

No call waits for another that waits for it: a call waits for pieces that began after it, and a piece for calls that
began after that.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Sequence

_RENDERERS = 4  # much of a response is Python's own work, and more would wait for its lock


def core_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def renderer_count(threads: int) -> int:
    """Threads that render, where so many may be used."""
    return min(threads, _RENDERERS)


class _Call:
    """Pieces of work, taken in order, for which at most `most` threads work."""

    def __init__(self, work: Callable[[int], None], pieces: Sequence[int], most: int) -> None:
        self.work, self.most = work, most
        self.left, self.threads = deque(pieces), 0
        self.errors: list[tuple[int, BaseException]] = []

    @property
    def open(self) -> bool:
        """Whether one more thread may work for it."""
        return bool(self.left) and self.threads < self.most

    @property
    def over(self) -> bool:
        return self.threads == 0 and not self.left


class _Board:
    """Calls whose pieces are not all taken, and the threads that take them.

    The lock is for a thread that begins to work for a call, or ceases to. Between two pieces it is not taken: many
    threads with short pieces would do little but wait for it.
    """

    def __init__(self) -> None:
        lock = threading.Lock()
        self.shared, self.ended = threading.Condition(lock), threading.Condition(lock)
        self.lock, self.calls, self.threads = lock, list[_Call](), 0

    def share_out(self, call: _Call) -> None:
        """Do a call, with others' help."""
        with self.lock:
            self.calls.append(call)
            self._call_for_help(call.most - 1)
        try:
            while True:
                with self.lock:
                    while not (call.over or self._next(call)):
                        self.ended.wait()
                    if call.over:
                        break
                    taken = self._begin(self._next(call))
                self._work(taken, call)
        finally:  # whatever has interrupted this thread, no piece is begun any more
            with self.lock:
                self.calls.remove(call)
                call.left.clear()
                while not call.over:
                    self.ended.wait()

    def _call_for_help(self, wanted: int) -> None:
        for _ in range(self.threads, wanted):
            self.threads += 1
            threading.Thread(target=self._help, name="over_rows", daemon=True).start()
        self.shared.notify(wanted)
        self.ended.notify_all()  # who waits for the end of a call may take a piece of this one

    def _help(self) -> None:
        while True:
            with self.lock:
                while (call := self._next()) is None:
                    self.shared.wait()
                self._begin(call)
            self._work(call)
            del call  # not to keep a scene in memory until there is more to do

    def _next(self, first: _Call | None = None) -> _Call | None:
        """A call with a piece to take: `first`, or else the one that began last."""
        if first is not None and first.open:
            return first
        return next((c for c in reversed(self.calls) if c.open), None)

    def _begin(self, call: _Call | None) -> _Call:
        assert call is not None
        call.threads += 1
        return call

    def _work(self, call: _Call, own: _Call | None = None) -> None:
        """Take pieces of a call: one, and more until a call that began later has one to take, or this thread's
        `own` call is over. Of its own it takes all that are left."""
        try:
            while call.left:
                try:
                    piece = call.left.popleft()
                except IndexError:  # another thread has taken the last one meanwhile
                    break
                try:
                    call.work(piece)
                except BaseException as error:  # whoever shared it out raises it
                    call.errors.append((piece, error))
                    call.left.clear()
                later = any(c.open for c in self.calls[-1:] if c is not call)
                if call is not own and (later or (own is not None and own.over)):
                    break
        finally:
            with self.lock:
                call.threads -= 1
                if call.over:
                    self.ended.notify_all()
                elif call.open:  # this thread may work for another call
                    self.shared.notify()


_board = _Board()


def share_out(work: Callable[[int], None], pieces: Sequence[int], threads: int) -> None:
    """`work(piece)` for all `pieces`, in this and other threads, at most so many at once. Where one raises, no more
    are begun, and this raises when those under way have ended."""
    call = _Call(work, pieces, threads)
    _board.share_out(call)
    if call.errors:
        raise min(call.errors, key=lambda e: e[0])[1]


def _forget() -> None:
    """A process that was forked has none of these threads."""
    global _board
    _board = _Board()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
