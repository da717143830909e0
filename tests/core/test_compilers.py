"""Parts are compiled into kernels and are no machine code by themselves; kernels are called and never linked."""

from __future__ import annotations

from typing import Any

import llvmlite.binding
import numba
import numpy as np
import pytest

from soundspaces_sim.core.numerics import rng
from soundspaces_sim.core.numerics.compilers import KernelCompiler
from soundspaces_sim.core.numerics.kernel import kernel, part

OFFSETS = np.array([2.0, 3.0])


@part
def _inner(x: float) -> float:
    return float(x + OFFSETS[1])


@part
def _outer(x: float, n: int) -> float:
    return x if n == 0 else 2.0 * _inner(x)


def test_a_kernel_has_its_parts_and_parts_are_linked_alone() -> None:
    # Not a kernel, which would be loaded from the cache.
    @numba.njit
    def doubled(x: np.ndarray) -> None:
        for i in range(len(x)):
            x[i] = _outer(x[i], i)

    x = np.array([1.0, 1.0, 2.0])
    doubled(x)
    assert x.tolist() == [1.0, 8.0, 10.0]
    for compiled in (_inner, _outer):
        (result,) = compiled.overloads.values()
        assert result.library.get_pointer_to_function(result.fndesc.llvm_func_name) == 0
        assert "define" in result.library.get_llvm_str()


def test_parts_in_a_kernel_are_called_by_it_alone() -> None:
    """So that arguments that a part does not read may be dropped."""

    @part
    def countdown(x: float, unread: np.ndarray, n: int) -> float:
        return countdown(2.0 * x, unread, n - 1) if n > 0 else x  # recursion: it cannot be inlined

    def powers(x: np.ndarray) -> None:
        for i in range(len(x)):
            x[i] = countdown(x[i], x, i)

    options: dict[str, Any] = {"pipeline_class": KernelCompiler, "_nrt": False}
    compiled, x = numba.njit(**options)(powers), np.ones(4)
    compiled(x)
    assert x.tolist() == [1.0, 2.0, 4.0, 8.0]
    (result,) = compiled.overloads.values()
    others = [f for f in result.library.get_defined_functions() if "countdown" in f.name]
    assert others and all(f.linkage == llvmlite.binding.Linkage.internal for f in others)
    assert not any("unread" in str(f).partition("{")[0] for f in others)


def _tripled(x: np.ndarray) -> None:
    for i in range(len(x)):
        x[i] *= 1.5 * OFFSETS[0]


def test_a_kernel_from_the_disk_is_called_and_not_linked() -> None:
    x = np.array([1.0, 2.0])
    kernel(_tripled)(x)  # compiles it, or finds it compiled
    again = kernel(_tripled)
    again(x)
    assert x.tolist() == [9.0, 18.0] and sum(again.stats.cache_hits.values()) == 1
    (result,) = again.overloads.values()
    with pytest.raises(RuntimeError, match="unfit for linking"):
        result.library._get_module_for_linking()

    @numba.njit
    def caller(x: np.ndarray) -> None:
        again(x)

    with pytest.raises(RuntimeError, match="unfit for linking"):
        caller(x)


def test_errors_of_parts_are_numbas() -> None:
    @part
    def wrong(x: float) -> float:
        return x + "a"  # type: ignore[operator]

    @kernel
    def caller(x: np.ndarray) -> None:
        x[0] = wrong(x[0])

    with pytest.raises(Exception, match=r"No implementation of function .*add"):
        caller(np.zeros(1))


def test_parts_are_run_from_python_by_their_source() -> None:
    assert rng.combine.py_func is not None and _inner.py_func(1.0) == 4.0
