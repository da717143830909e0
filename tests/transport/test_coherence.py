"""Levels of arrivals that come together, against the sum of their pressures over the band."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from soundspaces_sim.echogram.echogram import EDGE
from soundspaces_sim.transport.diffraction.coherence import connect
from soundspaces_sim.transport.path_table import PathTable

BANDS, C = (88.0, 176.0, 775.0), 343.0
_AT, _WEIGHT = np.polynomial.legendre.leggauss(
    3
)  # where a wave is known in a band, in log k from -1 to 1
_NONE = np.ones((2, 3))


def _tile(
    direct: np.ndarray,
    length: np.ndarray,
    energy: np.ndarray,
    wave: np.ndarray,
    bands: tuple[float, ...] = BANDS,
) -> Any:
    """One pair, 3 m apart, whose direct sound (b,) is flat, and n paths."""
    n = len(length)
    paths = PathTable(
        pair=np.zeros(n, np.int64),
        length=length,
        at_b=np.zeros((n, 3)),
        at_a=np.zeros((n, 3)),
        energy=energy.copy(),
        planes=np.full((n, 2), -1),
        kind=np.full(n, EDGE),
        wedges=np.zeros((n, 2), np.int64),
        wave=wave.astype(np.complex64),
    )
    return SimpleNamespace(
        same=False,
        model=SimpleNamespace(config=SimpleNamespace(bands=bands, c=C)),
        direct=direct[None, None].copy(),
        direct_wave=np.ones((1, 1, len(direct), 3), complex),
        distance=np.array([[3.0]]),
        walls=np.zeros((1, 1), np.int64),
        discrete={"diffraction": paths},
    )


def _between(x: np.ndarray, wave: np.ndarray) -> np.ndarray:
    """Waves (..., 3) at places x (m,) in a band: the parabola through them, in log k."""
    basis = np.polynomial.polynomial.polyvander(x, 2) @ np.linalg.inv(
        np.polynomial.polynomial.polyvander(_AT, 2)
    )
    return np.asarray(wave @ basis.T)


def _waves(
    length: np.ndarray, wave: np.ndarray, bands: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """((b, m) k evenly in log k, (n, b, m) waves with the phase of their delay)."""
    x = (np.arange(4001) + 0.5) / 2000.5 - 1.0
    edges = 2.0 * np.pi / C * np.array(bands)
    k = np.sqrt(edges[1:] * edges[:-1])[:, None] * (edges[1:] / edges[:-1])[:, None] ** (0.5 * x)
    return k, _between(x, wave) * np.exp(-1j * k * length[:, None, None])


def _level(length: np.ndarray, energy: np.ndarray, wave: np.ndarray) -> np.ndarray:
    """(2,) mean square of the arrivals' sum over each band, evenly in log f."""
    waves = np.sqrt(energy)[:, :, None] * _waves(length, wave, BANDS)[1]
    return np.asarray((np.abs(waves.sum(axis=0)) ** 2).mean(axis=1))


def _random(
    rng: np.random.Generator, n: int, bands: tuple[float, ...] = BANDS
) -> tuple[np.ndarray, np.ndarray]:
    """Energies (n, b) and waves (n, b, 3) like those of diffraction: up to a quarter of a turn, k^(-1/2) to 1, and
    turning by up to half a radian to either side over a band."""
    phase = rng.uniform(-0.5 * np.pi, 0.0, (n, len(bands) - 1, 1))
    tilt = rng.uniform(-0.5, 0.0, phase.shape) - 0.5j * rng.uniform(-1.0, 1.0, phase.shape)
    wave = np.exp(1j * phase + tilt * _AT)
    return rng.uniform(0.1, 1.0, phase.shape[:2]), wave / np.sqrt(
        (np.abs(wave) ** 2 @ (0.5 * _WEIGHT))[:, :, None]
    )


def test_the_rendered_sum_has_the_level_that_waves_give() -> None:
    """Random arrivals within 0.15 m: what is rendered, flat and by delays alone, has the true sum's level within
    0.15 dB; uncorrected it is off by more than a dB."""
    rng, before = np.random.default_rng(1), []
    for _ in range(40):
        n = int(rng.integers(1, 5))
        length = 3.0 + rng.uniform(0.0, 0.15, n)
        energy, wave = _random(rng, n)
        tile = _tile(np.ones(2), length, energy, wave)
        assert connect(tile) is None
        lengths, flat = np.append(3.0, length), np.ones((n + 1, 2, 3))
        all_before, waves = np.vstack([np.ones(2), energy]), np.concatenate([flat[:1], wave])
        all_after = np.vstack([tile.direct[0, 0], tile.discrete["diffraction"].energy])
        true = _level(lengths, all_before, waves)
        off = 10.0 * np.log10(_level(lengths, all_after, flat) / true)
        assert np.abs(off).max() < 0.15, off
        before.append(np.abs(10.0 * np.log10(_level(lengths, all_before, flat) / true)).max())
    assert np.max(before) > 1.0


@pytest.mark.parametrize("bands", [BANDS, (20.0, 20000.0), (500.0, 630.0, 800.0)])
def test_factors_are_those_of_the_theory(bands: tuple[float, ...]) -> None:
    """T over R, (T36b), by sums over 4001 wave numbers, for arrivals from millimetres to 300 m apart."""
    rng, s = np.random.default_rng(2), 4.0 * np.pi
    for _ in range(8):
        length = 3.0 + 10.0 ** rng.uniform(-3.0, 2.5, 5)
        energy, wave = _random(rng, 5, bands)
        tile = _tile(np.ones(len(bands) - 1), length, energy, wave, bands)
        connect(tile)
        found = np.vstack([tile.direct[0, 0], tile.discrete["diffraction"].energy / energy])
        lengths, flat = np.append(3.0, length), np.ones((6, len(bands) - 1, 3))
        energies = np.vstack([np.ones(len(bands) - 1), energy])
        apart = lengths[:, None] - lengths
        sums = []
        for w in (np.concatenate([flat[:1], wave]), flat):
            k, waves = _waves(lengths, w, bands)
            near = np.exp(-0.5 * (k[:, None, None] * apart[:, :, None] / s) ** 2)
            parts = np.einsum("ibk,jbk,bijk->bij", waves, waves.conj(), near).real / k.shape[1]
            sums.append((parts * np.sqrt(energies.T[:, :, None] * energies.T[:, None])).sum(axis=2))
        centre = np.sqrt(np.array(bands[1:]) * bands[:-1]) * 2.0 * np.pi / C
        about = np.exp(-0.5 * (centre[:, None, None] * apart / s) ** 2)
        true, rendered, total = (np.einsum("bij,bj->bi", about, x) for x in (*sums, energies.T))
        expected = (np.maximum(true, 0.0) + 0.02 * total) / (np.maximum(rendered, 0.0) + 0.02 * total)
        np.testing.assert_allclose(found, expected.T, rtol=5e-3)


def test_what_has_no_wave_is_kept() -> None:
    """To the bit, and where a reflection comes 60 m after all that has one within 0.1 %."""
    length, energy = np.array([3.1, 3.2]), np.array([[0.5, 0.2], [0.1, 0.3]])
    clean = _tile(np.ones(2), length, energy, np.ones((2, 2, 3)))
    connect(clean)
    np.testing.assert_array_equal(clean.discrete["diffraction"].energy, energy)
    late = _tile(np.ones(2), np.array([3.1, 63.0]), energy, np.stack([1j * _NONE, _NONE]))
    connect(late)
    np.testing.assert_allclose(late.discrete["diffraction"].energy[1], energy[1], rtol=1e-3)
