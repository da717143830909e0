"""Compiled functions: `@kernel` for those that Python calls, `@part` for those that kernels consist of.

Numba keys the cache of a function by the file that holds it, but a kernel has functions and constants of
other files compiled in: after an edit or a `git pull` a mixture would run. So the stamp of every kernel is a digest
of its code and of all that it refers to (`core.numerics.stamp`), whichever files that is in.

Kernels neither allocate nor count references (`_nrt=False`): counts are atomic, and threads that share a
scene's arrays would spend a third of their time on them. So they fill arrays that are given to them, and copy
rows element by element. Parts have no entry for Python, no machine code of their own (`core.numerics.compilers`)
and no cache, which more than halves what there is to compile. Loops over rows
are not Numba's `parallel=True` but plain kernels in threads (`over_rows`): one version of each is compiled
instead of three, and Ctrl-C stops them at the next slice.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
import sys
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import types
from numba.core.caching import FunctionCache, IndexDataCacheFile

from soundspaces_sim.core.interrupts import check, deferred
from soundspaces_sim.core.numerics.compilers import KernelCompiler, PartCompiler, forget_names
from soundspaces_sim.core.numerics.stamp import code_digest, field_names
from soundspaces_sim.core.numerics.threads import core_count, share_out
from soundspaces_sim.core.profile import here, working_in

_log = logging.getLogger(__name__)
_PACKAGE = Path(__file__).parents[2]
_ROOMS = ("core/numerics", "scene", "transport")


@cache
def source_digest() -> str:
    """SHA-256 of the sources in the rooms that hold most kernels."""
    sha = hashlib.sha256()
    for room in _ROOMS:
        for path in sorted((_PACKAGE / room).rglob("*.py")):
            sha.update(path.relative_to(_PACKAGE).as_posix().encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()


class _KernelCacheFile(IndexDataCacheFile):
    def _load_index(self) -> Any:
        """What there is; nothing if another version of the package wrote it, with records that are no more."""
        try:
            return super()._load_index()
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError):
            return {}


class _KernelCache(FunctionCache):
    _opened: _KernelCacheFile | None = None
    linked = False  # into other kernels

    @property  # type: ignore[override]
    def _cache_file(self) -> _KernelCacheFile:
        """The kernel's file, once it is first called: what it refers to may stand below it in its module."""
        if self._opened is None:
            function = self._py_func
            name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}.py{sys.hexversion >> 16:x}"
            self._opened = _KernelCacheFile(
                cache_path=self._cache_path, filename_base=name, source_stamp=code_digest(function)
            )
        return self._opened

    @_cache_file.setter
    def _cache_file(self, _: Any) -> None:
        """What Numba would have is keyed by the source file and the number of a line."""

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return field_names(sig), super()._index_key(sig, codegen)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was compiled for a signature; None if nothing was, or with functions of modules that are no more."""
        try:
            found = super().load_overload(sig, target_context)
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError):
            return None
        if found is not None and not self.linked:
            forget_names(found.library)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled; where that cannot be written, it is compiled again next time."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _log.warning("%s: compiled kernels cannot be kept here (%s)", self.cache_path, error)


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function with Numba when it is first called, and keep the machine code on disk.

    It runs without the GIL. `options` are those of `numba.njit`; kernels too call one that is inlined
    (`forceinline`).
    """
    if function is None:
        return lambda f: kernel(f, **options)
    chosen = {"nogil": True, "_nrt": False, "no_cfunc_wrapper": True, **options}
    linked = bool(chosen.get("forceinline"))
    if not linked:
        chosen["pipeline_class"] = KernelCompiler
    compiled = numba.njit(**chosen)(function)
    if hasattr(compiled, "_cache"):  # not so where NUMBA_DISABLE_JIT is set
        compiled._cache = _KernelCache(function)
        compiled._cache.linked = linked
    return compiled


def part(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function into the kernels that call it; its `py_func` is what Python can call.

    Only kernels and parts may call it: it counts no references, which others take for granted of arrays that they
    are given.
    """
    if function is None:
        return lambda f: part(f, **options)
    without_entry: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
    compiled = numba.njit(pipeline_class=PartCompiler, **without_entry, **options)(function)
    template = getattr(compiled, "get_call_template", None)
    if template is not None:  # not so where NUMBA_DISABLE_JIT is set
        compiled.get_call_template = lambda args, kws: template(*_without_literals(args, kws))
    return compiled


def _without_literals(args: Any, kws: Any) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """Types of arguments: a constant has its type, so that a call with 0 takes no version of its own."""
    return tuple(map(types.unliteral, args)), {name: types.unliteral(t) for name, t in kws.items()}


_threads: int | None = None


class _OfThread(threading.local):
    alone: bool = False  # in a call of `over_rows` whose own calls are not shared out


_mine = _OfThread()


def thread_count() -> int:
    """Threads that `over_rows` uses: one per core, unless `set_thread_count` says otherwise."""
    return _threads or core_count()


def set_thread_count(count: int | None) -> None:
    """Use `count` threads from now on; None: one per core."""
    global _threads
    _threads = count


def over_rows(
    function: Any,
    rows: int,
    *args: Any,
    chunk: int | None = None,
    scratch: Callable[[], Any] | None = None,
    least: int = 1,
    alone: bool = False,
) -> None:
    """Call `function(first, last, *args)` for slices that cover `rows` rows, in threads.

    Every row must be computed from its number alone, so that slices and threads change nothing. `chunk`: rows per
    call; by default four calls per thread, none of fewer than `least` rows. `scratch` makes what each call works
    in, as its last argument: kernels that allocate take seconds longer to compile. `least`: rows for which it is
    worth to start a thread. `alone`: what a call shares out itself, its thread does alone. Where there are calls
    enough for all threads, more and shorter ones would only wait for each other.
    """
    threads = 1 if _mine.alone else min(thread_count(), max(rows // least, 1))
    step = chunk or max(-(-rows // (4 * threads)), min(least, -(-rows // threads)), 1)

    def call(first: int) -> None:
        check()
        own = () if scratch is None else (scratch(),)
        function(first, min(first + step, rows), *args, *own)

    stage = here()

    def call_in_thread(first: int) -> None:
        before, _mine.alone = _mine.alone, alone
        try:
            with working_in(stage):
                call(first)
        finally:
            _mine.alone = before

    starts = range(0, rows, step)
    with deferred():
        if threads <= 1 or len(starts) <= 1:
            for first in starts:
                call(first)
        else:
            share_out(call_in_thread, starts, threads)


def rows_of_thread(table: np.ndarray) -> int:
    """`least` of `over_rows` that does little with each number of a table's rows: those of four megabytes."""
    return max(2**22 // max(table[:1].nbytes, 1), 1)


def at_once(*tasks: Callable[[], Any], least: int = 1, alone: bool = False) -> list[Any]:
    """What each of these gives, in threads side by side, those that take longest first: they may use `over_rows`
    themselves, and where one is busy with Python the others have the cores. `least`, `alone`: of `over_rows`."""
    results: list[Any] = [None] * len(tasks)

    def call(first: int, last: int) -> None:
        for i in range(first, last):
            results[i] = tasks[i]()

    over_rows(call, len(tasks), chunk=1, least=least, alone=alone)
    return results
