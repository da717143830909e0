"""Products of points' tables: against sums, and to the same bits wherever a point stands."""

import os
import platform
import subprocess
import sys

import numpy as np
import pytest

from soundspaces_sim.transport.radiance_transfer.convolution import (
    BLOCK,
    make_convolution,
    meet,
    transform,
)

P, Q, T, COLUMNS, FIRST = 2 * BLOCK, 3 * BLOCK, 23, 40, 4


def _met(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(P, Q, T - FIRST) convolutions of rows (P, T, columns) and (Q, T, columns), summed over columns."""
    convolution = make_convolution(T, FIRST)
    products = len(convolution.forward)
    turned = [np.empty((products, len(x), x.shape[2]), np.float32) for x in (one, other)]
    for x, out in zip((one, other), turned, strict=True):
        transform(convolution, x, out)
    out = np.zeros((len(one), len(other), T - FIRST), np.float32)
    meet(convolution, turned[0], turned[1], np.empty((products, len(one) * len(other)), np.float32), out)
    return out


def test_convolutions_are_sums() -> None:
    random = np.random.default_rng(0)
    one, other = random.random((P, T, COLUMNS), np.float32), random.random((Q, T, COLUMNS), np.float32)
    met = _met(one, other)
    for p, q in ((0, 0), (5, 40), (P - 1, Q - 1)):
        pairs = zip(one[p].astype(float).T, other[q].astype(float).T, strict=True)
        expected = sum(np.convolve(x, y)[FIRST:T] for x, y in pairs)
        np.testing.assert_allclose(met[p, q], expected, rtol=2e-5)


def test_where_a_point_stands_does_not_matter() -> None:
    """To the last bit, in tables of any size."""
    random = np.random.default_rng(1)
    one, other = random.random((P, T, COLUMNS), np.float32), random.random((Q, T, COLUMNS), np.float32)
    whole = _met(one, other)
    rows, columns = random.permutation(P), random.permutation(Q)
    np.testing.assert_array_equal(_met(one[rows], other[columns]), whole[rows][:, columns])
    np.testing.assert_array_equal(_met(one[:BLOCK], other[BLOCK:]), whole[:BLOCK, BLOCK:])


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="kernels of x86-64")
@pytest.mark.parametrize("kind", ["Haswell", "Zen", "Sandybridge", "Nehalem"])
def test_nor_does_it_on_other_kinds_of_processor(kind: str) -> None:
    """NumPy's OpenBLAS has kernels for each, of which those for AVX2 add up differently within a product."""
    code = "from tests.transport import test_convolution as t; t.test_where_a_point_stands_does_not_matter()"
    environment = {**os.environ, "OPENBLAS_CORETYPE": kind}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True, timeout=300)
