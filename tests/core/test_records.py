"""Records of some packages are passed whole to parts: as one argument, with the same values."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.records import pass_whole
from soundspaces_sim.scene.rays.geometry import Hit

pass_whole(__name__)


class _Inner(NamedTuple):
    table: np.ndarray
    number: int


class _Outer(NamedTuple):
    inner: _Inner
    hit: Hit
    factor: float


@part
def _distance(hit: Hit) -> float:
    return hit.distance


@part
def _scaled(record: _Outer, row: int) -> _Outer:
    return _Outer(record.inner, record.hit, record.factor * record.inner.table[row])


@part
def _sum(record: _Outer) -> float:
    return float(record.inner.table[record.inner.number] * record.factor + _distance(record.hit))


def _arguments(compiled: Any) -> int:
    """That LLVM is given in the one version of a part, but for where the result and an error go."""
    (result,) = compiled.overloads.values()
    return len(list(result.library.get_function(result.fndesc.llvm_func_name).arguments)) - 2


def test_they_have_their_values_and_are_one_argument_each() -> None:
    # Not a kernel, which would be loaded from the cache.
    def fill(record: _Outer, out: np.ndarray) -> None:
        for i in range(len(out)):
            out[i] = _sum(_scaled(record, i)) + _sum(_scaled(record, 0))  # 0 takes no version of its own

    options: dict[str, Any] = {"_nrt": False}  # parts count no references
    inner = _Inner(np.array([2.0, 3.0, 5.0]), 2)
    record = _Outer(inner, Hit(0.25, 4, (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 0), 7.0)
    out = np.empty(3)
    numba.njit(**options)(fill)(record, out)
    assert out.tolist() == [140.5, 175.5, 245.5]
    assert _arguments(_sum) == 1 and _arguments(_scaled) == 2
    assert _arguments(_distance) == 9  # of another package: field by field
