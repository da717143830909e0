"""Ctrl-C in the midst of long work: nothing goes on behind the caller's back, and nothing is pulled from under it."""

import gc
import signal
import threading
import time
import weakref
from collections.abc import Iterator

import pytest

from soundspaces_sim.core.interrupts import check, deferred
from soundspaces_sim.core.numerics.kernel import at_once, over_rows, set_thread_count, thread_count
from tests.rooms import box, table


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Whatever started the tests: what a shell starts in the background ignores Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    before = thread_count()
    set_thread_count(request.param)
    yield request.param
    set_thread_count(before)


def test_slices_end_before_the_interrupt_is_raised(threads: int) -> None:
    begun: list[int] = []
    running: list[int] = []

    def work(first: int, _: int) -> None:
        begun.append(first)
        running.append(first)
        if first == 0:
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        time.sleep(0.02)
        running.remove(first)

    with pytest.raises(KeyboardInterrupt):
        over_rows(work, 100, chunk=1)
    assert not running
    count = len(begun)
    time.sleep(0.05)
    assert len(begun) == count <= threads + 1
    check()  # nothing is left noted


def test_an_interrupt_ends_all_that_is_done_at_once(threads: int) -> None:
    begun: list[int] = []

    def work(first: int, _: int) -> None:
        begun.append(first)
        if len(begun) == 3:
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        time.sleep(0.02)

    with pytest.raises(KeyboardInterrupt):
        at_once(*[lambda: over_rows(work, 100, chunk=1)] * 2)
    count = len(begun)
    time.sleep(0.05)
    assert len(begun) == count <= 3 + threads**2
    check()


def test_what_is_done_at_once_comes_back_in_order(threads: int) -> None:
    def slow() -> int:
        time.sleep(0.02)
        return 1

    def failing() -> int:
        raise ValueError("the third one")

    assert at_once(slow, lambda: threads, slow) == [1, threads, 1]
    with pytest.raises(ValueError, match="the third one"):
        at_once(slow, slow, failing)


def test_deferred_until_checked() -> None:
    with pytest.raises(KeyboardInterrupt), deferred():
        with deferred():  # nested: the outermost one raises
            signal.raise_signal(signal.SIGINT)
        reached = True
        check()
        reached = False
    assert reached
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    check()


def test_raised_at_the_end_at_the_latest() -> None:
    with pytest.raises(KeyboardInterrupt), deferred():
        signal.raise_signal(signal.SIGINT)
        reached = True
    assert reached
    check()


def test_the_second_is_raised_at_once() -> None:
    reached = False
    with pytest.raises(KeyboardInterrupt), deferred():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        reached = True
    assert not reached


def test_a_handler_of_the_callers_own_is_left_alone() -> None:
    seen: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: seen.append(number))
    try:
        with deferred():
            signal.raise_signal(signal.SIGINT)
            check()
    finally:
        signal.signal(signal.SIGINT, before)
    assert seen == [signal.SIGINT]


def test_triangles_keep_the_embree_scene_they_point_to() -> None:
    """Kernels get the scene's handle as a number: a thread that outlives its scene would read freed memory."""
    scene = box((3.0, 4.0, 2.5), table(0.1, 0.1))
    geometry, alive = scene.geometry, weakref.ref(scene.rays)
    del scene
    gc.collect()
    assert alive() is not None
    del geometry
    gc.collect()
    assert alive() is None
