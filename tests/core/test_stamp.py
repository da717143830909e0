"""What makes a kernel be compiled anew, and what does not."""

import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numba
import pytest

from soundspaces_sim.core.numerics import stamp
from soundspaces_sim.core.numerics.stamp import code_digest, field_names

FILES = {
    "constants": "LIMIT = 3.0\nUNUSED = 1\n",
    "parts": '''
import math
import numpy as np
from typing import NamedTuple
from soundspaces_sim.core.numerics.kernel import part
from toykernels import constants
from toykernels.constants import LIMIT

TABLE = np.array([1.0, 2.0])

class Pair(NamedTuple):
    a: float
    b: float

@part
def inner(x):
    """Words."""
    return math.sqrt(x) + TABLE[1]

@part
def outer(x):
    return inner(x) * constants.LIMIT + LIMIT

def error():
    raise ValueError("a message")
''',
    "kernels": '''
from soundspaces_sim.core.numerics.kernel import kernel
from toykernels import parts

@kernel
def run(first, last, out):
    """Words."""
    for i in range(first, last):
        out[i] = parts.outer(1.0 * i) + later(i)

def later(i):
    return i
''',
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "toykernels"
    folder.mkdir()
    for name, text in {"__init__": "", **FILES}.items():
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield folder
    _forget()


def _forget() -> None:
    for name in [n for n in sys.modules if n.startswith("toykernels")]:
        del sys.modules[name]


def _digest() -> str:
    _forget()
    importlib.invalidate_caches()
    module: ModuleType = importlib.import_module("toykernels.kernels")
    return code_digest(module.run.py_func)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("parts", "a message", "another message"),
        ("parts", '"""Words."""', '"""Other words."""'),
        ("kernels", '"""Words."""', '"""Other\n\n    words."""'),
        ("kernels", "from toykernels", "\n\n\nfrom toykernels"),
        ("constants", "UNUSED = 1", "UNUSED = 2"),
    ],
)
def test_words_and_what_is_not_called_change_nothing(
    package: Path, file: str, old: str, new: str
) -> None:
    before = _digest()
    path = package / f"{file}.py"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    assert _digest() == before


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("constants", "LIMIT = 3.0", "LIMIT = 4.0"),
        ("parts", "TABLE = np.array([1.0, 2.0])", "TABLE = np.array([1.0, 2.5])"),
        ("parts", "math.sqrt(x)", "math.cos(x)"),
        ("parts", "@part\ndef inner", "@part(fastmath=True)\ndef inner"),
        ("kernels", "    return i", "    return i + 1"),
        ("kernels", "+ later(i)", "- later(i)"),
    ],
)
def test_what_is_compiled_in_changes_it(package: Path, file: str, old: str, new: str) -> None:
    before = _digest()
    path = package / f"{file}.py"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    assert _digest() != before


@pytest.mark.usefixtures("package")
def test_other_compilers_change_it(monkeypatch: pytest.MonkeyPatch) -> None:
    before = _digest()
    monkeypatch.setattr(stamp, "KernelCompiler", Path)
    assert _digest() != before


def test_fields_of_records_in_another_order_are_other_arguments() -> None:
    def fields(*names: str) -> Any:
        make: Any = NamedTuple
        record = make("Record", [(name, float) for name in names])
        kind: Any = numba.typeof
        return field_names((kind(((record(1.0, 2.0), 3),)),))

    assert fields("a", "b") == (("a", "b"),) != fields("b", "a")


def test_options_that_are_sets_say_the_same_in_every_process() -> None:
    """Python orders a set of words anew in each process: a kernel would be compiled again in every other one."""
    code = (
        "from soundspaces_sim.core.numerics.kernel import part\n"
        "from soundspaces_sim.core.numerics.stamp import code_digest\n"
        "@part(fastmath={'reassoc', 'contract', 'nsz', 'arcp'})\n"
        "def inner(x):\n    return x + 1.0\n"
        "def outer(x):\n    return inner(x)\n"
        "print(*inner.targetoptions['fastmath'])\n"
        "print(code_digest(outer))"
    )
    command = [sys.executable, "-c", code]
    found = [
        subprocess.run(
            command,
            env={**os.environ, "PYTHONHASHSEED": seed},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for seed in "12"
    ]
    (orders, others), digests = zip(*(text.splitlines() for text in found), strict=True)
    assert orders != others and len({*digests}) == 1
