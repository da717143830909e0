"""Rows that are alike, in order, and some of them, against NumPy's own answer."""

import numpy as np
import pytest

from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count
from soundspaces_sim.core.numerics.rows import in_order, lexsorted, taken, unique_rows


@pytest.mark.parametrize("shape", [(0, 3), (1, 2), (500, 1), (2000, 3), (300, 9)])
@pytest.mark.parametrize("kind", [int, float])
def test_as_numpy(shape: tuple[int, int], kind: type) -> None:
    rows: np.ndarray = np.random.default_rng(0).integers(-3, 4, shape).astype(kind)
    unique, index, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    first, of_row = unique_rows(rows)
    np.testing.assert_array_equal(first, index)
    np.testing.assert_array_equal(rows[first], unique)
    np.testing.assert_array_equal(of_row, inverse.ravel())


@pytest.mark.parametrize("most", [2**20, 2**40, 2**62])
def test_integers_of_any_size(most: int) -> None:
    """Three of 20 bits fit into one number, larger ones do not."""
    rng = np.random.default_rng(0)
    rows = rng.integers(-most, most, (50, 3))[rng.integers(0, 50, 400)]
    _, index, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    first, of_row = unique_rows(rows)
    np.testing.assert_array_equal(first, index)
    np.testing.assert_array_equal(of_row, inverse.ravel())


def test_zeros_of_either_sign_are_alike() -> None:
    first, of_row = unique_rows(np.array([[0.0, 1.0], [-1.0, 0.0], [-0.0, 1.0]]))
    assert first.tolist() == [1, 0] and of_row.tolist() == [1, 0, 1]


@pytest.mark.parametrize("number", [0, 1, 7, 60_000])
@pytest.mark.parametrize("threads", [1, 3])
def test_sorted_and_taken_as_numpy_does_it(number: int, threads: int) -> None:
    rng = np.random.default_rng(number)
    keys = rng.integers(0, 2, number), rng.random(number).round(1), rng.integers(5, 900, number)
    array = rng.random((number, 4))
    before = thread_count()
    set_thread_count(threads)
    try:
        order = lexsorted(keys)
        found = [taken(array, order), taken(array[:, ::2], order), taken(keys[0], order[::3])]
    finally:
        set_thread_count(before)
    np.testing.assert_array_equal(order, np.lexsort(keys))
    expected = array[order], array[:, ::2][order], keys[0][order[::3]]
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype


@pytest.mark.parametrize("number", [0, 1, 7, 200_000])
@pytest.mark.parametrize("most", [1, 3, 2**11, 2**23, 2**40, 2**62])
def test_many_numbers_are_sorted_as_numpy_does_it(number: int, most: int) -> None:
    key = np.random.default_rng(0).integers(0, most, number)
    ordered, order = in_order(key)
    np.testing.assert_array_equal(order, np.argsort(key, kind="stable"))
    np.testing.assert_array_equal(ordered, key[order])


def test_numbers_that_are_alike_in_some_digits() -> None:
    """Rounds of digits in which all are alike are left out, and their parity does not matter."""
    rng = np.random.default_rng(1)
    for shift in (0, 11, 22, 33):
        key = (1 << 50) + (rng.integers(0, 2**11, 100_000) << shift)
        np.testing.assert_array_equal(in_order(key)[1], np.argsort(key, kind="stable"))


@pytest.mark.parametrize("columns", [2, 6])
def test_many_rows_that_fit_into_no_number(columns: int) -> None:
    rng = np.random.default_rng(2)
    rows = rng.integers(-(2**30), 2**30, (40_000, columns))[rng.integers(0, 40_000, 120_000)]
    _, index, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    first, of_row = unique_rows(rows)
    np.testing.assert_array_equal(first, index)
    np.testing.assert_array_equal(of_row, inverse.ravel())
