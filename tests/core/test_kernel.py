"""Compiled code that is kept on disk."""

import sys
import types
from pathlib import Path
from typing import Any

import numba
import pytest
from numba.core.caching import FunctionCache

from soundspaces_sim.core.numerics.kernel import _KernelCacheFile, kernel


def test_an_index_with_records_that_are_no_more_is_no_index(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After an update the package may lack a record that an older version's index names."""
    module: Any = types.ModuleType("of_an_older_version")
    record = type("Record", (), {"__module__": module.__name__})
    module.Record = record
    monkeypatch.setitem(sys.modules, module.__name__, module)
    kept: Any = _KernelCacheFile(str(tmp_path), "kernel", ("stamp", "digest"))  # type: ignore[no-untyped-call]
    kept.save(record, b"machine code")
    assert kept.load(record) == b"machine code"
    del module.Record
    assert kept.load(record) is None
    with pytest.raises(AttributeError):  # what Numba's own does
        super(_KernelCacheFile, kept)._load_index()
    kept.save("another", b"new code")
    assert kept.load("another") == b"new code"


def test_code_of_modules_that_are_no_more_is_compiled_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The index has the kernel, and its machine code needs a module that the package no longer has."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def twice(x: float) -> float:
        return 2.0 * x

    first: Any = kernel(twice)
    assert first(3.0) == 6.0 and first.stats.cache_misses
    again: Any = kernel(twice)
    assert again(3.0) == 6.0 and again.stats.cache_hits

    def gone(*_: Any) -> Any:
        raise ModuleNotFoundError("No module named 'of_an_older_version'")

    monkeypatch.setattr(FunctionCache, "load_overload", gone)
    stale: Any = kernel(twice)
    assert stale(3.0) == 6.0 and stale.stats.cache_misses and not stale.stats.cache_hits
