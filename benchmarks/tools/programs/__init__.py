"""Other programs behind one seam: a scene and places go in, energies and seconds of several runs come out.

A module of this folder is one program. `simulator` makes a scene ready, which is not timed; what it returns
simulates all pairs of the sources and listeners, sources outermost, with random numbers of its own; `energies`
puts what came out into bins of 10 ms and our bands, which is not timed either.
"""

from __future__ import annotations

import importlib
import importlib.util
import multiprocessing
import resource
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any, Protocol, cast

import numpy as np

import soundspaces_sim as ss

Simulator = Callable[[int], Any]
NAMES = ("rlr", "pyroomacoustics", "misuka", "acoustic_spaces")
LIMIT_S = 60.0  # of the processor for one run
PREPARATION_S = 300.0  # by the clock
MEMORY_BYTES = 16 << 30


class Program(Protocol):
    """What a module of this folder has."""

    NAME: str  # of the distribution
    MODULE: str  # by which it is imported
    UNIT: str  # of what `SETTINGS` count
    SETTINGS: Sequence[int]
    WAVEFORMS: bool  # whether energies are those of noise
    BOXES_ONLY: bool  # whether meshes like the house are beyond it

    def simulator(
        self, scene: ss.Scene, sources: np.ndarray, listeners: np.ndarray, setting: int
    ) -> Simulator: ...

    def energies(self, found: Any) -> np.ndarray: ...


class TooSlowError(Exception):
    """A program does not end, at a setting: what took how long."""


def program(name: str) -> Program:
    """The module of that name."""
    return cast(Program, importlib.import_module(f"{__name__}.{name}"))


def installed() -> list[str]:
    """The names of modules here whose programs can be imported."""
    return [name for name in NAMES if importlib.util.find_spec(program(name).MODULE)]


def runs(
    name: str, scene: ss.Scene, ends: tuple[np.ndarray, np.ndarray], setting: int, count: int
) -> tuple[float, np.ndarray]:
    """Processor seconds of a run in the mean, and (count, pairs, bins, bands) energies, in a process of its own.

    A run before the first is not counted, in which a program compiles what it compiles. Raises `TooSlowError` where
    making ready takes `PREPARATION_S`, a run `LIMIT_S`, or the program ends with an error or wants more memory
    than `MEMORY_BYTES`.
    """
    context = multiprocessing.get_context("spawn")
    mine, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_child, args=(theirs, name, scene, ends, setting, count))
    child.start()
    theirs.close()
    found: list[tuple[float, np.ndarray]] = []
    try:
        _received(mine, PREPARATION_S, "reading the scene")
        for _ in range(count + 1):
            seconds, energy = _received(mine, 20.0 * LIMIT_S, "a run")
            if seconds > LIMIT_S:
                raise TooSlowError(f"a run takes {seconds:.0f} s")
            found.append((seconds, energy))
    finally:
        child.kill()
        child.join()
    seconds = float(np.mean([s for s, _ in found[1:]]))
    return seconds, np.array([energy for _, energy in found[1:]])


def _received(pipe: Connection, limit_s: float, what: str) -> Any:
    if not pipe.poll(limit_s):
        raise TooSlowError(f"{what} takes longer than {limit_s:.0f} s")
    try:
        return pipe.recv()
    except EOFError:
        raise TooSlowError(f"{what} ended with an error") from None


def _child(
    pipe: Connection,
    name: str,
    scene: ss.Scene,
    ends: tuple[np.ndarray, np.ndarray],
    setting: int,
    count: int,
) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    made = program(name)
    simulate = made.simulator(scene, *ends, setting)
    pipe.send(None)
    for run in range(count + 1):
        start = time.process_time()
        found = simulate(run)
        seconds = time.process_time() - start
        pipe.send((seconds, made.energies(found)))
