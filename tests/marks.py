"""Marks of long tests, which `make test` leaves out."""

from collections.abc import Callable
from typing import TypeVar

import pytest

_Test = TypeVar("_Test", bound=Callable[..., None])
#: Of those that CI runs all the same; the others have `pytest.mark.slow` alone.
CI_SLOW = (pytest.mark.slow, pytest.mark.ci_slow)


def ci_slow(test: _Test) -> _Test:
    """A test with `CI_SLOW`."""
    marked: _Test = pytest.mark.slow(pytest.mark.ci_slow(test))
    return marked
