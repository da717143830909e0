"""Products of points' tables: against sums, and to the same bits wherever a point stands."""

import os
import platform
import subprocess
import sys

import numpy as np
import pytest

from soundspaces_sim.transport.radiance_transfer.convolution import (
    BLOCK,
    accumulate,
    make_convolution,
    padded,
    transform,
)

P, Q, T, PATCHES, FIRST = 2 * BLOCK, 3 * BLOCK, 23, 40, 4


def _histograms(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Of P and of Q points, at the patches."""
    rows, columns = (random.random((n, T, PATCHES), np.float32) for n in (P, Q))
    return rows, columns


def _convolved(
    rows: np.ndarray, columns: np.ndarray, points: tuple[int, int] | None = None
) -> np.ndarray:
    """(P, Q, T - FIRST) convolutions of histograms (P, T, patches) and (Q, T, patches), summed over patches; of the
    first `points` of each alone, if that is given."""
    convolution = make_convolution(T, FIRST)
    products = len(convolution.forward)
    spectra = [np.empty((products, len(x), x.shape[2]), np.float32) for x in (rows, columns)]
    for x, out in zip((rows, columns), spectra, strict=True):
        transform(convolution, x, out)
    out = np.zeros((*(points or (len(rows), len(columns))), T - FIRST), np.float32)
    scratch = np.empty((products, len(rows) * len(columns)), np.float32)
    accumulate(convolution, spectra[0], spectra[1], scratch, out)
    return out


def test_convolutions_are_sums() -> None:
    outgoing, incident = _histograms(np.random.default_rng(0))
    found = _convolved(outgoing, incident)
    for p, q in ((0, 0), (5, 40), (P - 1, Q - 1)):
        pairs = zip(outgoing[p].astype(float).T, incident[q].astype(float).T, strict=True)
        expected = sum(np.convolve(x, y)[FIRST:T] for x, y in pairs)
        np.testing.assert_allclose(found[p, q], expected, rtol=2e-5)


def test_where_a_point_stands_does_not_matter() -> None:
    """To the last bit, in tables of any size."""
    random = np.random.default_rng(1)
    outgoing, incident = _histograms(random)
    whole = _convolved(outgoing, incident)
    rows, columns = random.permutation(P), random.permutation(Q)
    np.testing.assert_array_equal(_convolved(outgoing[rows], incident[columns]), whole[rows][:, columns])
    np.testing.assert_array_equal(_convolved(outgoing[:BLOCK], incident[BLOCK:]), whole[:BLOCK, BLOCK:])
    for p, q in ((1, 1), (1, 4), (2, 3), (5, 1), (8, 8), (8, 9), (16, 3), (17, 1)):
        _check_few(outgoing[:p], incident[-q:], whole[:p, -q:])


def _check_few(outgoing: np.ndarray, incident: np.ndarray, expected: np.ndarray) -> None:
    """Few points share products: the same bits, whichever points stand beside them."""
    found = _convolved(_in_blocks(outgoing), _in_blocks(incident), expected.shape[:2])
    np.testing.assert_array_equal(found, expected)


def _in_blocks(histograms: np.ndarray) -> np.ndarray:
    return np.pad(histograms, ((0, padded(len(histograms)) - len(histograms)), (0, 0), (0, 0)))


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="kernels of x86-64")
@pytest.mark.parametrize("kind", ["Haswell", "Zen", "Sandybridge", "Nehalem"])
def test_nor_does_it_on_other_kinds_of_processor(kind: str) -> None:
    """NumPy's OpenBLAS has kernels for each, of which those for AVX2 add up differently within a product."""
    code = "from tests.transport import test_convolution as t; t.test_where_a_point_stands_does_not_matter()"
    environment = {**os.environ, "OPENBLAS_CORETYPE": kind}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True, timeout=300)
