"""Compiled code that is kept on disk."""

import sys
import types
from pathlib import Path
from typing import Any

import pytest

from soundspaces_sim.core.numerics.kernel import _KernelCacheFile


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
