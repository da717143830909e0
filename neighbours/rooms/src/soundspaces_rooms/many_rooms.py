"""Many scenes with few pairs each: a room after the other in every process, with one thread.

A room takes so little that threads would wait for each other most of the time. Results come in the order of the
rooms, while later ones are under way; what is given may be endless.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from soundspaces_sim import (
    Echograms,
    PointError,
    Scene,
    SimulationConfig,
    SimulationError,
    SoundSpacesSimError,
    simulate,
)
from soundspaces_sim.parts import (
    PointsLike as Points,
    check_interrupts as check,
    of_simulation,
    set_thread_count,
    start_worker,
    use_cores,
    worker_pool,
)

_AHEAD = 4  # rooms that wait for each process: some take longer than others
_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

#: What is simulated where nobody says otherwise: until an error is met, by what is less for a room's points.
ROOM_CONFIG = of_simulation(SimulationConfig())


class _Room(NamedTuple):
    number: int
    scene: Scene | str | Path | Any  # or a function that gives one
    sources: Points
    listeners: Points
    config: SimulationConfig
    seed: int


def simulate_many(
    scenes: Iterable[Scene | Callable[[], Any] | str | Path | Any],
    sources: Iterable[Points],
    listeners: Iterable[Points],
    config: SimulationConfig | None = None,
    seed: int = 0,
    jobs: int | None = None,
) -> Iterator[Echograms]:
    """Echograms of many scenes in turn: of each between its own `sources` (S, 3) and `listeners` (L, 3), m.

    The three are gone through in step, as far as `scenes` goes, and only a little ahead of what is taken from the
    result. A scene is what `simulate` takes, or a function without arguments that gives it (made in the process
    that needs it). `config`: as `simulate` takes it; by default subpaths are added until every pair has an
    error of 5 % (`SimulationConfig.target_error`). `jobs`: processes, of one thread each; by default one per core.
    The results are those of `simulate`, for any number of processes. Raises the errors of `simulate`, with the
    number of the room, from 0; rooms before it have been given out.
    """
    rooms = (
        _Room(number, scene, a, b, config or ROOM_CONFIG, seed)
        for number, (scene, a, b) in enumerate(_in_step(scenes, sources, listeners))
    )
    return in_processes(_simulated, rooms, jobs)


def _in_step(
    scenes: Iterable[Any], sources: Iterable[Points], listeners: Iterable[Points]
) -> Iterator[tuple[Any, Points, Points]]:
    """Raises `PointError` where points end before scenes do."""
    of_sources, of_listeners = iter(sources), iter(listeners)
    for number, scene in enumerate(scenes):
        try:
            yield scene, next(of_sources), next(of_listeners)
        except StopIteration:
            raise PointError(
                f"room {number}: expected sources and listeners for every scene, got them for {number} scenes"
            ) from None


def _simulated(room: _Room) -> Echograms:
    with room_named(room.number):
        scene = room.scene() if callable(room.scene) else room.scene
        return simulate(scene, room.sources, room.listeners, room.config, room.seed)


@contextmanager
def room_named(room: int | str) -> Iterator[None]:
    """Within, errors of ours say of which room they are."""
    try:
        yield
    except SoundSpacesSimError as error:
        raise type(error)(f"room {room}: {error}") from error


def in_processes(
    function: Callable[[_Task], _Result], tasks: Iterable[_Task], jobs: int | None = None
) -> Iterator[_Result]:
    """`function` of each of the tasks, in their order, in `jobs` processes of one thread. Raises `ConfigError`."""
    with use_cores(jobs) as cores:
        pass
    return _alone(function, tasks) if cores == 1 else _side_by_side(function, tasks, cores)


def _alone(function: Callable[[_Task], _Result], tasks: Iterable[_Task]) -> Iterator[_Result]:
    for task in tasks:
        with use_cores(1):
            result = function(task)
        yield result


def _side_by_side(
    function: Callable[[_Task], _Result], tasks: Iterable[_Task], processes: int
) -> Iterator[_Result]:
    waiting: deque[Future[_Result]] = deque()
    done = 0
    try:
        with worker_pool(processes, _start) as pool:
            for task in tasks:
                waiting.append(pool.submit(function, task))
                if len(waiting) >= processes * _AHEAD:
                    yield waiting.popleft().result()
                    done += 1
                check()
            while waiting:
                yield waiting.popleft().result()
                done += 1
    except BrokenProcessPool as error:
        raise SimulationError(
            f"a process was killed (out of memory?); the results of {done} rooms were given out before"
        ) from error


def _start(parent: int) -> None:
    start_worker(parent)
    set_thread_count(1)
