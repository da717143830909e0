"""Where processor time goes: a tree of stages, collected in every run, and what was counted in each.

    with profiled("work") as found:
        with stage("tracing"):
            count(rays=1000)
    print(found.stage)

A stage has the processor time of the thread that runs it and of the threads that `over_rows` starts in it, and the
time by the clock while any thread is in it: their ratio is how many cores it keeps busy. What no threads of
`over_rows` did it did alone, on one core, however many there are; unlike time by the clock, that is known on a busy
machine too. Results are the same to the bit: nothing that is computed reads a clock. Memory is by how much a stage
raised the largest resident size of the process. Where `profiled` was not called, nothing is collected.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from soundspaces_sim.core.platforms import peak_memory_mb

COUNTS = ("rays", "deposits", "products")  # that tables show
_lock = threading.Lock()


@dataclass(frozen=True)
class Stage:
    """A stage and those within it. Times are seconds, of the processor unless said otherwise; memory is in MB."""

    name: str
    calls: int
    seconds: float  # of its own, without the stages within
    memory: float  # by which the largest resident size grew, stages within included
    counts: Mapping[str, int] = field(default_factory=dict)  # of its own
    stages: tuple[Stage, ...] = ()
    wall: float = 0.0  # by the clock, stages within included; summed over processes
    own_alone: float = 0.0  # of `seconds`, those without threads of `over_rows`

    @property
    def total(self) -> float:
        """Seconds, stages within included."""
        return self.seconds + sum(s.total for s in self.stages)

    @property
    def cores(self) -> float:
        """That it keeps busy in the mean, stages within included."""
        return self.total / self.wall if self.wall > 0.0 else 0.0

    @property
    def alone(self) -> float:
        """Seconds on one core, stages within included."""
        return self.own_alone + sum(s.alone for s in self.stages)

    def counted(self, what: str) -> int:
        """Of this stage and those within."""
        return self.counts.get(what, 0) + sum(s.counted(what) for s in self.stages)

    def find(self, *names: str) -> Stage | None:
        """The stage within by the names on the way to it; None if there is none."""
        if not names:
            return self
        found = next((s for s in self.stages if s.name == names[0]), None)
        return None if found is None else found.find(*names[1:])

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "name": self.name,
            "calls": self.calls,
            "processor_s": round(self.total, 4),
            "wall_s": round(self.wall, 4),
            "alone_s": round(self.alone, 4),
            "memory_mb": round(self.memory, 1),
            **self.counts,
            "stages": [s.as_dict() for s in self.stages],
        }

    def __str__(self) -> str:
        """The tree as a table, and below it what a pair takes, where `pairs` were counted."""
        times = "processor s", "share", "wall s", "cores", "alone s"
        heads = ("stage", "calls", *times, *COUNTS, "memory MB")
        rows = [heads, *_rows(self, 0, max(self.total, 1e-12))]
        widths = [max(len(row[k]) for row in rows) for k in range(len(heads))]
        lines = []
        for name, *numbers in rows:
            cells = [cell.rjust(width) for cell, width in zip(numbers, widths[1:], strict=True)]
            lines.append("  ".join([name.ljust(widths[0]), *cells]).rstrip())
        pairs = self.counted("pairs")
        if pairs:
            each = ", ".join(f"{_short(self.counted(what) / pairs)} {what}" for what in COUNTS)
            lines.append(f"{pairs:,} pairs; each {1e3 * self.total / pairs:.3g} ms, {each}")
        return "\n".join(lines)


class Profile:
    """A stage while it is collected."""

    def __init__(self, name: str, parent: Profile | None) -> None:
        self.name, self.parent = name, parent
        self.calls, self.seconds, self.memory = 0, 0.0, 0.0
        self.wall, self.threads, self.since = 0.0, 0, 0.0  # by the clock, while threads are in it
        self.alone = 0.0
        self.counts: dict[str, int] = {}
        self.inner: dict[str, Profile] = {}

    def child(self, name: str) -> Profile:
        with _lock:
            return self.inner.setdefault(name, Profile(name, self))

    @property
    def stage(self) -> Stage:
        """So far."""
        inner = tuple(node.stage for node in list(self.inner.values()))
        own = self.calls, self.seconds, self.memory, dict(self.counts), inner
        return Stage(self.name, *own, self.wall, self.alone)

    def add(self, stage: Stage) -> None:
        """A stage of another process, and all within it."""
        with _lock:
            self.calls += stage.calls
            self.seconds += stage.seconds
            self.wall += stage.wall
            self.alone += stage.own_alone
            self.memory = max(self.memory, stage.memory)
            for what, number in stage.counts.items():
                self.counts[what] = self.counts.get(what, 0) + number
        for inner in stage.stages:
            self.child(inner.name).add(inner)


class _OfThread(threading.local):
    node: Profile | None = None
    mark: float = 0.0  # processor time of the thread up to which it is accounted for
    helps: bool = False  # in a stage that another thread opened


_mine = _OfThread()


def _switch(node: Profile | None) -> None:
    """Account for this thread's time since the last switch; what comes is `node`'s."""
    now = time.thread_time()
    if _mine.node is not None:
        with _lock:
            _mine.node.seconds += now - _mine.mark
            if not _mine.helps:
                _mine.node.alone += now - _mine.mark
    _mine.node, _mine.mark = node, now


@contextmanager
def stage(name: str) -> Iterator[None]:
    """A stage of the one that this thread is in."""
    parent = _mine.node
    if parent is None:
        yield
        return
    with _within(parent.child(name), parent):
        yield


@contextmanager
def profiled(name: str) -> Iterator[Profile]:
    """Collect; gives something whose `stage` is what was found so far. Within another `profiled`, a stage of it."""
    parent = _mine.node
    node = Profile(name, None) if parent is None else parent.child(name)
    with _within(node, parent):
        yield node


@contextmanager
def _within(node: Profile, parent: Profile | None) -> Iterator[None]:
    before = peak_memory_mb()
    with _lock:
        if node.threads == 0:
            node.since = time.perf_counter()
        node.threads += 1
    _switch(node)
    try:
        yield
    finally:
        _switch(parent)
        with _lock:
            node.threads -= 1
            if node.threads == 0:
                node.wall += time.perf_counter() - node.since
            node.calls += 1
            node.memory += peak_memory_mb() - before


def here() -> Profile | None:
    """The stage that this thread is in, for threads that it starts (`working_in`)."""
    return _mine.node


@contextmanager
def working_in(node: Profile | None) -> Iterator[None]:
    """This thread works in a stage that another thread opened and waits for."""
    before = _mine.node, _mine.helps
    _switch(node)
    _mine.helps = True
    try:
        yield
    finally:
        _switch(before[0])
        _mine.helps = before[1]


def count(**numbers: int) -> None:
    """Add to what the stage that this thread is in has counted."""
    node = _mine.node
    if node is not None:
        with _lock:
            for what, number in numbers.items():
                node.counts[what] = node.counts.get(what, 0) + int(number)


def adopt(stage: Stage | None) -> None:
    """Put a profile that another process collected into the stage that this thread is in."""
    node = _mine.node
    if node is not None and stage is not None:
        node.child(stage.name).add(stage)


def _rows(stage: Stage, depth: int, whole: float) -> Iterator[tuple[str, ...]]:
    numbers = [stage.counted(what) for what in COUNTS]
    yield (
        "  " * depth + stage.name,
        f"{stage.calls:,}",
        f"{stage.total:.3f}",
        f"{100.0 * stage.total / whole:.0f} %",
        f"{stage.wall:.3f}",
        f"{stage.cores:.2f}",
        f"{stage.alone:.3f}",
        *(_short(n) if n else "" for n in numbers),
        f"{stage.memory:.0f}" if stage.memory >= 0.5 else "",
    )
    for inner in stage.stages:
        yield from _rows(inner, depth + 1, whole)


def _short(number: float) -> str:
    """Three digits: ``12.3 k``."""
    for unit, scale in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if number >= scale:
            return f"{number / scale:.3g} {unit}"
    return f"{number:.3g}"
