"""Vector algebra in kernels, against NumPy's."""

from typing import NamedTuple

import numpy as np
import pytest

from soundspaces_sim.core.numerics import vec3
from soundspaces_sim.core.numerics.kernel import kernel


class _Results(NamedTuple):
    """Of n pairs of vectors a, b; of unit vectors for `mirrored` (a at b) and `frames` (of a)."""

    vectors: np.ndarray  # (n, 8, 3) a + b, a - b, 2.5 a, a / 3, -a, a + 0.7 b, a × b, a / |a|
    numbers: np.ndarray  # (n, 3) a · b, |a|, |a - b|
    mirrored: np.ndarray  # (n, 3)
    frames: np.ndarray  # (n, 2, 3)


@kernel
def _compute(
    a: np.ndarray, b: np.ndarray, unit_a: np.ndarray, unit_b: np.ndarray, out: _Results
) -> None:
    for i in range(len(a)):
        p, q, vectors = vec3.row(a, i), vec3.row(b, i), out.vectors[i]
        vec3.put(vectors, 0, vec3.add(p, q))
        vec3.put(vectors, 1, vec3.subtract(p, q))
        vec3.put(vectors, 2, vec3.scale(2.5, p))
        vec3.put(vectors, 3, vec3.divide(p, 3.0))
        vec3.put(vectors, 4, vec3.negate(p))
        vec3.put(vectors, 5, vec3.along(p, 0.7, q))
        vec3.put(vectors, 6, vec3.cross(p, q))
        vec3.put(vectors, 7, vec3.normalize(p))
        out.numbers[i, 0], out.numbers[i, 1] = vec3.dot(p, q), vec3.length(p)
        out.numbers[i, 2] = vec3.distance(p, q)
        u, v = vec3.row(unit_a, i), vec3.row(unit_b, i)
        vec3.put(out.mirrored, i, vec3.reflect(u, v))
        s, t = vec3.orthonormal_frame(u)
        vec3.put(out.frames[i], 0, s)
        vec3.put(out.frames[i], 1, t)


_N = 200


def _unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


@pytest.fixture(scope="module")
def given() -> tuple[np.ndarray, np.ndarray]:
    a, b = np.random.default_rng(0).normal(size=(2, _N, 3))
    a[:6] = [*np.eye(3), *-np.eye(3)]  # a frame's formula changes sign at the poles
    return a, b


@pytest.fixture(scope="module")
def results(given: tuple[np.ndarray, np.ndarray]) -> _Results:
    shapes = (_N, 8, 3), (_N, 3), (_N, 3), (_N, 2, 3)
    out = _Results(*(np.full(shape, np.nan) for shape in shapes))
    _compute(*given, _unit(given[0]), _unit(given[1]), out)
    return out


def test_vectors(given: tuple[np.ndarray, np.ndarray], results: _Results) -> None:
    a, b = given
    of_numpy = [a + b, a - b, 2.5 * a, a / 3.0, -a, a + 0.7 * b, np.cross(a, b)]
    for k, expected in enumerate(of_numpy):
        np.testing.assert_array_equal(results.vectors[:, k], expected)
    np.testing.assert_allclose(results.vectors[:, 7], _unit(a), rtol=1e-15)


def test_numbers(given: tuple[np.ndarray, np.ndarray], results: _Results) -> None:
    a, b = given
    expected = [(a * b).sum(axis=1), np.linalg.norm(a, axis=1), np.linalg.norm(a - b, axis=1)]
    np.testing.assert_allclose(results.numbers, np.stack(expected, axis=1), rtol=1e-14, atol=1e-15)


def test_mirror(given: tuple[np.ndarray, np.ndarray], results: _Results) -> None:
    u, n = _unit(given[0]), _unit(given[1])
    householder = np.eye(3) - 2.0 * n[:, :, None] * n[:, None, :]
    np.testing.assert_allclose(
        results.mirrored, np.einsum("nij,nj->ni", householder, u), rtol=0.0, atol=1e-15
    )


def test_frame_is_orthonormal_and_right_handed(
    given: tuple[np.ndarray, np.ndarray], results: _Results
) -> None:
    frame = np.concatenate([results.frames, _unit(given[0])[:, None]], axis=1)
    np.testing.assert_allclose(
        frame @ frame.transpose(0, 2, 1), np.tile(np.eye(3), (_N, 1, 1)), rtol=0.0, atol=1e-15
    )
    np.testing.assert_allclose(np.linalg.det(frame), 1.0, rtol=1e-14)
