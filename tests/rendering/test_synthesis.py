"""Kernels of synthesis, against slow twins that follow the formulas."""

import numpy as np
import pytest

from soundspaces_sim.core.numerics.axes import DEGREE, spherical_harmonics
from soundspaces_sim.rendering.synthesis import (
    decode,
    gather,
    make_scratch,
    modulate,
    modulate_waves,
    place,
)

NOISE = np.random.default_rng(0).normal(size=1 << 10).astype(np.float32)
EDGES = np.array([0.0, 0.002, 0.003, 0.0071, 0.0074, 0.02])  # s
DT, SAMPLES = 1.0 / 4000.0, 100


def _per_sample(energy: np.ndarray) -> np.ndarray:
    """(n, …) of energies (bins, …), spread evenly over each bin; a sample covers half an interval on either side."""
    times = (np.arange(SAMPLES + 1) - 0.5) * DT
    cumulative = np.concatenate([np.zeros_like(energy[:1]), np.cumsum(energy, axis=0)])
    columns = cumulative.reshape(len(EDGES), -1).T
    at = np.stack([np.interp(np.maximum(times, 0.0), EDGES, column) for column in columns], axis=1)
    return np.diff(at, axis=0).reshape(SAMPLES, *energy.shape[1:])


def _moments(rng: np.random.Generator, arrivals: int) -> np.ndarray:
    """(bins, 9) of so many arrivals in each bin, from random directions; the second bin is empty."""
    out = np.zeros((len(EDGES) - 1, 9))
    for i in (0, 2, 3, 4):
        d = rng.normal(size=(arrivals, 3))
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        out[i] = rng.random(arrivals) @ spherical_harmonics(d)
    return out


@pytest.mark.parametrize("start", [17, 950, 5000])
@pytest.mark.parametrize("arrivals", [1, 2, 40])
def test_modulated_noise_has_the_energy_and_covariance_of_each_bin(arrivals: int, start: int) -> None:
    """Sample by sample, also where channels pass the end of the table of noise within a bin. The first sample is half
    as long as others, and lies in a bin as the next ones do: all of that bin had half of their energy."""
    energy = _moments(np.random.default_rng(1), arrivals)
    lane, out = 101, np.empty((9, SAMPLES), np.float32)
    modulate(out, energy.astype(np.float32), EDGES, DT, NOISE, start, lane, make_scratch())

    for t, s in enumerate(_per_sample(energy)):
        own = NOISE[(start + t + lane * np.arange(9)) % len(NOISE)].astype(float)  # channel 0: shared
        if s[0] < 1e-12:
            np.testing.assert_allclose(out[:, t], 0.0, atol=1e-5)
            continue
        y, z, x = (s[1:4] / s[0]).tolist()
        v, w, r, u, p = (s[4:] / s[0]).tolist()  # order 2: xy, yz, z², xz, x² - y²
        root3 = np.sqrt(3.0)
        zz = (1.0 + 2.0 * r) / 3.0
        yy, xx = 0.5 * (1.0 - zz) - p / root3, 0.5 * (1.0 - zz) + p / root3
        second = np.array(
            [[yy, w / root3, v / root3], [w / root3, zz, u / root3], [v / root3, u / root3, xx]]
        )
        rest = second - np.outer([y, z, x], [y, z, x])  # mean(d d^T) - mean(d) mean(d)^T
        expected = s / np.sqrt(s[0]) * own[0]
        expected[1:4] += np.sqrt(s[0]) * _cholesky(rest) @ own[1:4]
        left = max(1.0 - (s[4:] ** 2).sum() / s[0] ** 2, 0.0)
        expected[4:] += np.sqrt(s[0] * left / 5.0) * own[4:]
        scale = np.sqrt(s[0]) * np.abs(own).max()
        np.testing.assert_allclose(out[:, t], expected, atol=2e-3 * scale)


def _cholesky(matrix: np.ndarray) -> np.ndarray:
    """Lower factor of a positive semidefinite (3, 3) matrix, whose pivots may be zero."""
    out = np.zeros((3, 3))
    for i in range(3):
        pivot = matrix[i, i] - out[i] @ out[i]
        if pivot < 1e-6:
            continue
        out[i, i] = np.sqrt(pivot)
        for k in range(i + 1, 3):
            out[k, i] = (matrix[k, i] - out[k] @ out[i]) / out[i, i]
    return out


def test_waves_carry_their_energies() -> None:
    rng = np.random.default_rng(2)
    energy = rng.random((len(EDGES) - 1, 5))
    energy[1] = 0.0
    starts, out = rng.integers(len(NOISE), size=5), np.empty((5, SAMPLES), np.float32)
    work = np.empty(5), np.empty(5, np.float32)
    modulate_waves(out, energy, EDGES, DT, NOISE, starts, work)
    noise = NOISE[(starts[:, None] + np.arange(SAMPLES)) % len(NOISE)]
    np.testing.assert_allclose(out, np.sqrt(_per_sample(energy)).T * noise, rtol=1e-4, atol=1e-6)


def test_gathered_waves_are_a_sum_of_phasors() -> None:
    """More bins than a block of phasors has, and than a chunk of blocks."""
    rng, (receivers, waves, bins, first, block) = np.random.default_rng(3), (2, 3, 700, 11, 64)
    spectra = rng.normal(size=(waves, 2, bins)).astype(np.float32)
    turns, weights = rng.uniform(-2.0, 2.0, (2, receivers, waves))
    out = np.zeros((receivers, 2, first + bins + 5), np.float32)
    work = np.empty(block, np.float32), np.empty(block, np.float32)
    gather(out, spectra, first, turns, weights.astype(np.float32), work)
    f = first + np.arange(bins)
    phasors = np.exp(1j * turns[:, :, None] * f)
    expected = np.einsum("rk,rkf,kf->rf", weights, phasors, spectra[:, 0] + 1j * spectra[:, 1])
    found = out[:, 0, first : first + bins] + 1j * out[:, 1, first : first + bins]
    np.testing.assert_allclose(found, expected, atol=2e-4)
    assert not out[:, :, :first].any() and not out[:, :, first + bins :].any()


def test_placed_responses_are_cut_at_both_ends() -> None:
    rng = np.random.default_rng(4)
    responses = rng.normal(size=(4, 10)).astype(np.float32)
    starts, gains = np.array([-4, 0, 12, 25]), rng.normal(size=(4, 3)).astype(np.float32)
    out = np.zeros((3, 30), np.float32)
    place(out, responses, starts, gains)
    expected = np.zeros((3, 60))
    for response, start, gain in zip(responses, starts, gains, strict=True):
        expected[:, 15 + start : 25 + start] += np.outer(gain, response)
    np.testing.assert_allclose(out, expected[:, 15:45], atol=1e-6)


def test_decoded_ears_are_matrix_products() -> None:
    rng, bins = np.random.default_rng(5), 37
    spectrum, filters = (
        (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)
        for shape in ((9, bins), (2, 9, bins))
    )
    matrix = np.where(DEGREE[:, None] == DEGREE, rng.normal(size=(9, 9)), 0.0)
    matrix[5, 6] = 0.0
    out = np.empty((2, bins), np.complex64)
    decode(out, spectrum, matrix, filters, np.empty(bins, np.complex64))
    np.testing.assert_allclose(out, np.einsum("ecf,cd,df->ef", filters, matrix, spectrum), atol=1e-4)
