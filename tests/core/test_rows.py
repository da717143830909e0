"""Rows that are alike, against NumPy's own answer."""

import numpy as np
import pytest

from soundspaces_sim.core.numerics.rows import unique_rows


@pytest.mark.parametrize("shape", [(0, 3), (1, 2), (500, 1), (2000, 3), (300, 9)])
@pytest.mark.parametrize("kind", [int, float])
def test_as_numpy(shape: tuple[int, int], kind: type) -> None:
    rows: np.ndarray = np.random.default_rng(0).integers(-3, 4, shape).astype(kind)
    unique, index, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    first, of_row = unique_rows(rows)
    np.testing.assert_array_equal(first, index)
    np.testing.assert_array_equal(rows[first], unique)
    np.testing.assert_array_equal(of_row, inverse.ravel())


def test_zeros_of_either_sign_are_alike() -> None:
    first, of_row = unique_rows(np.array([[0.0, 1.0], [-1.0, 0.0], [-0.0, 1.0]]))
    assert first.tolist() == [1, 0] and of_row.tolist() == [1, 0, 1]
