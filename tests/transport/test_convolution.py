"""Products of points' tables: against sums, and to the same bits wherever a point stands."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import llvmlite.binding
import numpy as np
import pytest

from soundspaces_sim.transport.radiance_transfer.convolution import (
    PLAIN,
    Kind,
    accumulate,
    make_convolution,
    transform,
)

P, Q, T, PATCHES, FIRST = 33, 48, 23, 41, 4
_NARROW = {"NUMBA_CPU_NAME": "x86-64-v3", "NUMBA_CPU_FEATURES": "+avx,+avx2,+bmi,+bmi2,+f16c,+fma"}


def _histograms(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Of P and of Q points, at the patches."""
    rows, columns = (random.random((n, T, PATCHES), np.float32) for n in (P, Q))
    return rows, columns


def _spectra(*histograms: np.ndarray) -> list[np.ndarray]:
    convolution = make_convolution(T, FIRST)
    out = [np.empty((len(convolution.forward), 1, len(x), x.shape[2]), np.float32) for x in histograms]
    for x, spectra in zip(histograms, out, strict=True):
        transform(convolution, x[:, None], spectra)
    return [spectra[:, 0] for spectra in out]


def _accumulated(rows: np.ndarray, columns: np.ndarray, kind: Kind = PLAIN) -> np.ndarray:
    """(P, Q, T - FIRST), of a table with itself."""
    (products, p, _), q = rows.shape, columns.shape[1]
    out = np.zeros((1, p, q, T - FIRST), np.float32)
    scratch = np.empty(products * p * q, np.float32)
    accumulate(make_convolution(T, FIRST), rows[:, None], columns[:, None], scratch, out, kind=kind)
    return np.asarray(out[0])


def _convolved(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(P, Q, T - FIRST) convolutions of histograms (P, T, patches) and (Q, T, patches), summed over patches."""
    left, right = _spectra(rows, columns)
    return _accumulated(left, right)


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
    for p, q in ((16, 32), (1, 1), (1, 4), (2, 3), (5, 1), (8, 9), (16, 3), (17, 1), (1, 32), (5, 33)):
        found = _convolved(outgoing[:p], incident[-q:])
        np.testing.assert_array_equal(found, whole[:p, -q:])


def test_what_is_crossed_is_the_same_either_way_round() -> None:
    """x_a y_b + y_a x_b, to the last bit that with a and b exchanged, and half of the pairs where a is b."""
    random = np.random.default_rng(2)
    (x_a, x_b), (y_a, y_b) = _spectra(*_histograms(random)), _spectra(*_histograms(random))
    a, b = np.concatenate([x_a, y_a], axis=-1), np.concatenate([x_b, y_b], axis=-1)
    there, back = _accumulated(a, b, Kind(crossed=True)), _accumulated(b, a, Kind(crossed=True))
    np.testing.assert_array_equal(there, back.swapaxes(0, 1))
    np.testing.assert_allclose(there, _accumulated(x_a, y_b) + _accumulated(y_a, x_b), rtol=1e-4)
    few = _accumulated(a[:, :5], b[:, 7:9], Kind(crossed=True))
    np.testing.assert_array_equal(few, there[:5, 7:9])
    whole, half = _accumulated(a, a, Kind(crossed=True)), _accumulated(a, a, Kind(True, symmetric=True))
    i, j = np.triu_indices(P)
    np.testing.assert_array_equal(half[i, j], whole[i, j])
    assert not half[P - 1, :8].any()


def test_several_tables_are_each_with_its_own() -> None:
    """And some points and steps of theirs alone."""
    random = np.random.default_rng(3)
    left, right = _spectra(*_histograms(random))
    rows, columns = (np.stack([side, side[::-1]], axis=1) for side in (left, right))
    out, some = np.zeros((2, P, Q, T), np.float32), (slice(5, 30), slice(FIRST, T))
    accumulate(
        make_convolution(T, FIRST),
        rows,
        columns,
        np.empty(2 * left[..., 0].size * Q, np.float32),
        out,
        some,
    )
    for table, (row, column) in zip(out, ((left, right), (left[::-1], right[::-1])), strict=True):
        np.testing.assert_array_equal(table[:, 5:30, FIRST:], _accumulated(row, column)[:, 5:30])
    assert not (out[:, :, :5].any() or out[:, :, 30:].any() or out[..., :FIRST].any())


def test_more_columns_than_are_transformed_back_together() -> None:
    random = np.random.default_rng(4)
    outgoing, incident = (random.random((n, T, PATCHES), np.float32) for n in (7, 300))
    whole = _convolved(outgoing, incident)
    np.testing.assert_array_equal(whole[:, 251:], _convolved(outgoing, incident[251:]))


def test_half_of_the_pairs_of_some_points() -> None:
    """Of points with themselves, of several tables, from the fifth point on."""
    (left,) = _spectra(np.random.default_rng(5).random((Q, T, PATCHES - 1), np.float32))
    tables, some = np.stack([left, left[::-1]], axis=1), (slice(5, None), slice(FIRST, T))
    out = np.zeros((2, 2, Q, Q, T), np.float32)
    scratch = np.empty(2 * left[..., 0].size * Q, np.float32)
    for half in (0, 1):
        kind = Kind(crossed=True, symmetric=bool(half))
        accumulate(make_convolution(T, FIRST), tables, tables, scratch, out[half], some, kind)
    i, j = np.triu_indices(Q)
    i, j = i[j >= 5], j[j >= 5]
    assert out[0][:, i, j, FIRST:].any(axis=2).all()
    np.testing.assert_array_equal(out[1][:, i, j], out[0][:, i, j])


def test_columns_of_tables_may_lie_apart() -> None:
    left, right = _spectra(*_histograms(np.random.default_rng(6)))
    apart, copied = left[..., ::2], np.ascontiguousarray(left[..., ::2])
    np.testing.assert_array_equal(
        _accumulated(apart, right[..., ::2]), _accumulated(copied, right[..., ::2])
    )


def print_digest() -> None:
    """SHA-256 of convolutions, on stdout."""
    print(hashlib.sha256(_convolved(*_histograms(np.random.default_rng(7))).tobytes()).hexdigest())


@pytest.mark.skipif(
    not llvmlite.binding.get_host_cpu_features().get("fma"), reason="a processor without FMA"
)
def test_bits_do_not_depend_on_the_width_of_vectors(tmp_path: Path) -> None:
    """Of processors that fuse products and sums."""
    command = [sys.executable, "-c", f"from {__name__} import print_digest; print_digest()"]
    digests = [
        subprocess.run(
            command,
            env={**os.environ, **more, "NUMBA_CACHE_DIR": str(tmp_path / name), "OPENBLAS_CORETYPE": "Haswell"},
            capture_output=True, text=True, check=True,
        ).stdout
        for name, more in (("wide", {}), ("narrow", _NARROW))
    ]  # fmt: skip
    assert digests[0] == digests[1] != ""
