"""Marks of long tests, which `make test` leaves out."""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import pytest

_Test = TypeVar("_Test", bound=Callable[..., None])
#: Of those that CI runs all the same; the others have `pytest.mark.slow` alone.
CI_SLOW = (pytest.mark.slow, pytest.mark.ci_slow)


def few(values: Iterable[Any], *quick: Any) -> list[Any]:
    """`values` for `parametrize`, tuples for several arguments: those that are `quick`, and others with `CI_SLOW`."""
    every = list(values)
    assert all(value in every for value in quick), "a quick one is not among the values"
    return [
        v if v in quick else pytest.param(*(v if isinstance(v, tuple) else (v,)), marks=CI_SLOW)
        for v in every
    ]


def ci_slow(test: _Test) -> _Test:
    """A test with `CI_SLOW`."""
    marked: _Test = pytest.mark.slow(pytest.mark.ci_slow(test))
    return marked
