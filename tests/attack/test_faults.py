"""Every k-th open, write, fsync, rename, read and unlink fails once: the old state or the new, and an error of ours."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.marks import ci_slow

ROOT = Path(__file__).resolve().parents[2]
LEAST = {"build": 100, "mend": 150, "export": 30, "read": 100, "verify": 100}  # calls that can fail


def _fail(folder: Path, step: int) -> None:
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("needs a C compiler and LD_PRELOAD")
    library = folder / "faults.so"
    source = Path(__file__).with_name("faults.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    done = subprocess.run(
        [sys.executable, "-m", "tests.attack.faults", str(folder), str(step)],
        cwd=ROOT, capture_output=True, text=True, env={**os.environ, "LD_PRELOAD": str(library)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    print(done.stdout)
    results = {line["scenario"]: line for line in map(json.loads, done.stdout.splitlines())}
    assert set(results) == set(LEAST)
    for name, result in results.items():
        assert not result["wrong"], (name, result["wrong"])
        assert result["calls"] >= LEAST[name] and result["tried"] >= result["calls"] // step
        assert result["own"] > 0


@ci_slow
def test_some_calls_fail(tmp_path: Path) -> None:
    _fail(tmp_path, 61)


@pytest.mark.slow
def test_every_call_fails(tmp_path: Path) -> None:
    _fail(tmp_path, 1)
