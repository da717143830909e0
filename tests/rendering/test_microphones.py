"""Arrays of microphones: delays, directions, coherence and levels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.axes import spherical_harmonics
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.echogram import Arrival, Arrivals
from tests.marks import ci_slow
from tests.stats import assert_mean

C, RATE = 343.0, 16000
NONE = Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * (0.05 / np.sqrt(3.0))


def _empty(bins: int = 500) -> ss.Echogram:
    table = np.zeros((bins, 9, 4), np.float32)
    edges = np.arange(bins + 1) * 0.002
    return ss.Echogram(DEFAULT_BANDS, edges, table, None, NONE, np.zeros((2, 4)), True)


def _from(direction: np.ndarray, distance: float) -> ss.Echogram:
    direct = Arrival(distance / C, np.full(4, 1.0 / (4.0 * np.pi * distance**2)), direction)
    return replace(_empty(20), direct=direct)


def _diffuse(bins: int = 500) -> ss.Echogram:
    table = np.zeros((bins, 9, 4), np.float32)
    table[:, 0] = 1e-3
    return replace(_empty(bins), energy=table)


def _music(spectra: np.ndarray, frequency: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Direction of one wave by MUSIC (Schmidt 1986), the pseudo-spectra of all frequencies added up: on a grid of
    some 1.5 degrees, then finer about its best point."""

    def best(grid: np.ndarray) -> np.ndarray:
        total = np.zeros(len(grid))
        for f, snapshots in zip(frequency, spectra, strict=True):
            _, vectors = np.linalg.eigh(snapshots @ snapshots.conj().T)
            noise = vectors[:, :-1]
            steer = np.exp(2j * np.pi * f * (grid @ offsets.T) / C)
            total += 1.0 / (np.abs(steer.conj() @ noise) ** 2).sum(axis=1)
        return np.asarray(grid[total.argmax()])

    k = np.arange(12000) + 0.5
    z, phi = 1.0 - 2.0 * k / 12000, np.pi * (1.0 + np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z**2)
    rough = best(np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1))
    near = rough + 0.03 * np.random.default_rng(0).uniform(-1.0, 1.0, (2000, 3))
    return best(near / np.linalg.norm(near, axis=1, keepdims=True))


@ci_slow
def test_direction_of_a_source_by_music() -> None:
    """Noise through the responses of a tetrahedron of 5 cm: found within 3 degrees, all of 20 directions at 3 m."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        array = ss.MicrophoneArray(
            TETRAHEDRON, heading_deg=float(rng.uniform(-180, 180)), pitch_deg=20.0
        )
        rirs = ss.array_rir(_from(d, 3.0), array, RATE, 0, C)
        dry = rng.normal(size=8192)
        heard = np.stack([np.convolve(dry, r) for r in rirs.astype(float)])[:, 1024:7168]
        heard += 1e-3 * heard.std() * rng.normal(size=heard.shape)
        spectra = np.fft.rfft(heard.reshape(4, -1, 256) * np.hanning(256), axis=2)
        frequency = np.fft.rfftfreq(256, 1.0 / RATE)
        use = (frequency > 500.0) & (frequency < 2500.0)
        found = _music(spectra[:, :, use].transpose(2, 0, 1), frequency[use], array.offsets)
        assert np.rad2deg(np.arccos(np.clip(found @ d, -1.0, 1.0))) < 3.0


def test_delay_and_level_of_each_capsule() -> None:
    """A source 0.5 m in front: distances 0.3 to 0.7 m to five capsules on the line, by pulse and by level."""
    offsets = np.array([[x, 0.0, 0.0] for x in (-0.2, -0.1, 0.0, 0.1, 0.2)])
    rirs = ss.array_rir(_from(np.array([1.0, 0.0, 0.0]), 0.5), ss.MicrophoneArray(offsets), 48000, 0, C)
    own = 0.5 - offsets[:, 0]
    spectra, frequency = np.fft.rfft(rirs, axis=1), np.fft.rfftfreq(rirs.shape[1], 1 / 48000)
    use = (frequency > 300.0) & (frequency < 8000.0)
    phase = np.unwrap(np.angle(spectra[:, use]), axis=1)
    delay = -(phase[:, -1] - phase[:, 0]) / (2.0 * np.pi * np.ptp(frequency[use]))
    np.testing.assert_allclose(delay, own / C, atol=2e-7)
    level = np.abs(spectra[:, use]).mean(axis=1)
    np.testing.assert_allclose(level, 1.0 / np.sqrt(4.0 * np.pi) / own, rtol=2e-3)


@ci_slow
def test_coherence_of_a_diffuse_field() -> None:
    """sin(kr) / kr between capsules 10 cm apart, whatever the direction of the line, in bands of 200 Hz to 6 kHz."""
    offsets = np.array([[0.05, 0.0, 0.0], [-0.05, 0.0, 0.0], [0.0, 0.0, 0.05], [0.0, 0.0, -0.05]])
    samples = []
    for seed in range(16):
        rirs = ss.array_rir(_diffuse(), ss.MicrophoneArray(offsets), RATE, seed, C)
        spectra = np.fft.rfft(rirs[:, :RATE].astype(float), axis=1)  # bins of 1 Hz
        row = []
        for a, b in ((0, 1), (2, 3)):
            cross = (spectra[a] * spectra[b].conj()).real[200:6000].reshape(-1, 200).sum(axis=1)
            both = (np.abs(spectra[[a, b]]) ** 2).mean(axis=0)[200:6000].reshape(-1, 200).sum(axis=1)
            row.append(cross / both)
        samples.append(np.concatenate(row))
    frequency = np.arange(200.0, 6000.0) + 0.0
    wanted = np.sinc(2.0 * frequency * 0.1 / C).reshape(-1, 200).mean(axis=1)
    assert_mean(np.array(samples), np.tile(wanted, 2), "coherence", relative=0.04, scale=np.ones(58))


def test_levels_follow_the_echogram() -> None:
    """Energy at every capsule is the echogram's, a third of it for cardioids in a diffuse field; of sound from the
    front all or nothing."""
    offsets = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    array = ss.MicrophoneArray(offsets, [None, ss.Cardioid(), ss.Cardioid(heading_deg=180.0)])
    energy = [
        (ss.array_rir(_diffuse(100), array, 40000, seed, C).astype(float) ** 2).sum(axis=1)
        for seed in range(16)
    ]
    total = float(_diffuse(100).energy[:, 0, 0].sum())
    assert_mean(np.array(energy) / total, [1.0, 1 / 3, 1 / 3], "levels", relative=0.02)
    table = np.zeros((100, 9, 4), np.float32)
    table[:] = 1e-3 * spherical_harmonics(np.array([[1.0, 0.0, 0.0]]))[0][None, :, None]
    front = replace(_empty(100), energy=table)
    ahead = np.mean(
        [(ss.array_rir(front, array, RATE, s, C).astype(float) ** 2).sum(axis=1) for s in range(8)],
        axis=0,
    )
    # the moments are those of one wave from the front: cardioids that face it and that turn their back on it
    np.testing.assert_allclose(ahead[1:] / ahead[0], [1.0, 0.0], atol=0.06)


def test_one_field_for_all_arrays() -> None:
    """The same capsule in two arrays hears the same samples."""
    offsets = np.array([[0.02, 0.0, 0.0], [0.0, 0.03, 0.0]])
    echogram = replace(_diffuse(), direct=_from(np.array([0.0, 1.0, 0.0]), 2.0).direct)
    both = ss.array_rir(echogram, ss.MicrophoneArray(offsets), RATE, 7)
    alone = ss.array_rir(echogram, ss.MicrophoneArray(offsets[1:]), RATE, 7)
    np.testing.assert_array_equal(both[1:], alone)
    assert both.dtype == np.float32 and both.shape == (2, RATE)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0.0, 0.0]],), "shape"),
        (([[0.0, 0.0, 0.31]],), "within 0.3 m"),
        (([[0.0, 0.0, np.nan]],), "finite"),
        (([[0.0, 0.0, 0.0]], [None, None]), "expected one Directivity or 1"),
    ],
)
def test_bad_arrays(arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises(ss.ConfigError, match=message):
        ss.MicrophoneArray(*arguments)  # type: ignore[arg-type]
