"""`@kernel`: a compiled function whose cache on disk knows what was compiled into it.

Numba keys the cache of a function by the file that holds it, but a kernel has functions and constants of
other files compiled in: after an edit or a `git pull` a mixture would run. So the stamp of every kernel is
that of its own file and of all files in the rooms whose code is compiled into others.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile

_PACKAGE = Path(__file__).parents[1]
_ROOMS = ("base", "rays", "transport")


@cache
def kernel_digest() -> str:
    """SHA-256 of the sources whose code kernels of other files contain."""
    sha = hashlib.sha256()
    for room in _ROOMS:
        for path in sorted((_PACKAGE / room).rglob("*.py")):
            sha.update(path.relative_to(_PACKAGE).as_posix().encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()


class _KernelCache(FunctionCache):
    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = IndexDataCacheFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=(self._impl.locator.get_source_stamp(), kernel_digest()),
        )


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function with Numba when it is first called, and keep the machine code on disk.

    `options` are those of `numba.njit`.
    """
    if function is None:
        return lambda f: kernel(f, **options)
    compiled = numba.njit(**options)(function)
    if hasattr(compiled, "_cache"):  # not so where NUMBA_DISABLE_JIT is set
        compiled._cache = _KernelCache(function)
    return compiled
