"""Threads that stay: who does what is open, what is done is not."""

import gc
import os
import threading
import time
import weakref
from collections.abc import Iterator

import pytest

from soundspaces_sim.core.numerics import threads
from soundspaces_sim.core.numerics.kernel import at_once, over_rows, set_thread_count, thread_count
from soundspaces_sim.core.numerics.threads import share_out


@pytest.fixture
def four_threads() -> Iterator[None]:
    before = thread_count()
    set_thread_count(4)
    yield
    set_thread_count(before)


def test_every_piece_is_done_once_and_by_no_more_threads_than_allowed() -> None:
    done: list[int] = []
    running, most = 0, 0
    lock = threading.Lock()

    def work(piece: int) -> None:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.002)
        with lock:
            running -= 1
            done.append(piece)

    share_out(work, range(0, 90, 3), 6)  # so that more threads are there than the next call may use
    assert sorted(done) == list(range(0, 90, 3)) and most == 6
    done.clear()
    most = 0
    share_out(work, range(30), 2)
    assert sorted(done) == list(range(30)) and most == 2


def test_threads_are_started_once() -> None:
    share_out(lambda _: time.sleep(0.001), range(8), 3)
    before = set(threading.enumerate())
    for _ in range(20):
        share_out(lambda _: time.sleep(0.0002), range(8), 3)
    assert set(threading.enumerate()) == before


@pytest.mark.usefixtures("four_threads")
def test_who_has_done_its_own_share_helps_with_what_is_left() -> None:
    """Two tasks at once, of which one ends at once: all four threads work for the other."""
    idents: set[int] = set()

    def long() -> None:
        def rows(*_: int) -> None:
            idents.add(threading.get_ident())
            time.sleep(0.03)

        over_rows(rows, 16, chunk=1)

    at_once(lambda: time.sleep(0.005), long)
    assert len(idents) == 4


def test_who_helps_another_goes_on_when_its_own_call_is_over() -> None:
    """One helper, who leaves a long call for the second piece of a short one. Until that has ended, the first thread
    of the short call helps the long one in its place."""
    board, ended = threads._Board(), dict[str, float]()

    def call(name: str, seconds: list[float]) -> None:
        work = threads._Call(lambda piece: time.sleep(seconds[piece]), range(len(seconds)), 2)
        board.share_out(work)
        ended[name] = time.perf_counter() - begun

    begun = time.perf_counter()
    calls = ("long", [0.01] * 90), ("short", [0.05, 0.15])
    both = [threading.Thread(target=call, args=arguments) for arguments in calls]
    for thread in both:
        thread.start()
        time.sleep(0.02)
    for thread in both:
        thread.join(60.0)
    assert board.threads == 1 and ended["short"] < 0.7 * ended["long"]


@pytest.mark.usefixtures("four_threads")
def test_what_a_call_shares_out_alone_its_thread_does() -> None:
    """And the caller's own calls are shared out again afterwards."""

    def idents() -> set[int]:
        found: set[int] = set()

        def rows(*_: int) -> None:
            found.add(threading.get_ident())
            time.sleep(0.005)

        over_rows(rows, 8, chunk=1)
        return found

    apart, together = at_once(*[idents] * 4, alone=True), at_once(*[idents] * 4)
    assert all(len(found) == 1 for found in apart) and max(map(len, together)) > 1
    assert len(idents()) > 1


@pytest.mark.usefixtures("four_threads")
def test_no_piece_has_fewer_rows_than_are_worth_a_thread() -> None:
    """Each takes Python's lock, for which short ones wait longer than they work: 100 rows in sixteen pieces of 7,
    unless 11 are the least."""
    sizes: dict[int, list[int]] = {1: [], 11: [], 60: []}
    for least, found in sizes.items():
        over_rows(lambda first, last, to=found: to.append(last - first), 100, least=least)
        assert sum(found) == 100
    assert sorted(sizes[1])[1:] == [7] * 14 and sorted(sizes[11])[1:] == [11] * 9
    assert sizes[60] == [60, 40]  # by one thread


@pytest.mark.usefixtures("four_threads")
def test_calls_within_calls_end() -> None:
    """Three levels of calls from two threads of the caller's own at once: no one waits for itself."""
    done: list[tuple[int, ...]] = []

    def nest(*place: int) -> None:
        if len(place) == 4:
            done.append(place)
            return
        over_rows(lambda first, _: nest(*place, first), 5, chunk=1)

    others = [threading.Thread(target=nest, args=(k,)) for k in (1, 2)]
    for thread in others:
        thread.start()
    nest(0)
    for thread in others:
        thread.join(60.0)
    assert len(done) == len(set(done)) == 3 * 5**3


def test_an_error_ends_the_call_and_nothing_else() -> None:
    begun: list[int] = []

    def work(piece: int) -> None:
        begun.append(piece)
        time.sleep(0.005)
        if piece == 3:
            raise ValueError("the fourth")

    with pytest.raises(ValueError, match="the fourth"):
        share_out(work, range(1000), 3)
    count = len(begun)
    assert count < 20
    time.sleep(0.03)
    assert len(begun) == count
    share_out(begun.append, range(5), 3)
    assert sorted(begun[count:]) == list(range(5))


def test_threads_that_wait_keep_nothing() -> None:
    class Work:
        def do(self, _: int) -> None:
            time.sleep(0.001)

    work = Work()
    alive = weakref.ref(work)
    share_out(work.do, range(16), 4)
    del work
    deadline = time.perf_counter() + 5.0
    while alive() is not None and time.perf_counter() < deadline:
        gc.collect()
        time.sleep(0.01)  # until the last thread is back where it waits
    assert alive() is None


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_process_that_was_forked_starts_its_own() -> None:
    share_out(lambda _: None, range(8), 4)
    child = os.fork()
    if child == 0:
        done: list[int] = []
        share_out(done.append, range(8), 4)
        os._exit(0 if sorted(done) == list(range(8)) and threads._board.threads == 3 else 1)
    assert os.waitpid(child, 0)[1] == 0
